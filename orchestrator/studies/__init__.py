"""Many runs: parameter studies, convergence of the masters, path following, the cost of variants.

    study, cases, design     what a parameter study is, what it means for its systems, its samples
    single_run, processes    one run, and the child processes that hold the FMUs
    pool, store              Dask, and the folder with the results
    parameter_study          `harvester sweep`; `analysis` and `report` say what its results mean
    convergence...           `harvester convergence`: error of each master over the communication step
    path_...                 `harvester track`: how far the tip is from its path
    variants                 `harvester variants`: what each variant costs and changes

For Python: `from orchestrator.studies import Study, sweep` and the names below.
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

_WHERE = {
    "Choice": "study:Choice",
    "Factor": "study:Factor",
    "Output": "study:Output",
    "Results": "store:Results",
    "Study": "study:Study",
    "analyse": "analysis.analyse:analyse",
    "read_results": "store:read",
    "read_study": "study:read",
    "sweep": "parameter_study:sweep",
}

__all__ = [
    "Choice", "Factor", "Output", "Results", "Study", "analyse", "read_results", "read_study", "sweep",
]  # fmt: skip


def __getattr__(name: str) -> Any:
    """Import on first use."""
    if name not in _WHERE:
        raise AttributeError(f"module 'orchestrator.studies' has no attribute {name!r}")
    module, _, attribute = _WHERE[name].partition(":")
    return getattr(import_module(f"orchestrator.studies.{module}"), attribute)
