"""`harvester validate`: run a system, compare it with a reference, write the report.

Without a scenario the commands in the reference are the scenario. The monolithic solution of the same FMUs
can replace a reference.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any, Unpack

import numpy as np
from markupsafe import Markup
from rich.console import Console

from orchestrator.base import toml
from orchestrator.base.errors import Problem
from orchestrator.base.files import DEFAULT_SYSTEM, require_system
from orchestrator.base.progress import doing
from orchestrator.base.units import convert
from orchestrator.data.recording import Recording, fill_gaps, read_recording
from orchestrator.data.table import Array
from orchestrator.data.trace import Trace
from orchestrator.data.trace_writer import RowLayout
from orchestrator.drive.page import Replayed, fragment
from orchestrator.engine.arguments import RunArguments
from orchestrator.engine.result import Card, Result
from orchestrator.engine.run import run_to_file
from orchestrator.engine.time_grid import Grid
from orchestrator.fmi.description import FmuVariable
from orchestrator.results import validation_report as reporting
from orchestrator.results.layout import FigureSpec, Layout, PanelSpec, read_layout
from orchestrator.results.monolithic_recording import monolithic_recording, solve_as_run
from orchestrator.results.summary import summary
from orchestrator.results.validation import (
    Validation,
    by_variable,
    check_comparable,
    validate,
    without_repetitions,
)
from orchestrator.ssp.load import load
from orchestrator.ssp.parameter_sets import with_sets
from orchestrator.ssp.plausible import doubtful_signals, with_doubts
from orchestrator.ssp.provenance import built_notes, checksum, chosen_note, other_values
from orchestrator.ssp.swap import missing_after_swap, with_swaps
from orchestrator.ssp.system import Component, Port, System, coerce

POSITIONS = ("rad", "m")
START_TOLERANCE = 0.05  # relative to the range of the reference: more than noise and settling


def start_note(run: Trace, reference: Recording) -> str:
    """Note on start positions that differ from those of the reference; empty if there are none.

    Commands do not determine the start position of a machine, and its response depends on that position.
    """
    recorded = reference.trace()
    start = recorded.at(run.time[:1])
    offsets, largest_range = {}, 0.0
    for name, values in recorded.signals.items():
        unit = run.units.get(name, "")
        if name in run.signals and unit in POSITIONS and unit == recorded.units[name]:
            offset = float(run[name][0] - start[name][0])
            offsets[f"{name} by {offset:.3g} {unit}"] = abs(offset)
            largest_range = max(largest_range, float(np.ptp(values)))
    large = ", ".join(text for text, size in offsets.items() if size > START_TOLERANCE * largest_range)
    return (
        (f"the start of the run differs from the reference: {large}; --set changes the start values")
        if large
        else ""
    )


def played(system: System, reference: Recording, also: Sequence[str] = ()) -> Trace | None:
    """The signals of a reference that are external inputs of the system, as a scenario; None without any.

    External inputs are not connected, or connected to a component without inputs, such as operator_input.
    Signals that another component computes are compared instead.

    also   patterns of further signals that are played, such as a measured supply pressure
    """
    for pattern in also:
        if not any(fnmatchcase(name, pattern) for name in reference.signals):
            names = ", ".join(reference.signals)
            raise Problem(f"--play {pattern}: expected a signal of {reference.source}: {names}")
    inputs = {str(p) for p in system.ports("input")}
    sources = {n for n, c in system.components.items() if not c.interface.of("input")}
    external = {str(p) for p in system.exposed}
    external |= {str(c.target) for c in system.connections if c.source.component in sources}
    columns = {}
    for name in reference.signals:
        port = _name_in_system(system, name)
        requested = any(fnmatchcase(name, pattern) for pattern in also)
        if requested and port not in inputs:
            raise Problem(f"--play: expected an input of {system.name}, got {name}")
        if port not in external and not requested:
            continue
        unit = system.unit(system.port(port))
        target = unit.name if unit else reference.file_units.get(name, reference.units[name])
        columns[port] = convert(fill_gaps(reference, name), reference.units[name], target, name)
    return Trace(reference.time, columns) if columns else None


def _name_in_system(system: System, name: str) -> str:
    """Name of a signal in the system; a system of one FMU has only one component."""
    if len(system.components) > 1:
        return name
    return str(Port(next(iter(system.components)), name.partition(".")[2]))


def judge(
    result: Result,
    reference: Recording,
    layout: Layout,
    out: Path,
    facts: Mapping[str, Any],
    rate: bool = True,
    machine: Markup = Markup(),  # noqa: B008  immutable
) -> tuple[Validation, Path, Path]:
    """Compare a run with a reference and write report.html and report.json into the folder `out`.

    facts   settings of the run, in the order of the report
    rate    whether to compute the ISO/TS 18571 rating, which takes most of the time
    machine the machine that replays the run, as HTML
    """
    with doing(f"comparing {len(reference.signals)} signals"):
        validation = validate(result.trace, reference, rate=rate)
    layout.check(result.trace)
    report = reporting.Report(
        title=layout.title or f"Validation of {result.system.name}",
        validation=validation,
        figures=layout.figures or _figures(validation),
        trace=result.trace,
        facts=facts,
        components=[describe(c) for c in result.system.components.values()],
        parameters=list(parameters(result.system)),
        card=card(result),
        motion=layout.motion(result.trace),
        ghost=layout.motion(reference.trace()),
        machine=machine,
        warnings=result.card.warnings,
        notes=result.card.notes,
        caution=another_model(result.system, reference),
    )
    with doing(f"drawing {len(report.figures)} figures"):
        return validation, *reporting.write_report(out / "report.html", report)


def another_model(system: System, reference: Recording) -> str:
    """Note on a swapped system that is compared with a simulation; empty for other references."""
    swapped = [name for name, component in system.components.items() if component.replaced]
    if not swapped or reference.metadata.get("kind") != "simulation":
        return ""
    verb = "is" if len(swapped) == 1 else "are"
    return (
        f"{', '.join(swapped)} {verb} swapped: the reference was computed with another model, so "
        "expect differences"
    )


def other_numbers(system: Path, shipped: Recording | None, options: Mapping[str, Any]) -> str:
    """What differs in the numbers of a system from those of the shipped one; empty if nothing does.

    shipped   the reference that comes with the system, which was computed with the shipped numbers
    options   parameters and start values of the run
    """
    loaded = with_swaps(load(require_system(system)), options.get("swap") or {})
    chosen = with_sets(loaded, options.get("parameters") or ()).with_start(options.get("set") or {})
    built, own = built_notes(loaded), chosen_note(chosen)
    if shipped is None:
        return "\n".join(built)
    reason = "; ".join([*built, *([own] if own else [])])
    consequence = f"{shipped.heading} was computed with the shipped parameter values: expect differences"
    return f"{reason}\n{consequence}" if reason else ""


def describe(component: Component) -> reporting.ReportedComponent:
    """Data of one FMU for the report."""
    source = component.source
    file = source.members[-1] if source and source.members else source.path.name if source else ""
    interface = component.interface
    return reporting.ReportedComponent(
        component.name,
        file,
        interface.version,
        interface.guid,
        f"{interface.fmi}.0 CS",
        interface.tool,
        interface.description,
        checksum(source) if source else "",
    )


def parameters(system: System) -> Iterable[reporting.ReportedParameter]:
    """All parameters of a run, with their sources if the FMU contains `resources/parameters.toml`.

    Components without inputs, such as a program of lever strokes, are last.
    """
    others = {v.name: v for v in other_values(system)}
    for component in sorted(system.components.values(), key=lambda c: not c.interface.of("input")):
        sources = _provenance(component)
        for v in component.interface.of("parameter"):
            value = component.start.get(v.name, v.start if v.start is not None else "")
            of_list = sources.get(v.name.rpartition("_")[0] + "s", {})
            if isinstance(of_list.get("value"), list) and value == 0:
                continue  # an entry of a list that is not used
            provenance = sources.get(v.name, of_list)
            other = others.get(f"{component.name}.{v.name}")
            yield reporting.ReportedParameter(
                component=component.name,
                name=v.name,
                value=float(value) if v.is_real else value,
                unit=v.unit.name if v.unit else "",
                text=v.description,
                source=str(provenance.get("source", "")),
                note=str(provenance.get("note", "")),
                changed=_changed(v, component),
                shipped=None if other is None else other.shipped,
                origin=other.origin if other else "",
            )


def _changed(v: FmuVariable, component: Component) -> bool:
    """Does the value of a parameter differ from its start value in the FMU?"""
    value = component.start.get(v.name)
    return value is not None and (v.start is None or coerce(v.name, v, v.start) != value)


def _provenance(component: Component) -> Mapping[str, Mapping[str, Any]]:
    if component.source is None:
        return {}
    try:
        file = component.source.member("resources/parameters.toml")
        tables = toml.read(file, file.read(toml.MAX_BYTES)).data.get("parameters", {})
    except Problem:
        return {}  # other FMUs have no such file, or a different file of that name
    return tables if isinstance(tables, dict) else {}


def card(result: Result) -> Mapping[str, Any]:
    """The accuracy card for the report."""
    c = result.card
    return {
        "wall time [s]": round(c.wall, 3),
        "real-time factor": round(c.real_time_factor, 1),
        "steps": c.steps,
        **({"passes per step": round(c.passes / max(c.steps, 1), 2)} if c.passes > c.steps else {}),
        **({"steps repeated": c.repeated} if c.repeated else {}),
        "energy residual of the power bonds, share of the exchanged energy": {
            b.name: _bond(*c.bond(b)) for b in c.bonds
        },
    }


def _bond(residual: str, exchanged: str, share: str) -> str:
    joules = f"{residual} J of {exchanged} J"
    return share if not exchanged else joules if share == "-" else f"{share} ({joules})"


def _figures(validation: Validation) -> tuple[FigureSpec, ...]:
    """The default layout: one figure, a row per compared signal."""
    panels = tuple(PanelSpec(row.title, (row.signal,)) for row in validation.rows)
    return (FigureSpec("Signals", panels),) if panels else ()


def validate_system(
    system: Path,
    scenario: Path | None,
    reference: Path | None,
    layout: Path | None,
    out: Path,
    default: tuple[Path, Path],
    rate: bool = True,
    play: Sequence[str] = (),
    default_system: Path = DEFAULT_SYSTEM,
    monolithic: bool = False,
    limit: float | None = None,
    default_accuracy: float | None = None,
    **options: Unpack[RunArguments],
) -> bool:
    """Co-simulate, compare, write the trace and the report, print the table; True if no limit is exceeded.

    out      folder of run.csv, report.html and report.json
    default  reference and layout if none is given; this layout may contain signals that the run lacks
    rate     whether to compute the ISO/TS 18571 rating
    play     patterns of signals of the reference that are played with its commands, without a scenario
    default_system   system to which the default layout belongs, also with another reference
    monolithic       compare with the monolithic solution of the same FMUs
    limit            of the NRMSE of each signal of the monolithic solution, see `monolithic_recording`
    default_accuracy, options   as for `run_to_file`
    """
    doubts: list[str] = []
    _refuse_contradictions(scenario, reference, play, monolithic, limit)
    against = read_recording(reference or default[0])
    chosen = layout or (default[1] if reference is None or system == default_system else None)
    page = read_layout(chosen) if chosen else Layout()
    trace = out / "run.csv"
    commands = played(load(require_system(system)), against, play) if reference and not scenario else None

    def accept(system: System, times: Grid, signals: RowLayout) -> None:
        """Refuse what cannot be compared, before the first step."""
        ahead = _times_ahead(times, against)
        blank = Trace(ahead, dict.fromkeys(signals.names, np.zeros_like(ahead)), signals.units)
        selected, renamed = _comparable(system, blank, against, page)
        if not monolithic:
            check_comparable(renamed, selected)
        if layout:
            page.check(renamed)
        judged = [name for name in selected.signals if commands is None or name not in commands.signals]
        doubts.extend(doubtful_signals(system, selected.select(judged), str(reference)))

    shipped = against if reference is None and not monolithic else None
    if other := other_numbers(system, shipped, options):
        print(f"{other}\n", flush=True)
    result, file = run_to_file(
        system,
        scenario or commands,
        trace,
        every_point=False,
        accept=accept,
        default_accuracy=default_accuracy,
        **options,
    )
    of_reference: list[str] = []
    if monolithic:
        solved = solve_as_run(system, scenario, result, options)
        against = monolithic_recording(solved, against, [signal for _, signal in page.signals], limit)
        of_reference = [f"reference: {n}" for n in solved.card.notes if n not in result.card.notes]
    missing = _lost(result.system, against, result.trace)
    # in memory, also if the run is long
    against, recorded = _comparable(result.system, result.trace.select(result.trace.signals), against, page)
    notes = [
        *of_reference,
        _input_note(commands) if reference and not scenario else "",
        _default_reference_note(scenario, against) if scenario and not reference and not monolithic else "",
        another_model(result.system, against),
        f"not compared, because the swapped FMU has no such signal: {', '.join(sorted(missing))}"
        if missing
        else "",
        start_note(recorded, against) if commands else "",
    ]
    warnings = with_doubts(result.system, doubts).warnings[len(result.system.warnings) :]
    card = replace(
        result.card,
        notes=(*result.card.notes, *filter(None, notes)),
        warnings=(*result.card.warnings, *warnings),
    )
    result = replace(result, card=card)
    if not layout:
        default_title = page.title if reference is None and scenario is None and not monolithic else ""
        title = default_title or f"{(scenario or system).stem} against {against.heading}"
        page = replace(page.within(recorded), title=title)
    facts = _facts(system, scenario, against.heading, card, options)
    machine, reason = _machine(system, result, against)
    if reason:
        result = replace(result, card=replace(result.card, notes=(*result.card.notes, reason)))
    validation, html, data = judge(replace(result, trace=recorded), against, page, out, facts, rate, machine)
    Console().print(summary(validation))
    print(f"\n{card.text()}\n\nreport: {html}\nnumbers: {data}\ntrace: {file}")
    return validation.passed


def _refuse_contradictions(
    scenario: Path | None, reference: Path | None, play: Sequence[str], monolithic: bool, limit: float | None
) -> None:
    """Refuse options that have no meaning together."""
    if monolithic and reference:
        reason = "because the solution replaces it"
        raise Problem(f"--monolithic: expected no --reference, {reason}, got {reference}")
    if play and (scenario or not reference):
        raise Problem(f"--play {play[0]}: expected a --reference and no --scenario")
    if limit is not None and not monolithic:
        raise Problem(
            f"--limit {limit:g}: expected --monolithic; the limits of a --reference are in its TOML file"
        )
    if limit is not None and not 0 < limit < np.inf:
        raise Problem(f"--limit: expected a positive number, got {limit:g}")


def _comparable(system: System, trace: Trace, reference: Recording, page: Layout) -> tuple[Recording, Trace]:
    """Reference and run with the names under which they are compared.

    A reference of the default system contains signals that a swapped FMU lacks. They are left out.
    """
    lost = _lost(system, reference, trace)
    reference = reference.select([name for name in reference.signals if name not in lost])
    if len(system.components) > 1:
        return reference, trace
    reference = without_repetitions(reference)
    return reference, by_variable(trace, [*reference.signals, *(signal for _, signal in page.signals)])


def _lost(system: System, reference: Recording, trace: Trace) -> set[str]:
    """Signals of the reference that are lost in a swap."""
    return missing_after_swap(system).keys() & reference.signals.keys() - trace.signals.keys()


def _times_ahead(times: Grid, reference: Recording) -> Array:
    """The times that a run will record [s]; of an adaptive run, which may record any, those of interest."""
    if not times.free:
        return np.linspace(times.start, times.stop, times.rows)
    inside = (reference.time > times.start) & (reference.time < times.stop)
    return np.concatenate(([times.start], reference.time[inside], [times.stop]))


def _machine(system: Path, result: Result, reference: Recording) -> tuple[Markup, str]:
    """The machine that replays a run, empty for a system without a scene; or the reason why there is none."""
    try:
        return fragment(system, Replayed(result.trace, reference.trace()), shown=result.system), ""
    except Problem as problem:
        return Markup(), f"no machine in the report: {problem}"


def _input_note(commands: Trace | None) -> str:
    """Note on the inputs of a run without a scenario."""
    if commands is None:
        return "no --scenario given: the inputs are those of the system"
    return f"no --scenario given: {', '.join(commands.signals)} is taken from the reference"


def _default_reference_note(scenario: Path, against: Recording) -> str:
    """Note on the default reference, which may not fit."""
    other = f"which may have another scenario than {scenario}"
    return f"no --reference given: judged against {against.heading}, {other}"


def _facts(
    system: Path, scenario: Path | None, reference: str, card: Card, options: Mapping[str, Any]
) -> dict[str, Any]:
    """Settings of the run, in the order of the report."""
    facts = {
        "system": str(system),
        "scenario": str(scenario) if scenario else "none: the inputs are those of the system",
        "reference": reference,
        "master": card.master,
        **_steps(card),
        "simulated [s]": card.simulated,
    }
    for name in ("parameters", "cut"):
        facts |= {name: ", ".join(options[name])} if options.get(name) else {}
    facts |= {f"swap {name}": chosen for name, chosen in (options.get("swap") or {}).items()}
    return facts | {f"set {name}": value for name, value in options.get("set", {}).items()}


def _steps(card: Card) -> dict[str, Any]:
    if card.adaptive is None:
        return {"communication step [s]": card.step, "record step [s]": card.record_step}
    shortest, longest = card.lengths
    return {
        "tolerance of a step": card.adaptive,
        "communication step [s]": f"{shortest:.3g} to {longest:.3g}, on average {card.step:.3g}",
        "record step [s]": card.record_step or "every communication step",
    }
