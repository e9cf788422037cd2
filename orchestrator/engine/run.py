"""`run`: co-simulates a system with the user's choices; `run_to_file`: the same for the command line."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

from orchestrator.base.coupling import Coupling
from orchestrator.base.files import Location, make_folder, require_system
from orchestrator.data.trace import Trace, check_suffix, read_trace, write_trace
from orchestrator.engine.job import Execution, Job, Record, guarded, open_slave, with_error_estimate
from orchestrator.engine.result import Interrupted, Result, RunFailed, write_metadata
from orchestrator.engine.scenario import Scenario, drive
from orchestrator.engine.time_grid import (
    RECORD_STEP,
    free_grid,
    grid,
    record_interval,
    step_length,
    with_events,
)
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
    **options: Any,
) -> Result:
    """Co-simulate a system.

    system       a System, or the path of an .ssp, .ssd or .fmu file
    scenario     inputs over time: a Trace, or a .csv or .parquet file; a column has the name of an input of
                 the system, of component.variable, or of all component inputs with this name; it replaces
                 the connection to its input
    master       a name, such as "hermite", or a Coupling, such as Coupling("hermite", passes=2); default:
                 what the system suggests, see `System.coupling`, else "gauss-seidel"
    step         communication step [s], of an adaptive run the first to try; default: without `master` the
                 suggestion of the system, else the smallest step that an FMU suggests, else 1e-3
    start, stop  [s]; default stop: end of the scenario, else the suggestion of the system or the FMUs
    swap         replaced FMUs {component: name of a variant, or path of an .fmu file}; ports are checked
    parameters   parameter sets: names of sets in the SSP's resources, or .ssv files; later ones override
    set          start values {name: value}; units are those of the FMU before a swap, names as in a scenario
    record       names of the signals to record, or a `Record`, also with step and power bonds
    execution    tolerance of the FMUs, error estimate, progress bar, other component classes: see
                 `Execution`
    options      fields of `Record` and `Execution` as single arguments: record_step, bonds, tolerance,
                 error_estimate, progress, open

    Raises Problem for a mistake, RunFailed or Interrupted when a started run ends early.
    """
    record, execution = _with_options(record, execution, options)
    system = with_swaps(system if isinstance(system, System) else load(system), swap or {})
    if master is not None:
        system = system.coupled(master if isinstance(master, Coupling) else Coupling(master))
    system = replace(system, notes=system.notes + system.suggestion.notes(step is not None))
    system = with_sets(system, parameters).with_start(set or {})
    trace, driving = _scenario(system, scenario)
    if driving:
        system = driving.released(system)
        system = replace(system, notes=system.notes + driving.overruled(system, set or {}))
    coupling = system.coupling or Coupling()
    coupling.check(system.components)
    if coupling.adaptive is None:
        times = grid(system, trace, step, start, stop, record.step)
        if driving and guarded(system, coupling):
            times = with_events(times, driving.table.corners())
    else:
        corners = driving.table.corners() if driving else ()
        times = free_grid(system, trace, step, start, stop, record.step, corners)
    job = Job(system, driving, coupling, record, execution)
    result = job.run(times)
    return (
        replace(result, card=with_error_estimate(job, times, result)) if execution.error_estimate else result
    )


def _with_options(
    record: Record | Sequence[str] | None, execution: Execution | None, options: Mapping[str, Any]
) -> tuple[Record, Execution]:
    """The record and the execution, changed by single options."""
    of_record = {"record_step": "step", "bonds": "bonds"}
    allowed = {*of_record, "native", *(f.name for f in fields(Execution))}
    if unknown := sorted(options.keys() - allowed):
        raise TypeError(f"run() got an unexpected keyword argument {unknown[0]!r}")
    record = record if isinstance(record, Record) else Record(record)
    record_options = {of_record[name]: value for name, value in options.items() if name in of_record}
    others = {name: value for name, value in options.items() if name not in (*of_record, "native")}
    return replace(record, **record_options), replace(execution or Execution(), **others)


def _scenario(
    system: System, scenario: Trace | str | Path | Location | None
) -> tuple[Trace | None, Scenario | None]:
    if scenario is None:
        return None, None
    trace = scenario if isinstance(scenario, Trace) else read_trace(scenario)
    label = "scenario" if isinstance(scenario, Trace) else str(scenario)
    return trace, drive(system, trace, label)


# ---- for the command line


def run_to_file(system: Path, scenario: Path | None, out: Path, **options: Any) -> None:
    """Co-simulate, write the trace, print the accuracy card; the trace of an aborted run is written too."""
    result = run_or_save(system, scenario, out, **options)
    save(result, out, requested_options(scenario=scenario, **options))


def requested_options(coupling: Mapping[str, Any] | None = None, **options: Any) -> dict[str, Any]:
    """All options that the user chose, in one mapping, for the metadata of a trace."""
    return {**options, **(coupling or {})}


def run_or_save(
    system: Path,
    scenario: Path | Trace | None,
    out: Path,
    step: float | None = None,
    record_step: float | None = None,
    coupling: Mapping[str, Any] | None = None,
    every_point: bool = True,
    cut: Sequence[str] = (),
    swap: Mapping[str, str] | None = None,
    **options: Any,
) -> Result:
    """Co-simulate with a progress bar; a run that ends early is saved to the file `out`.

    record_step   [s]; default: the largest multiple of the step up to 5 ms, at least one step
    coupling      the user's choices, with the names of the fields of `Coupling`
    every_point   without a record step an adaptive run records every communication point, else every 5 ms
    cut           patterns of inputs whose connections are removed before anything else
    swap          replaced FMUs: component -> name of a variant, or path
    """
    check_suffix(out)
    loaded = with_swaps(load(require_system(system)).without(*cut), swap or {})
    loaded = loaded.coupled(coupling) if coupling else loaded
    interval = record_step
    if record_step is None and loaded.coupling and loaded.coupling.adaptive is not None:
        interval = None if every_point else RECORD_STEP
    elif record_step is None:
        interval = record_interval(step_length(loaded, step))
    make_folder(out.parent)
    try:
        return run(loaded, scenario, step=step, record_step=interval, progress=True, **options)
    except (RunFailed, Interrupted) as ended:
        arguments = {"step": step, "record_step": record_step, "cut": cut, "swap": swap}
        file = None if isinstance(scenario, Trace) else scenario
        save(ended.result, out, requested_options(coupling, scenario=file, **arguments, **options))
        raise


def save(result: Result, out: Path, options: Mapping[str, Any]) -> None:
    """Write the trace and its metadata; print the card."""
    write_trace(result.trace, out)
    write_metadata(result, out, options)
    print(result.card.text())
    end = f" up to t = {result.trace.time[-1]:.6g} s" if len(result.trace.time) else ""
    early = "" if result.complete else f"the run ended early; its record{end} is in "
    print(f"\n{early}{file_summary(result, out)}")


def file_summary(result: Result, out: Path) -> str:
    """The file of a trace with its number of signals and rows, and the record step."""
    trace, card = result.trace, result.card
    has_interval = card.record_step > card.step or (card.adaptive is not None and card.record_step > 0)
    interval = f", every {card.record_step:g} s" if has_interval else ""
    return f"{out}: {len(trace.signals)} signals, {len(trace.time)} rows{interval}"
