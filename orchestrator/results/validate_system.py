"""`harvester validate`: run a system, compare it with a reference, write the report.

Without a scenario the commands in the reference are the scenario. The monolithic solution of the same FMUs
can replace a reference, with the limits of its signals.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup

from orchestrator.base import toml
from orchestrator.base.errors import Problem
from orchestrator.base.extras import require
from orchestrator.base.files import DEFAULT_SYSTEM, require_system
from orchestrator.base.progress import doing
from orchestrator.base.signals import moves, rms, selected
from orchestrator.base.units import convert, factor_and_offset
from orchestrator.data.description import Tolerance
from orchestrator.data.recording import Criterion, Recording, fill_gaps, read_recording
from orchestrator.data.table import Array
from orchestrator.data.trace import Trace
from orchestrator.data.trace_writer import RowLayout
from orchestrator.drive.page import Replayed, fragment
from orchestrator.engine.options import RunOptions
from orchestrator.engine.result import Card, Result, ranges, widest_of_unit
from orchestrator.engine.run import run_to_file
from orchestrator.engine.time_grid import Grid
from orchestrator.fmi.interface import MODEL_EXCHANGE
from orchestrator.monolithic.reference import SOLVER, reference
from orchestrator.results.layout import FigureSpec, Layout, PanelSpec, read_layout
from orchestrator.results.metrics import AT_REST
from orchestrator.results.report import Report
from orchestrator.results.validation import (
    Validation,
    by_variable,
    check_comparable,
    rated,
    validate,
    without_repetitions,
)
from orchestrator.results.validation_report import validation_report
from orchestrator.ssp.load import configured, load
from orchestrator.ssp.plausible import doubtful_end, doubtful_signals, refuse_long, with_doubts
from orchestrator.ssp.provenance import built_notes, checksum, chosen_note, other_values
from orchestrator.ssp.swap import missing_after_swap
from orchestrator.ssp.system import Component, Port, System, coerce

POSITIONS = ("rad", "m")
START_TOLERANCE = 0.05  # relative to the range of the reference: more than noise and settling
LEAST_DELAY = 0.005  # s, more than the coupling delays an input


def start_note(run: Trace, reference: Recording) -> str:
    """Note on start positions that differ from those of the reference; empty if there are none.

    Commands do not determine the start position of a machine, and its response depends on that position.
    """
    recorded = reference.without_gaps()
    names = [n for n, unit in recorded.units.items() if unit in POSITIONS and run.units.get(n, "") == unit]
    names = [name for name in names if name in run.signals and name not in reference.unlisted]
    least = START_TOLERANCE * max((float(np.ptp(recorded[name])) for name in names), default=0.0)
    start = recorded.at(run.time[:1])
    offsets = {name: float(run[name][0] - start[name][0]) for name in names}
    large = ", ".join(f"{n} by {x:.3g} {run.units[n]}" for n, x in offsets.items() if abs(x) > least)
    note = f"the start of the run differs from the reference: {large}; --set changes the start values"
    return note if large else ""


def delay_note(run: Trace, reference: Recording) -> str:
    """Warning that all errors would be half as large if the commands acted at another time; else empty.

    The delay minimises the squares of all errors over the variances of their signals, by Gauss and Newton.
    """
    recorded = reference.without_gaps().at(run.time)
    moving = [n for n in recorded if n in run.signals and moves(recorded[n])]
    names = [n for n in moving if not np.allclose(run[n], recorded[n])]  # without what was played
    delay, errors = 0.0, list[float]()
    for _ in range(10 * bool(names)):
        later = run[names].at(run.time - delay)
        sizes = {n: float(np.std(recorded[n])) for n in names}
        error = np.stack([(recorded[n] - later[n]) / size for n, size in sizes.items()])
        slope = np.stack([np.gradient(later[n] / size, run.time) for n, size in sizes.items()])
        errors.append(rms(error))
        if not slope.any():  # a run in which nothing moves
            return ""
        delay -= float(np.sum(error * slope) / np.sum(slope**2))
    if abs(delay) < LEAST_DELAY or errors[-1] > errors[0] / 2:
        return ""
    act = f"the commands act {abs(delay):.2g} s {'later' if delay > 0 else 'earlier'} than the reference"
    less = f"makes all errors {errors[0] / errors[-1]:.2g} times smaller"
    return f"{act} states: `delay = {delay:.2g}`, or that much more, {less}"


def played(system: System, reference: Recording, also: Sequence[str] = ()) -> Trace | None:
    """The signals of a reference that are external inputs of the system, as a scenario; None without any.

    External inputs are not connected, or connected to a component without inputs, such as operator_input.
    Signals that another component computes are compared instead.

    also   patterns of further signals that are played, such as a measured supply pressure
    """
    names = ", ".join(reference.signals)
    expected = f"expected a signal of {reference.source}: {names}"
    requested = selected(reference.signals, also, lambda pattern: f"--play {pattern}: {expected}")
    inputs = {str(p) for p in system.ports("input")}
    sources = {n for n, c in system.components.items() if not c.interface.of("input")}
    external = {str(p) for p in system.exposed}
    external |= {str(c.target) for c in system.connections if c.source.component in sources}
    columns, (first, *others) = {}, system.components
    for name in reference.signals:
        # a system of one FMU has only one component
        port = name if others else str(Port(first, name.partition(".")[2]))
        if name in requested and port not in inputs:
            raise Problem(f"--play: expected an input of {system.name}, got {name}")
        if (port not in external or name in reference.unlisted) and name not in requested:
            continue
        unit = system.unit(system.port(port))
        target = unit.name if unit else reference.file_units.get(name, reference.units[name])
        factor_and_offset(reference.file_units.get(name, target), target, reference.place(name))
        columns[port] = convert(
            fill_gaps(reference, name), reference.units[name], target, reference.place(name)
        )
    return Trace(reference.time, columns) if columns else None


def _with_units(system: System, reference: Recording) -> Recording:
    """The reference; a signal of a file without units has the unit of the system."""
    ports = {n: system.port(n) for n in reference.signals if not reference.units[n] and system.has(n)}
    units = {name: unit.name for name, port in ports.items() if (unit := system.unit(port))}
    return replace(reference, units={**reference.units, **units})


def judge(
    result: Result,
    reference: Recording,
    layout: Layout,
    out: Path,
    facts: Mapping[str, Any],
    machine: Markup = Markup(),  # noqa: B008  immutable
    rate: bool = False,
) -> tuple[Validation, Report, Path, Path]:
    """Compare a run with a reference and write report.html and report.json into the folder `out`.

    layout  without figures there is one, with a row per compared signal
    facts   settings of the run, in the order of the report
    machine the machine that replays the run, as HTML
    rate    whether to rate the listed signals by ISO/TS 18571, too
    """
    with doing(f"comparing {len(reference.signals)} signals"):
        validation = validate(result.trace, reference, rate=rate)
    validation = replace(validation, unreliable=result.card.unreliable)
    layout.check(result.trace)
    panels = tuple(PanelSpec(row.title, (row.signal,)) for row in validation.rows)
    run = {
        "facts": facts,
        "accuracy": result.card,
        "components": [describe(c) for c in result.system.components.values()],
        "parameters": list(parameters(result.system)),
        "warnings": result.card.warnings,
        "notes": result.card.notes,
    }
    found = validation_report(
        layout.title or f"Validation of {result.system.name}",
        validation,
        layout.figures or ((FigureSpec("Signals over time", panels),) if panels else ()),
        result.trace,
        run,
        machine,
        caution="; ".join(filter(None, (*result.card.unreliable, another_model(result.system, reference)))),
    )
    with doing("writing the report"):
        return validation, found, *found.write(out / "report.html")


def another_model(system: System, reference: Recording) -> str:
    """Note on a swapped system that is compared with a simulation; empty for other references."""
    swapped = [name for name, component in system.components.items() if component.replaced]
    if not swapped or reference.metadata.get("kind") != "simulation":
        return ""
    verb = "is" if len(swapped) == 1 else "are"
    cause = "the reference was computed with another model"
    return f"{', '.join(swapped)} {verb} swapped: {cause}, so expect differences"


def other_numbers(system: Path, shipped: Recording | None, options: RunOptions) -> str:
    """What differs in the numbers of a system from those of the shipped one; empty if nothing does.

    shipped   the reference that comes with the system, which was computed with the shipped numbers
    options   parameters and start values of the run
    """
    loaded = configured(require_system(system), swap=options.swap)
    chosen = configured(loaded, parameters=options.parameters, set=options.set)
    built, own = built_notes(loaded), chosen_note(chosen)
    if shipped is None:
        return "\n".join(built)
    reason = "; ".join(filter(None, [*built, own]))
    consequence = f"{shipped.heading} was computed with the shipped parameter values: expect differences"
    return f"{reason}\n{consequence}" if reason else ""


def describe(component: Component) -> dict[str, str]:
    """Data of one FMU for the report."""
    source, model = component.source, component.interface.model
    return {
        "name": component.name,
        "file": source.members[-1] if source and source.members else source.path.name if source else "",
        "version": model.get("version"),
        "guid": model.token,
        "fmi": f"{model.major}.0 {'ME' if component.interface.kind == MODEL_EXCHANGE else 'CS'}",
        "tool": model.get("generationTool"),
        "text": model.get("description"),
        "sha256": checksum(source) if source else "",
    }


def parameters(system: System) -> Iterator[dict[str, Any]]:
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
            known = sources.get(v.name, of_list)
            shipped = None if v.start is None else coerce(v.name, v, v.start)
            other = others.get(f"{component.name}.{v.name}")
            yield {
                "component": component.name,
                "name": v.name,
                "value": float(value) if v.is_real else value,
                "unit": v.unit.name if v.unit else "",
                "text": v.description,
                "source": str(known.get("source", "")),
                "note": str(known.get("note", "")),
                "changed": v.name in component.start and shipped != component.start[v.name],
                "shipped": other and other.shipped,
                "origin": other.origin if other else "",
            }


def _provenance(component: Component) -> Mapping[str, Mapping[str, Any]]:
    if component.source is None:
        return {}
    try:
        file = component.source.member("resources/parameters.toml")
        tables = toml.read(file, file.read(toml.MAX_BYTES)).data.get("parameters", {})
    except Problem:
        return {}  # other FMUs have no such file, or a different file of that name
    return tables if isinstance(tables, dict) else {}


@dataclass(frozen=True)
class Experiment:
    """A run, and what it is compared with.

    default          reference and layout if none is given; this layout may contain signals that the run lacks
    play             patterns of signals of the reference that are played with its commands if there is no
                     scenario
    default_system   system to which the default layout belongs, also with another reference
    monolithic       compare with the monolithic solution of the same FMUs
    limit            of the NRMSE of each signal of the monolithic solution, see `monolithic_recording`
    rate             rate the listed signals by ISO/TS 18571, too
    options          of the run
    """

    system: Path
    default: tuple[Path, Path]
    scenario: Path | None = None
    reference: Path | None = None
    layout: Path | None = None
    play: Sequence[str] = ()
    default_system: Path = DEFAULT_SYSTEM
    monolithic: bool = False
    limit: float | None = None
    rate: bool = False
    options: RunOptions = field(default_factory=RunOptions)

    def check(self) -> None:
        """Refuse options that have no meaning together."""
        limit, play = self.limit, self.play
        if self.monolithic:  # before the run
            require("reference", "the reference solution", "sksundae")
        if self.monolithic and self.reference:
            reason = "because the solution replaces it"
            raise Problem(f"--monolithic: expected no --reference, {reason}, got {self.reference}")
        if play and (self.scenario or not self.reference):
            raise Problem(f"--play {play[0]}: expected a --reference and no --scenario")
        if limit is not None and not self.monolithic:
            reason = "the limits of a --reference are in its TOML file"
            raise Problem(f"--limit {limit:g}: expected --monolithic; {reason}")
        if limit is not None and not 0 < limit < np.inf:
            raise Problem(f"--limit: expected a positive number, got {limit:g}")

    def against(self) -> tuple[Recording, Trace | None]:
        """The reference, and the commands in it that are the scenario; None with another one."""
        against = read_recording(self.reference or self.default[0])
        if not self.reference:
            return against, None
        against = _with_units(loaded := load(require_system(self.system)), against)
        commands = None if self.scenario else played(loaded, against, self.play)
        if commands and self.options.stop is None and not self.options.yes:
            refuse_long(loaded, against, str(self.reference))
        return against, commands

    def page(self) -> Layout:
        """The layout of the report."""
        has_default = self.reference is None or self.system == self.default_system
        chosen = self.layout or (self.default[1] if has_default else None)
        return read_layout(chosen) if chosen else Layout()

    def solved(self, run: Result, against: Recording, page: Layout) -> tuple[Recording, list[str]]:
        """What a run is compared with in the end: the reference, or the solution of its FMUs; and notes."""
        if self.monolithic:
            solved, limit = solve_as_run(self.system, self.scenario, run, self.options), self.limit
            if limit is None and (self.scenario or self.options.swap):
                limit = LIMIT  # limits of the shipped reference are for the work cycle of the shipped machine
            against = monolithic_recording(solved, against, [signal for _, signal in page.signals], limit)
            return against, [f"reference: {n}" for n in solved.card.notes if n not in run.card.notes]
        if self.scenario and not self.reference:
            other = f"which may have another scenario than {self.scenario}"
            return against, [f"no --reference given: judged against {against.heading}, {other}"]
        return against, []

    def title(self, page: Layout, against: Recording) -> str:
        """The title of a report without a layout of the user."""
        is_default = self.reference is None and self.scenario is None and not self.monolithic
        own = page.title if is_default else ""
        return own or f"{(self.scenario or self.system).stem} against {against.heading}"


def validate_system(
    of: Experiment,
    out: Path,
    default_accuracy: float | None = None,
    report: Callable[[str], object] = lambda _: None,
) -> tuple[Validation, str]:
    """Co-simulate, compare, write the trace and the report; returns comparison, and what to print.

    out      folder of run.csv, report.html and report.json
    default_accuracy   as for `run_to_file`
    report           called before the run with what differs in the numbers of the system, if anything does
    """
    of.check()
    (against, commands), page = of.against(), of.page()
    rated(against, of.rate)  # before the run
    doubts = [*against.log_faults()]

    def accept(system: System, times: Grid, signals: RowLayout) -> None:
        """Refuse what cannot be compared, before the first step."""
        ahead = _times_ahead(times, against)
        blank = Trace(ahead, dict.fromkeys(signals.names, np.zeros_like(ahead)), signals.units)
        selected, renamed = comparable(system, blank, against, page)
        if not of.monolithic:
            check_comparable(renamed, selected)
        if of.layout:
            page.check(renamed)
        judged = [name for name in selected.signals if commands is None or name not in commands.signals]
        doubts.extend(doubtful_signals(system, selected.select(judged), str(of.reference)))
        if commands is None:  # else the run tells it
            doubts.append(doubtful_end(system, selected, str(of.reference)))

    shipped = against if of.reference is None and not of.monolithic else None
    if other := other_numbers(of.system, shipped, of.options):
        report(f"{other}\n")
    result, file = run_to_file(
        of.system,
        of.scenario or commands,
        out / "run.csv",
        every_point=False,
        accept=accept,
        default_accuracy=default_accuracy,
        options=of.options,
    )
    against, notes = of.solved(result, against, page)
    if of.reference and not of.scenario:
        inputs = list(commands.signals) if commands else []
        taken = f"{', '.join(inputs)} {'are' if len(inputs) > 1 else 'is'} taken from the reference"
        notes.append(f"no --scenario given: {taken if inputs else 'the inputs are those of the system'}")
    notes.append(another_model(result.system, against))
    if missing := _lost(result.system, against, result.trace):
        names = ", ".join(sorted(missing))
        notes.append(f"not compared, because they are not in the run: {names}")
    # in memory, also if the run is long
    against, recorded = comparable(result.system, result.trace.select(result.trace.signals), against, page)
    notes.append(start_note(recorded, against) if commands else "")
    doubts.append(delay_note(recorded, against) if commands else "")
    result = result.noted(*filter(None, notes))
    warnings = with_doubts(result.system, doubts).warnings[len(result.system.warnings) :]
    card = replace(result.card, warnings=(*result.card.warnings, *warnings))
    result = replace(result, card=card)
    if not of.layout:
        page = replace(page.within(recorded), title=of.title(page, against))
    facts = _facts(of.system, of.scenario, against.heading, card, of.options)
    machine, reason = _machine(of.system, result, against)
    result = result.noted(reason) if reason else result
    result = replace(result, trace=recorded)
    validation, found, html, data = judge(result, against, page, out, facts, machine, of.rate)
    files = f"report: {html}\nnumbers: {data}\ntrace: {file}"
    return validation, f"{found.text()}\n\n{card.text()}\n\n{files}"


def comparable(system: System, trace: Trace, reference: Recording, page: Layout) -> tuple[Recording, Trace]:
    """Reference and run with the names under which they are compared.

    A reference of the default system contains signals that a swapped FMU lacks. They are left out.
    """
    lost = _lost(system, reference, trace)
    reference = reference.select([name for name in reference.signals if name not in lost])
    if len(system.components) > 1:
        return reference, trace
    reference, inputs = without_repetitions(reference), {port.variable for port in system.exposed}
    # what is set from outside is not judged, but for commands
    names = [n for n in reference.signals if not (n in reference.unlisted and n.partition(".")[2] in inputs)]
    reference = reference.select(names)
    return reference, by_variable(trace, [*reference.signals, *(signal for _, signal in page.signals)])


def _lost(system: System, reference: Recording, trace: Trace) -> set[str]:
    """Signals of the reference that are lost in a swap, or of an operator that its commands replace."""
    sources = (c for c in system.components.values() if not c.interface.of("input"))
    replaced = {f"{c.name}.{v.name}" for c in sources for v in c.interface.of("output")}
    return (missing_after_swap(system).keys() | replaced) & reference.signals.keys() - trace.signals.keys()


def _times_ahead(times: Grid, reference: Recording) -> Array:
    """The times that a run will record [s]; of an adaptive run, which may record any, those of interest."""
    if not times.free:
        return np.linspace(times.start, times.stop, times.rows)
    inside = (reference.time > times.start) & (reference.time < times.stop)
    return np.concatenate(([times.start], reference.time[inside], [times.stop]))


def _machine(system: Path, result: Result, reference: Recording) -> tuple[Markup, str]:
    """The machine that replays a run, empty for a system without a scene; or the reason why there is none."""
    try:
        return fragment(system, Replayed(result.trace, reference.without_gaps()), shown=result.system), ""
    except Problem as problem:
        return Markup(), f"no machine in the report: {problem}"


def _facts(
    system: Path, scenario: Path | None, reference: str, card: Card, options: RunOptions
) -> dict[str, Any]:
    """Settings of the run, in the order of the report."""
    facts: dict[str, Any] = {
        "system": str(system),
        "scenario": str(scenario) if scenario else "none: the inputs are those of the system",
        "reference": reference,
        "master": card.master,
        "simulated [s]": card.simulated,
    }
    for name, chosen in (("parameters", options.parameters), ("cut", options.cut)):
        facts |= {name: ", ".join(map(str, chosen))} if chosen else {}
    facts |= {f"swap {name}": fmu for name, fmu in options.swap.items()}
    return facts | {f"set {name}": value for name, value in options.set.items()}


LIMIT = 0.01  # of NRMSE; `jacobi` at 5 ms fails it


def solve_as_run(system: Path, scenario: Path | None, run: Result, options: RunOptions) -> Result:
    """The monolithic solution over the times of a run, which had these options."""
    start, stop = (float(run.trace.time[k]) for k in (0, -1))
    record_step = run.card.record_step or run.card.step
    with doing("computing the monolithic solution"):
        return reference(
            system,
            scenario,
            start=start,
            stop=stop,
            record_step=record_step,
            swap=options.swap,
            parameters=options.parameters,
            set=options.set,
            cut=options.cut,
        )


def monolithic_recording(
    solved: Result, shipped: Recording, names: Sequence[str] = (), limit: float | None = None
) -> Recording:
    """A monolithic solution as a reference.

    shipped   its labels and limits, over its ranges, apply to its signals; all other outputs have LIMIT
    names     further names that the signals of a system of one FMU may get, see `by_variable`
    limit     of the NRMSE of all outputs, in place of these limits

    The NRMSE of a constant output is over its nominal value, else over its magnitude or the largest range in
    its unit, else over 1.
    """
    trace, spans, nominals = solved.trace, _spans_of_constants(solved), solved.system.nominals
    if len(solved.system.components) == 1:
        trace = by_variable(trace, (*shipped.signals, *names))
    own = dict(zip(trace.signals, solved.trace.signals, strict=True))
    outputs, criteria = {*map(str, solved.system.ports("output"))}, dict[str, Criterion]()
    usual = Tolerance("nrmse", LIMIT if limit is None else limit)
    for name in [n for n in dict.fromkeys((*shipped.signals, *trace.signals)) if n in own]:
        known, size = shipped.criterion(name), float(np.ptp(shipped.signals.get(name, np.zeros(1))))
        floor = AT_REST * max(size, abs(nominals.get(own[name]) or 0.0))
        constant = max(spans[own[name]], floor) if own[name] in spans else None
        if limit is None and name in shipped.signals:  # in a short run a signal hardly moves
            criteria[name] = replace(known, span=known.span or size or constant)
        elif own[name] in outputs:
            criteria[name] = replace(known, span=constant, tolerance=usual, floor=floor)
    monolithic = solved.card.master == SOLVER
    return Recording(
        trace.time,
        {name: trace[name] for name in criteria},
        {name: trace.units.get(name, "") for name in criteria},
        Path("monolithic solution"),
        kind="simulation",
        criteria=criteria,
        metadata={
            "title": "Monolithic solution of the FMUs" if monolithic else "Co-simulation with a small step",
            "kind": "simulation of the same FMUs",
            "solver": solved.card.master,
        },
    )


def _spans_of_constants(solved: Result) -> dict[str, float]:
    """What replaces the range of outputs that are constant but for rounding."""
    nominals = solved.system.nominals
    outputs = solved.trace.select(name for name in nominals if name in solved.trace.signals)
    varying = ranges(outputs, nominals)
    constant = {n: float(np.abs(values).max()) for n, values in outputs.items() if n not in varying}
    widest = widest_of_unit({**dict.fromkeys(constant, 0.0), **varying}, outputs.units)
    return {n: abs(nominals[n] or max(magnitude, widest[n]) or 1.0) for n, magnitude in constant.items()}
