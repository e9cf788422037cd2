"""One call that runs a system: what the user gave becomes a system, a time grid and a job."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

from orchestrator.base.coupling import Coupling
from orchestrator.base.files import Location, make_folder, require_system
from orchestrator.data.trace import Trace, check_suffix, read, write
from orchestrator.engine.job import Execution, Job, Record, estimated, guarded, open_slave
from orchestrator.engine.result import Interrupted, Result, RunFailed, write_metadata
from orchestrator.engine.scenario import Scenario, drive
from orchestrator.engine.time_grid import RECORD, divided, free_grid, grid, step_length, thinned
from orchestrator.fmi.description import Value
from orchestrator.ssp.load import load
from orchestrator.ssp.parameter_sets import with_sets
from orchestrator.ssp.swap import with_swaps
from orchestrator.ssp.system import System

__all__ = [
    "Execution", "Interrupted", "Record", "Result", "RunFailed", "open_slave", "run",
]  # what a caller of `run` needs  # fmt: skip


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
    record: Record | Sequence[str] | None = None,
    execution: Execution | None = None,
    **single: Any,
) -> Result:
    """Co-simulate a system.

    system       a System, or the path of an .ssp, .ssd or .fmu file
    scenario     inputs over time: a Trace, or a .csv or .parquet file; columns name inputs of the system,
                 component.variable, or all component inputs of one name; a column replaces the connection to
                 its input
    master       a name, such as "hermite", or a Coupling, such as Coupling("hermite", passes=2); default:
                 what the system suggests, see `System.coupling`, else "gauss-seidel"
    step         communication step [s], of adaptive runs the first to try; default: with no `master` given
                 what the system suggests, else the smallest that an FMU does, else 1e-3
    start, stop  [s]; default: stop at the end of the scenario, else what the system or the FMUs suggest
    swap         other FMUs {component: name of a variant, or path of an .fmu file}; they are checked
    parameters   parameter sets: names of those in the SSP's resources, or .ssv files; later ones win
    set          start values {name: value}, in the units of the FMU, before a swap, named like the columns of
                 a scenario
    record       names of the signals to record, or a `Record`, which has step and power bonds, too
    execution    tolerance of the FMUs, error estimate, progress bar, other kinds of components: see
                 `Execution`
    single       settings of the last two by themselves: record_step, bonds, tolerance,
                 error_estimate, progress, open

    Raises Problem for a mistake, RunFailed or Interrupted when a started run ends early.
    """
    record, execution = _settings(record, execution, single)
    whole = with_swaps(system if isinstance(system, System) else load(system), swap or {})
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
    trace, span = driven[1] if driven else None, (start, stop, record.step)
    if coupling.adaptive is None:
        times = grid(whole, trace, step, *span)
        if driven and guarded(whole, coupling):
            times = divided(times, driven[0].table.corners())
    else:
        times = free_grid(whole, trace, step, *span, driven[0].table.corners() if driven else ())
    job = Job(whole, driven[0] if driven else None, coupling, record, execution)
    result = job.run(times)
    return replace(result, card=estimated(job, times, result)) if execution.error_estimate else result


def _settings(
    record: Record | Sequence[str] | None, execution: Execution | None, single: Mapping[str, Any]
) -> tuple[Record, Execution]:
    """The settings, with those that were given by themselves."""
    known = {"record_step", "bonds", "native", *(f.name for f in fields(Execution))}
    if unknown := sorted(single.keys() - known):
        raise TypeError(f"run() got an unexpected keyword argument {unknown[0]!r}")
    whole = record if isinstance(record, Record) else Record(record)
    own = {"record_step": "step", "bonds": "bonds"}
    changed = {own[name]: value for name, value in single.items() if name in own}
    rest = {name: value for name, value in single.items() if name not in (*own, "native")}
    return replace(whole, **changed), replace(execution or Execution(), **rest)


def _scenario(
    system: System, scenario: Trace | str | Path | Location | None
) -> tuple[Scenario, Trace] | None:
    if scenario is None:
        return None
    trace = scenario if isinstance(scenario, Trace) else read(scenario)
    label = "scenario" if isinstance(scenario, Trace) else str(scenario)
    return drive(system, trace, label), trace


def run_to_file(system: Path, scenario: Path | None, out: Path, **options: Any) -> None:
    """Co-simulate, write the trace, print the accuracy card; an aborted run leaves its trace too."""
    save(simulated(system, scenario, out, **options), out, given(scenario=scenario, **options))


def given(coupling: Mapping[str, Any] | None = None, **options: Any) -> dict[str, Any]:
    """What the user asked for, in one mapping, to note next to a trace."""
    return {**options, **(coupling or {})}


def simulated(
    system: Path,
    scenario: Path | Trace | None,
    out: Path,
    step: float | None = None,
    record_step: float | None = None,
    coupling: Mapping[str, Any] | None = None,
    everywhere: bool = True,
    cut: Sequence[str] = (),
    swap: Mapping[str, str] | None = None,
    **options: Any,
) -> Result:
    """Co-simulate with a progress bar; a run that ends early is saved to the file `out`.

    record_step   [s]; default: 5 ms or as near below it as the step allows, at least one step
    coupling      choices that the user makes, named like the fields of `Coupling`
    everywhere    without a record step an adaptive run records every communication point, else every 5 ms
    cut           patterns of the inputs whose connections are left out, before anything else
    swap          other FMUs: component -> name of a variant, or path
    """
    check_suffix(out)
    loaded = with_swaps(load(require_system(system)).without(*cut), swap or {})
    loaded = loaded.coupled(coupling) if coupling else loaded
    if record_step is None and loaded.coupling and loaded.coupling.adaptive is not None:
        interval = None if everywhere else RECORD
    else:
        interval = thinned(step_length(loaded, step)) if record_step is None else record_step
    make_folder(out.parent)
    try:
        return run(loaded, scenario, step=step, record_step=interval, progress=True, **options)
    except (RunFailed, Interrupted) as ended:
        own = {"step": step, "record_step": record_step, "cut": cut, "swap": swap}
        file = None if isinstance(scenario, Trace) else scenario
        save(ended.result, out, given(coupling, scenario=file, **own, **options))
        raise


def save(result: Result, out: Path, given: Mapping[str, Any]) -> None:
    """Write the trace and, next to it, its metadata; print the card."""
    write(result.trace, out)
    write_metadata(result, out, given)
    print(result.card.text())
    end = f"up to t = {result.trace.time[-1]:.6g} s " if len(result.trace.time) else ""
    kept = "" if result.complete else f"the run ended early; what was recorded {end}is kept in "
    print(f"\n{kept}{contents(result, out)}")


def contents(result: Result, out: Path) -> str:
    """The file of a trace and what is in it."""
    trace, card = result.trace, result.card
    thin = card.record_step > card.step or (card.adaptive is not None and card.record_step > 0)
    every = f", every {card.record_step:g} s" if thin else ""
    return f"{out}: {len(trace.signals)} signals, {len(trace.time)} rows{every}"
