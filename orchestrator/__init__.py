"""Co-simulates systems of FMUs: connect, step, record, validate, linearise. Contains no model equations.

from orchestrator import run, validate, write_trace

result = run("build/harvester.ssp", scenario="data/scenarios/work_cycle.csv", step=1e-3)
print(result.card.text())
write_trace(result.trace, "build/trace.csv")
print(validate(result, "data/reference/work_cycle.csv").verdict)

`load` reads a system, `assemble` makes one from FMUs, `write_ssp` writes it. `compare` compares traces,
`sweep` runs a `Study`, `batch` simulates many machines at once, `linearize` computes A, B, C, D and modes at
an operating point, `reference` solves a system as one ODE.
"""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

from orchestrator.base import SHIPPED
from orchestrator.base.errors import suggest

if TYPE_CHECKING:
    from orchestrator.base.errors import Problem
    from orchestrator.data.recording import Recording, read_recording
    from orchestrator.data.trace import Trace, read_trace
    from orchestrator.data.trace_writer import write_trace
    from orchestrator.engine.result import Card, Interrupted, Result, RunFailed
    from orchestrator.engine.run import run
    from orchestrator.lanes import BatchResult, batch
    from orchestrator.linear.linearize import linearize
    from orchestrator.linear.model import Linear, LinearModel
    from orchestrator.monolithic.reference import reference
    from orchestrator.results.comparison import compare
    from orchestrator.results.validation import Validation, validate
    from orchestrator.ssp.coupling import Coupling
    from orchestrator.ssp.load import assemble, load
    from orchestrator.ssp.masters import Master
    from orchestrator.ssp.swap import with_swaps
    from orchestrator.ssp.system import System
    from orchestrator.ssp.write import write_ssp
    from orchestrator.studies import Study, read_study, sweep

    __version__: str

_MODULES = {
    "base.errors": "Problem",
    "data.recording": "Recording read_recording",
    "data.trace": "Trace read_trace",
    "data.trace_writer": "write_trace",
    "engine.result": "Card Interrupted Result RunFailed",
    "engine.run": "run",
    "lanes": "BatchResult batch",
    "linear.linearize": "linearize",
    "linear.model": "Linear LinearModel",
    "monolithic.reference": "reference",
    "results.comparison": "compare",
    "results.validation": "Validation validate",
    "ssp.coupling": "Coupling",
    "ssp.load": "assemble load",
    "ssp.masters": "Master",
    "ssp.swap": "with_swaps",
    "ssp.system": "System",
    "ssp.write": "write_ssp",
    "studies": "Study read_study sweep",
}
_MODULE_OF = {name: module for module, names in _MODULES.items() for name in names.split()}

__all__ = [
    "BatchResult", "Card", "Coupling", "Interrupted", "Linear", "LinearModel", "Master",
    "Problem", "Recording", "Result", "RunFailed", "Study", "System", "Trace", "Validation",
    "assemble", "batch", "compare", "linearize", "load", "read_recording", "read_study", "read_trace",
    "reference", "run", "sweep", "validate", "with_swaps", "write_ssp", "write_trace",
]  # fmt: skip


def __getattr__(name: str) -> Any:
    """Import a name on first use, so that the command line starts fast."""
    if name == "__version__":
        return str(import_module("importlib.metadata").version("harvester-cosim"))
    if name not in _MODULE_OF:
        hint = "" if name.startswith("_") else suggest(name, __all__)
        raise AttributeError(f"module 'orchestrator' has no attribute {name!r}{hint}")
    return getattr(import_module(f"orchestrator.{_MODULE_OF[name]}"), name)


def __dir__() -> list[str]:
    return [*__all__, "__version__"]


def _files_of_the_models(name: str, suffixes: tuple[str, ...]) -> Mapping[str, Path]:
    from fmus.package_files import files

    return files(name, suffixes)


SHIPPED.append(_files_of_the_models)
