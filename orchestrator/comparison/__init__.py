"""Runs against each other: what changes when an FMU, a step or a parameter does, and what it costs."""

from orchestrator.comparison.compare import Comparison, compare
from orchestrator.comparison.figure import draw
from orchestrator.comparison.table import text
from orchestrator.comparison.writing import write

__all__ = ["Comparison", "compare", "draw", "text", "write"]
