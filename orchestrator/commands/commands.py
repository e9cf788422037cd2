"""What the commands of the command line do; prints results, raises Problem for mistakes."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from orchestrator.coupling.grid import RECORD, communication_step, thinned
from orchestrator.errors import Problem
from orchestrator.files.sidecar import write_facts
from orchestrator.files.trace import check_suffix, write
from orchestrator.runs.card import Card
from orchestrator.runs.simulation import Interrupted, Result, RunFailed
from orchestrator.runs.simulation import run as simulate
from orchestrator.system.ssp import load
from orchestrator.system.swap.lost import lost

if TYPE_CHECKING:
    from orchestrator.validation.reference import Reference  # it takes a while to load

BUILT, MAKE = Path("build/harvester.ssp"), "harvester build"


def run(system: Path, scenario: Path | None, out: Path, **options: Any) -> None:
    """Co-simulate, write the trace, print the accuracy card; an aborted run leaves its trace too."""
    save(simulated(system, scenario, out, **options), out, given(scenario=scenario, **options))


def validate(
    system: Path,
    scenario: Path | None,
    reference: Path | None,
    layout: Path | None,
    out: Path,
    usual: tuple[Path, Path],
    rate: bool = True,
    **options: Any,
) -> bool:
    """Co-simulate, compare, write the trace and the report, print the table; True when no limit is missed.

    out     the folder of run.csv, report.html and report.json
    usual   reference and layout where none is given; that layout may name signals that the run lacks
    rate    with the ISO/TS 18571 rating
    """
    from rich.console import Console

    from orchestrator.commands.judge import another_model, judge
    from orchestrator.validation import read_reference, summary
    from orchestrator.validation.layout import Layout, read_layout
    from orchestrator.validation.matching import by_variable

    against = read_reference(reference or usual[0])
    chosen = layout or (usual[1] if reference is None or system == BUILT else None)
    shown = read_layout(chosen) if chosen else Layout()
    trace = out / "run.csv"
    result = simulated(system, scenario, trace, **options, everywhere=False)
    if reference and not scenario and not options.get("parameters"):
        result = _noted(result, "no --scenario given: ran what the system plays by itself")
    if scenario and not reference:
        doubt = f"which may be of another scenario than {scenario}"
        result = _noted(result, f"no --reference given: judged against {against.title}, {doubt}")
    if told := another_model(result.system, against):
        result = _noted(result, told)
    result, against = _without_lost(result, against)
    write(result.trace, trace)
    write_facts(result, trace, given(scenario=scenario, **options))
    if len(result.system.components) == 1:
        known = by_variable(result.trace, [*against.signals, *(signal for _, signal in shown.named)])
        result = replace(result, trace=known)
    if not layout:
        named = shown.title if reference is None and scenario is None else ""
        title = named or f"{(scenario or system).stem} against {against.title}"
        shown = replace(shown.within(result.trace), title=title)
    facts = _facts(system, scenario, against.title, result.card, **options)
    validation, html, data = judge(result, against, shown, out, facts, rate)
    Console().print(summary(validation))
    print(f"\n{result.card.text()}\n\nreport: {html}\nnumbers: {data}\ntrace: {_what(result, trace)}")
    return validation.passed


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


def given(coupling: Mapping[str, Any] | None = None, **options: Any) -> dict[str, Any]:
    """What the user asked for, in one mapping, to note beside a trace."""
    return {**options, **(coupling or {})}


def simulated(
    system: Path,
    scenario: Path | None,
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
    loaded = load(there(system)).without(*cut).swapped(swap or {})
    loaded = loaded.coupled(coupling) if coupling else loaded
    if record_step is None and loaded.coupling and loaded.coupling.adaptive is not None:
        interval = None if everywhere else RECORD
    else:
        interval = thinned(communication_step(loaded, step)) if record_step is None else record_step
    folder(out.parent)
    try:
        return simulate(loaded, scenario, step=step, record_step=interval, progress=True, **options)
    except (RunFailed, Interrupted) as ended:
        own = {"step": step, "record_step": record_step, "cut": cut, "swap": swap}
        save(ended.result, out, given(coupling, scenario=scenario, **own, **options))
        raise


def there(system: Path) -> Path:
    """The system, if there is such a file."""
    if not system.exists():
        raise Problem(f"{system}: no such file" + (f"; make it with: {MAKE}" if system == BUILT else ""))
    return system


def folder(path: Path) -> None:
    """Make a folder for files to come, before work is spent on them."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise Problem(f"{path}: expected a folder, and none can be made: {error.strerror}") from None
    if not os.access(path, os.W_OK):
        raise Problem(f"{path}: expected a folder to write to, got no permission")


def save(result: Result, out: Path, given: Mapping[str, Any]) -> None:
    """Write the trace and, beside it, what the run was; print the card."""
    write(result.trace, out)
    write_facts(result, out, given)
    print(result.card.text())
    end = f"up to t = {result.trace.time[-1]:.6g} s " if len(result.trace.time) else ""
    kept = "" if result.complete else f"the run ended early; what was recorded {end}is kept in "
    print(f"\n{kept}{_what(result, out)}")


def _what(result: Result, out: Path) -> str:
    """The file of a trace and what is in it."""
    trace, card = result.trace, result.card
    thin = card.record_step > card.step or (card.adaptive is not None and card.record_step > 0)
    every = f", every {card.record_step:g} s" if thin else ""
    return f"{out}: {len(trace.signals)} signals, {len(trace.time)} rows{every}"


def signals(system: Path, kind: str | None = None, swap: Mapping[str, str] | None = None) -> None:
    """Print the variables of a system, `swap` as in `simulated`."""
    from orchestrator.system.signals import lines

    print("\n".join(lines(load(there(system)).swapped(swap or {}), kind)))


def compare(traces: Sequence[Path], out: Path, **options: Any) -> None:
    """Compare traces with one of them, print tables, write the picture and the numbers."""
    from orchestrator import comparison

    found = comparison.compare(traces, **options)
    folder(out)
    picture, numbers = comparison.write(found, out)
    print(f"{comparison.text(found)}\n\npicture: {picture}\nnumbers: {numbers}")
