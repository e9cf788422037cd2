"""Many runs: parameter studies and convergence studies.

    study, cases, design     a parameter study as data, resolved against its systems, and its samples
    runs, store              the runs and what is stored of them; the folder with the results
    parameter_study          `harvester sweep`
    analysis, study_page     statistics and sensitivities of its results, and their page
    convergence              `harvester convergence`: error of each master over the communication step
    variant_costs            `harvester variants`: cost of each variant

In Python: `from orchestrator.studies import Study, sweep` and the names below.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from orchestrator.studies.analysis.analyse import analyse
    from orchestrator.studies.parameter_study import sweep
    from orchestrator.studies.store import Results
    from orchestrator.studies.store import read as read_results
    from orchestrator.studies.study import Choice, Factor, Output, Study
    from orchestrator.studies.study import read as read_study

_MODULES = {
    **dict.fromkeys(("Choice", "Factor", "Output", "Study", "read_study"), "study"),
    **dict.fromkeys(("Results", "read_results"), "store"),
    **{"analyse": "analysis.analyse", "sweep": "parameter_study"},
}

__all__ = [
    "Choice", "Factor", "Output", "Results", "Study", "analyse", "read_results", "read_study", "sweep",
]  # fmt: skip


def __getattr__(name: str) -> Any:
    """Import on first use."""
    if name not in _MODULES:
        raise AttributeError(f"module 'orchestrator.studies' has no attribute {name!r}")
    module = import_module(f"orchestrator.studies.{_MODULES[name]}")
    return getattr(module, "read" if name.startswith("read_") else name)
