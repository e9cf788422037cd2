"""Validation of a run: compare it with a reference, judge it, show it."""

from orchestrator.validation.compare import Row, Validation, compare
from orchestrator.validation.figures import FigureSpec, Panel, draw
from orchestrator.validation.metrics import Metrics, measure
from orchestrator.validation.motion import Motion, strobe
from orchestrator.validation.reference import Reference, Signal, read_reference
from orchestrator.validation.report import Component, Parameter, Report, write_report
from orchestrator.validation.summary import summary
from orchestrator.validation.tolerance import Tolerance
from orchestrator.validation.writing import Origin, write_reference

__all__ = [
    "Component",
    "FigureSpec",
    "Metrics",
    "Motion",
    "Origin",
    "Panel",
    "Parameter",
    "Reference",
    "Report",
    "Row",
    "Signal",
    "Tolerance",
    "Validation",
    "compare",
    "draw",
    "measure",
    "read_reference",
    "strobe",
    "summary",
    "write_reference",
    "write_report",
]
