"""What `harvester validate` does: run, compare with a reference, report.

Without a scenario, the run plays the commands that the reference holds: what the operator did.
"""

from __future__ import annotations

import tomllib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from orchestrator.base.errors import Problem
from orchestrator.base.files import DEFAULT_SYSTEM, require_system
from orchestrator.base.units import convert
from orchestrator.data.recording import Recording, fill_gaps, read_recording
from orchestrator.data.trace import Trace, write
from orchestrator.engine.result import Card, Result, write_metadata
from orchestrator.engine.run import file_summary, requested_options, run_or_save
from orchestrator.fmi.description import FmuVariable
from orchestrator.results import validation_report as reporting
from orchestrator.results.layout import FigureSpec, Layout, PanelSpec, read_layout
from orchestrator.results.summary import summary
from orchestrator.results.validation import Validation, by_variable, once, validate
from orchestrator.ssp.load import load
from orchestrator.ssp.swap import missing_after_swap
from orchestrator.ssp.system import Component, Port, System, coerce

POSITIONS = ("rad", "m")
APART = 0.05  # of what the reference moves: more than noise and settling


def begins_elsewhere(run: Trace, reference: Recording) -> str:
    """A sentence on positions at which a run begins, if they are not those of the reference; else nothing.

    Commands alone do not say where a machine stands, and from another pose it answers them differently.
    """
    recorded = reference.trace()
    begins = recorded.at(run.time[:1])
    off, moved = {}, 0.0
    for name, values in recorded.signals.items():
        unit = run.units.get(name, "")
        if name in run.signals and unit in POSITIONS and unit == recorded.units[name]:
            apart = float(run[name][0] - begins[name][0])
            off[f"{name} by {apart:.3g} {unit}"] = abs(apart)
            moved = max(moved, float(np.ptp(values)))
    far = ", ".join(text for text, apart in off.items() if apart > APART * moved)
    return f"the run begins elsewhere than the reference: {far}; --set gives a start" if far else ""


def played(system: System, reference: Recording, also: Sequence[str] = ()) -> Trace | None:
    """The signals of a reference that are inputs from outside the system, as a scenario; None without any.

    From outside are inputs that nothing feeds and those that a component without inputs of its own feeds,
    such as levers. What another component computes stays its business: such signals are compared.

    also   patterns of further signals that are played all the same, such as a measured supply pressure
    """
    for pattern in also:
        if not any(fnmatchcase(name, pattern) for name in reference.signals):
            told = ", ".join(reference.signals)
            raise Problem(f"--play {pattern}: no such signal in {reference.source}, expected of {told}")
    inputs = {str(p) for p in system.ports("input")}
    sources = {n for n, c in system.components.items() if not c.interface.of("input")}
    outside = {str(p) for p in system.exposed}
    outside |= {str(c.target) for c in system.connections if c.source.component in sources}
    columns = {}
    for name in reference.signals:
        port = _known(system, name)
        wanted = any(fnmatchcase(name, pattern) for pattern in also)
        if wanted and port not in inputs:
            raise Problem(f"--play: {name} is no input of {system.name}, expected one")
        if port not in outside and not wanted:
            continue
        unit = system.unit(system.port(port))
        own = unit.name if unit else reference.file_units.get(name, reference.units[name])
        columns[port] = convert(fill_gaps(reference, name), reference.units[name], own, name)
    return Trace(reference.time, columns) if columns else None


def _known(system: System, name: str) -> str:
    """The system's name of a signal; a system of one FMU has its variables under one name."""
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
) -> tuple[Validation, Path, Path]:
    """Compare a run with a reference and write report.html and report.json into the folder `out`.

    facts   what ran, in the order to show
    rate    with the ISO/TS 18571 rating, most of the time of a comparison
    """
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
        warnings=result.card.warnings,
        notes=result.card.notes,
        caution=another_model(result.system, reference),
    )
    return validation, *reporting.write_report(out / "report.html", report)


def another_model(system: System, reference: Recording) -> str:
    """What to say where a swapped system is compared with a simulation; empty where there is nothing."""
    swapped = [name for name, component in system.components.items() if component.replaced]
    if not swapped or reference.metadata.get("kind") != "simulation":
        return ""
    verb = "is" if len(swapped) == 1 else "are"
    return f"{', '.join(swapped)} {verb} swapped: the reference is of another model, expect a difference"


def describe(component: Component) -> reporting.ReportedComponent:
    """One FMU of the run."""
    source = component.source
    file = source.members[-1] if source and source.members else source.path.name if source else ""
    face = component.interface
    return reporting.ReportedComponent(
        component.name, file, face.version, face.guid, f"{face.fmi}.0 CS", face.tool, face.description
    )


