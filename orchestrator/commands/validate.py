"""What `harvester validate` does: a run, its comparison with a reference, a report."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from rich.console import Console

from orchestrator.commands.begin import begins_elsewhere
from orchestrator.commands.commands import BUILT, contents, given, simulated, there
from orchestrator.commands.judge import another_model, judge
from orchestrator.commands.played import played
from orchestrator.errors import Problem
from orchestrator.files.trace import Trace, write
from orchestrator.runs.card import Card
from orchestrator.runs.sidecar import write_facts
from orchestrator.runs.simulation import Result
from orchestrator.system.ssp import load
from orchestrator.system.swap.lost import lost
from orchestrator.validation import read_reference, summary
from orchestrator.validation.layout import Layout, read_layout
from orchestrator.validation.matching import by_variable, once
from orchestrator.validation.reference import Reference


def validate(
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
    against = read_reference(reference or usual[0])
    chosen = layout or (usual[1] if reference is None or system == BUILT else None)
    shown = read_layout(chosen) if chosen else Layout()
    trace = out / "run.csv"
    commands = played(load(there(system)), against, play) if reference and not scenario else None
    result = simulated(system, scenario or commands, trace, **options, everywhere=False)
    if reference and not scenario:
        result = _noted(result, _ran(commands))
    if scenario and not reference:
        doubt = f"which may be of another scenario than {scenario}"
        result = _noted(result, f"no --reference given: judged against {against.title}, {doubt}")
    if told := another_model(result.system, against):
        result = _noted(result, told)
    result, against = _without_lost(result, against)
    write(result.trace, trace)
    write_facts(result, trace, given(scenario=scenario, **options))
    if len(result.system.components) == 1:
        against = once(against)
        known = by_variable(result.trace, [*against.signals, *(signal for _, signal in shown.named)])
        result = replace(result, trace=known)
    if not layout:
        named = shown.title if reference is None and scenario is None else ""
        title = named or f"{(scenario or system).stem} against {against.title}"
        shown = replace(shown.within(result.trace), title=title)
    if commands and (elsewhere := begins_elsewhere(result.trace, against)):
        result = _noted(result, elsewhere)
    facts = _facts(system, scenario, against.title, result.card, **options)
    validation, html, data = judge(result, against, shown, out, facts, rate)
    Console().print(summary(validation))
    print(f"\n{result.card.text()}\n\nreport: {html}\nnumbers: {data}\ntrace: {contents(result, trace)}")
    return validation.passed


def _ran(commands: Trace | None) -> str:
    """What ran where nobody gave a scenario."""
    if commands is None:
        return "no --scenario given: ran what the system plays by itself"
    return f"no --scenario given: played {', '.join(commands.signals)} of the reference"


def _without_lost(result: Result, against: Reference) -> tuple[Result, Reference]:
    """A reference of the usual system knows signals that a swapped FMU has not: they are left out."""
    gone = lost(result.system).keys() & against.signals.keys() - result.trace.signals.keys()
    if not gone:
        return result, against
    kept = {name: signal for name, signal in against.signals.items() if name not in gone}
    told = _noted(result, f"not compared, lost in a swap: {', '.join(sorted(gone))}")
    return told, replace(against, signals=kept)


def _noted(result: Result, note: str) -> Result:
    return replace(result, card=replace(result.card, notes=(*result.card.notes, note)))


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
