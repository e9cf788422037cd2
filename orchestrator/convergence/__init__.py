"""How the error of a system falls with the communication step, for each master, and what that costs."""

from orchestrator.convergence.figure import draw_error, draw_work
from orchestrator.convergence.settings import SETTINGS, Setting, choose
from orchestrator.convergence.study import Row, Study, study
from orchestrator.convergence.table import markdown, tables
from orchestrator.convergence.truth import Truth, from_reference, from_run
from orchestrator.convergence.writing import write

__all__ = [
    "SETTINGS", "Row", "Setting", "Study", "Truth",
    "choose", "draw_error", "draw_work", "from_reference", "from_run", "markdown", "study", "tables", "write",
]  # fmt: skip
