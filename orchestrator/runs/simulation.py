"""One call that runs a system: what the user gave becomes a system, a time grid and a job."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from orchestrator.coupling.drive import Drive, drive
from orchestrator.coupling.grid import divided, free_grid, grid
from orchestrator.errors import Problem
from orchestrator.files.archive import Location
from orchestrator.files.trace import Trace, read
from orchestrator.runs.estimate import estimated
from orchestrator.runs.job import Job, Opener, guarded
from orchestrator.runs.result import Interrupted, Result, RunFailed
from orchestrator.settings import Coupling
from orchestrator.slaves.slave import Slave
from orchestrator.system.interface import Value
from orchestrator.system.parameters import with_sets
from orchestrator.system.system import Component, System

__all__ = ["Interrupted", "Result", "RunFailed", "open_slave", "run"]  # what a caller of `run` needs


def open_slave(component: Component) -> Slave:
    """An instance of the component's FMU."""
    if component.source is None:
        raise Problem(f"{component.name}: has no FMU file")
    from orchestrator.slaves.fmu import FmuSlave

    return FmuSlave(component.name, component.interface, component.source, component.start)


def run(
    system: System | str | Path,
    scenario: Trace | str | Path | Location | None = None,
    master: str | Coupling | None = None,
    step: float | None = None,
    start: float | None = None,
    stop: float | None = None,
    swap: Mapping[str, str | Path] | None = None,
    parameters: Sequence[str | Path] = (),
    set: Mapping[str, Value | str] | None = None,
    record: Sequence[str] | None = None,
    record_step: float | None = None,
    bonds: Iterable[tuple[str, str]] | None = None,
    tolerance: float | None = None,
    error_estimate: bool = False,
    progress: bool = False,
    native: bool = True,
    open: Opener = open_slave,
) -> Result:
    """Co-simulate a system.

    system          a System, or the path of an .ssp, .ssd or .fmu file
    scenario        inputs over time: a Trace, or a .csv or .parquet file; columns name inputs of the system,
                    component.variable, or all component inputs of one name; a column replaces the connection
                    to its input
    master          a name, such as "hermite", or a Coupling, such as Coupling("hermite", passes=2); default:
                    what the system suggests, see `System.coupling`, else "gauss-seidel"
    step            communication step [s], of adaptive runs the first to try; default: with no `master` given
                    what the system suggests, else the smallest that an FMU does, else 1e-3
    start, stop     [s]; default: stop at the end of the scenario, else what the system or the FMUs suggest
    swap            other FMUs {component: name of a variant, or path of an .fmu file}; they are checked
    parameters      parameter sets: names of those in the SSP's resources, or .ssv files; later ones win
    set             start values {name: value}, in the units of the FMU, before a swap, named like the columns
                    of a scenario
    record          names of the signals to record; default: all outputs, all inputs that are fed and all that
                    are inputs of the system, fed or not
    record_step     interval between recorded points [s], a multiple of the step; adaptive runs hit the points
                    exactly; first and last are always recorded; default: every communication point
    bonds           power bonds as pairs of input names; default: found from the units
    tolerance       relative tolerance handed to the FMUs
    error_estimate  run again at half and at twice the step, an adaptive run at a tenth of its tolerance, to
                    estimate the error of each signal at the recorded points
    progress        show a progress bar when the run takes longer than a second
    native          False: the loop in Python, which gives the same numbers and is slower
    open            makes the slave of a component (for tests and other kinds of components)

    Raises Problem for a mistake, RunFailed or Interrupted when a started run ends early.
    """
    from orchestrator.system.ssp import load

    whole = (system if isinstance(system, System) else load(system)).swapped(swap or {})
    if master is not None:
        whole = whole.coupled(master if isinstance(master, Coupling) else Coupling(master))
    whole = replace(whole, notes=whole.notes + whole.suggestion.notes(step is not None))
    whole = with_sets(whole, parameters).with_start(set or {})
    driven = _scenario(whole, scenario)
    if driven:
        whole = driven[0].released(whole)
        whole = replace(whole, notes=whole.notes + driven[0].overruled(whole, set or {}))
    coupling = whole.coupling or Coupling()
    coupling.check(whole.components)
    trace, span = driven[1] if driven else None, (start, stop, record_step)
    if coupling.adaptive is None:
        times = grid(whole, trace, step, *span)
        if driven and guarded(whole, coupling):
            times = divided(times, driven[0].table.corners())
    else:
        times = free_grid(whole, trace, step, *span, driven[0].table.corners() if driven else ())
    job = Job(whole, driven[0] if driven else None, coupling, record, bonds, tolerance, native, open)
    result = job.run(times, progress)
    return replace(result, card=estimated(job, times, result, progress)) if error_estimate else result


def _scenario(system: System, scenario: Trace | str | Path | Location | None) -> tuple[Drive, Trace] | None:
    if scenario is None:
        return None
    trace = scenario if isinstance(scenario, Trace) else read(scenario)
    label = "scenario" if isinstance(scenario, Trace) else str(scenario)
    return drive(system, trace, label), trace