def parameters(system: System) -> Iterable[reporting.ReportedParameter]:
    """All parameters of a run; with provenance where the FMU carries its `resources/parameters.toml`."""
    for component in system.components.values():
        known = _provenance(component)
        for v in component.interface.of("parameter"):
            number = known.get(v.name, {})
            value = component.start.get(v.name, v.start if v.start is not None else "")
            yield reporting.ReportedParameter(
                component=component.name,
                name=v.name,
                value=float(value) if v.is_real else value,
                unit=v.unit.name if v.unit else "",
                text=v.description,
                source=str(number.get("source", "")),
                note=str(number.get("note", "")),
                changed=_changed(v, component),
            )


def _changed(v: FmuVariable, component: Component) -> bool:
    """Is the value of a parameter another one than the FMU's own?"""
    value = component.start.get(v.name)
    return value is not None and (v.start is None or coerce(v.name, v, v.start) != value)


def _provenance(component: Component) -> Mapping[str, Mapping[str, Any]]:
    if component.source is None:
        return {}
    try:
        text = component.source.member("resources/parameters.toml").read().decode("utf-8")
        tables = tomllib.loads(text).get("parameters", {})
    except (Problem, UnicodeDecodeError, tomllib.TOMLDecodeError):
        return {}  # FMUs from elsewhere carry no such file, or another one of that name
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
    """Without a layout: one figure, a row per compared signal."""
    panels = tuple(PanelSpec(row.title, (row.signal,)) for row in validation.rows)
    return (FigureSpec("Signals", panels),) if panels else ()


def validate_system(
    system: Path,
    scenario: Path | None,
    reference: Path | None,
    layout: Path | None,
    out: Path,
    usual: tuple[Path, Path],
    rate: bool = True,
    play: Sequence[str] = (),
    **options: Any,
) -> bool:
    """Co-simulate, compare, write the trace and the report, print the table; True when no limit is missed.

    out     the folder of run.csv, report.html and report.json
    usual   reference and layout where none is given; that layout may name signals that the run lacks
    rate    with the ISO/TS 18571 rating
    play    patterns of signals of the reference that go in, beside its commands, where there is no scenario
    """
    if play and (scenario or not reference):
        raise Problem(f"--play {play[0]}: expected a --reference and no --scenario")
    against = read_recording(reference or usual[0])
    chosen = layout or (usual[1] if reference is None or system == DEFAULT_SYSTEM else None)
    shown = read_layout(chosen) if chosen else Layout()
    trace = out / "run.csv"
    commands = played(load(require_system(system)), against, play) if reference and not scenario else None
    result = run_or_save(system, scenario or commands, trace, **options, every_point=False)
    # a reference of the usual system knows signals that a swapped FMU has not
    gone = missing_after_swap(result.system).keys() & against.signals.keys() - result.trace.signals.keys()
    against = against.select([name for name in against.signals if name not in gone])
    recorded = result.trace
    if len(result.system.components) == 1:
        against = once(against)
        recorded = by_variable(recorded, [*against.signals, *(signal for _, signal in shown.signals)])
    notes = [
        _drive(commands) if reference and not scenario else "",
        _doubt(scenario, against) if scenario and not reference else "",
        another_model(result.system, against),
        f"not compared, lost in a swap: {', '.join(sorted(gone))}" if gone else "",
        begins_elsewhere(recorded, against) if commands else "",
    ]
    card = replace(result.card, notes=(*result.card.notes, *filter(None, notes)))
    result = replace(result, card=card)
    write(result.trace, trace)
    write_metadata(result, trace, requested_options(scenario=scenario, **options))
    if not layout:
        named = shown.title if reference is None and scenario is None else ""
        title = named or f"{(scenario or system).stem} against {against.heading}"
        shown = replace(shown.within(recorded), title=title)
    facts = _facts(system, scenario, against.heading, card, **options)
    validation, html, data = judge(replace(result, trace=recorded), against, shown, out, facts, rate)
    Console().print(summary(validation))
    print(f"\n{card.text()}\n\nreport: {html}\nnumbers: {data}\ntrace: {file_summary(result, trace)}")
    return validation.passed


def _drive(commands: Trace | None) -> str:
    """What drove the run where nobody gave a scenario."""
    if commands is None:
        return "no --scenario given: ran what the system plays by itself"
    return f"no --scenario given: played {', '.join(commands.signals)} of the reference"


def _doubt(scenario: Path, against: Recording) -> str:
    """Why the usual reference may not fit."""
    doubt = f"which may be of another scenario than {scenario}"
    return f"no --reference given: judged against {against.heading}, {doubt}"


def _facts(system: Path, scenario: Path | None, reference: str, card: Card, **options: Any) -> dict[str, Any]:
    """What ran, in the order to show."""
    facts = {
        "system": str(system),
        "scenario": str(scenario) if scenario else "none: what the system plays by itself",
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
