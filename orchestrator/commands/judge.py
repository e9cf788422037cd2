"""Run, compare with a reference, report: what `harvester validate` does."""

from __future__ import annotations

import tomllib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from orchestrator.errors import Problem
from orchestrator.files.trace import Trace
from orchestrator.runs.simulation import Result
from orchestrator.system.interface import Variable
from orchestrator.system.system import Component, System, coerce
from orchestrator.validation import report as reporting
from orchestrator.validation.compare import Validation, compare
from orchestrator.validation.figures import FigureSpec, Panel
from orchestrator.validation.layout import Layout
from orchestrator.validation.reference import Reference


def judge(
    result: Result,
    reference: Reference,
    layout: Layout,
    out: Path,
    facts: Mapping[str, Any],
    rate: bool = True,
) -> tuple[Validation, Path, Path]:
    """Compare a run with a reference and write report.html and report.json into the folder `out`.

    facts   what ran, in the order to show
    rate    with the ISO/TS 18571 rating (its library takes some seconds to start)
    """
    validation = compare(result.trace, reference, rate=rate)
    layout.check(result.trace)
    ghost = Trace(reference.time, {name: s.values for name, s in reference.signals.items()})
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
        ghost=layout.motion(ghost),
        warnings=result.card.warnings,
        notes=result.card.notes,
        caution=another_model(result.system, reference),
    )
    return validation, *reporting.write_report(out / "report.html", report)


def another_model(system: System, reference: Reference) -> str:
    """What to say where a swapped system is compared with a simulation; empty where there is nothing."""
    swapped = [name for name, component in system.components.items() if component.replaced]
    if not swapped or reference.about.get("kind") != "simulation":
        return ""
    verb = "is" if len(swapped) == 1 else "are"
    return f"{', '.join(swapped)} {verb} swapped: the reference is of another model, expect a difference"


def describe(component: Component) -> reporting.Component:
    """One FMU of the run."""
    source = component.source
    file = source.inside[-1] if source and source.inside else source.path.name if source else ""
    face = component.interface
    return reporting.Component(
        component.name, file, face.version, face.guid, f"{face.fmi}.0 CS", face.tool, face.text
    )


def parameters(system: System) -> Iterable[reporting.Parameter]:
    """All parameters of a run; with provenance where the FMU carries its `resources/parameters.toml`."""
    for component in system.components.values():
        known = _provenance(component)
        for v in component.interface.of("parameter"):
            number = known.get(v.name, {})
            value = component.start.get(v.name, v.start if v.start is not None else "")
            yield reporting.Parameter(
                component=component.name,
                name=v.name,
                value=float(value) if v.is_real else value,
                unit=v.unit.name if v.unit else "",
                text=v.text,
                source=str(number.get("source", "")),
                note=str(number.get("note", "")),
                changed=_changed(v, component),
            )


def _changed(v: Variable, component: Component) -> bool:
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
    panels = tuple(Panel(row.title, (row.signal,)) for row in validation.rows)
    return (FigureSpec("Signals", panels),) if panels else ()
