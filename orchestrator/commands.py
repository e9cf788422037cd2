"""What the commands of the command line do; prints results, raises Problem for mistakes."""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from orchestrator.archive import Location
from orchestrator.errors import Problem
from orchestrator.grid import communication_step, thinned
from orchestrator.simulation import Interrupted, Result, RunFailed
from orchestrator.simulation import run as simulate
from orchestrator.ssp import load
from orchestrator.trace import check_suffix, write

BUILT, MAKE = Path("build/harvester.ssp"), "harvester build"
SCENARIO = "work_cycle.csv"


def run(system: Path, scenario: Path | Location | None, out: Path, **options: Any) -> None:
    """Co-simulate, write the trace, print the accuracy card; an aborted run leaves its trace too."""
    save(simulated(system, scenario, out, **options), out)


def validate(
    system: Path,
    scenario: Path | Location | None,
    reference: Path,
    layout: Path | None,
    out: Path,
    rate: bool = True,
    **options: Any,
) -> bool:
    """Co-simulate, compare, write the trace and the report, print the table; True when no limit is missed.

    out    the folder of run.csv, report.html and report.json
    rate   with the ISO/TS 18571 rating
    """
    from rich.console import Console

    from orchestrator.judge import judge
    from orchestrator.validation import read_reference, summary
    from orchestrator.validation.layout import Layout, read_layout

    against, shown = read_reference(reference), read_layout(layout) if layout else Layout()
    trace = out / "run.csv"
    result = simulated(system, scenario, trace, **options)
    write(result.trace, trace)
    card = result.card
    facts = {
        "system": str(system),
        "scenario": str(scenario) if scenario else "none: start values",
        "reference": against.title,
        "master": card.master,
        "communication step [s]": card.step,
        "record step [s]": card.record_step,
        "simulated [s]": card.simulated,
    } | {f"set {name}": value for name, value in options.get("set", {}).items()}
    validation, html, data = judge(result, against, shown, out, facts, rate)
    Console().print(summary(validation))
    print(f"\n{card.text()}\n\nreport: {html}\nnumbers: {data}\ntrace: {_what(result, trace)}")
    return validation.passed


def simulated(
    system: Path,
    scenario: Path | Location | None,
    out: Path,
    step: float | None = None,
    record_step: float | None = None,
    **options: Any,
) -> Result:
    """Co-simulate with a progress bar; a run that ends early is saved to the file `out`.

    record_step   [s]; default: 5 ms or as near below it as the step allows, at least one step
    """
    check_suffix(out)
    if not system.exists():
        raise Problem(f"{system}: no such file" + (f"; make it with: {MAKE}" if system == BUILT else ""))
    loaded = load(system)
    step = communication_step(loaded, step)
    interval = thinned(step) if record_step is None else record_step
    folder(out.parent)
    try:
        return simulate(loaded, scenario, step=step, record_step=interval, progress=True, **options)
    except (RunFailed, Interrupted) as ended:
        save(ended.result, out)
        raise


def folder(path: Path) -> None:
    """Make a folder for files to come, before work is spent on them."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise Problem(f"{path}: expected a folder, and none can be made: {error.strerror}") from None
    if not os.access(path, os.W_OK):
        raise Problem(f"{path}: expected a folder to write to, got no permission")


def save(result: Result, out: Path) -> None:
    """Write the trace and print the card."""
    write(result.trace, out)
    print(result.card.text())
    end = f"up to t = {result.trace.time[-1]:.6g} s " if len(result.trace.time) else ""
    kept = "" if result.complete else f"the run ended early; what was recorded {end}is kept in "
    print(f"\n{kept}{_what(result, out)}")


def _what(result: Result, out: Path) -> str:
    """The file of a trace and what is in it."""
    trace, card = result.trace, result.card
    every = f", every {card.record_step:g} s" if card.record_step > card.step else ""
    return f"{out}: {len(trace.signals)} signals, {len(trace.time)} rows{every}"


def default_scenario(system: Path) -> Location | None:
    """The scenario inside the SSP's resources, else, for the built system, the one in data/scenarios."""
    if system.suffix.lower() == ".ssp" and system.is_file():
        inside = Location(system).member(f"resources/{SCENARIO}")
        if inside.inside[0] in Location(system).names():
            return inside
    beside = Path("data/scenarios") / SCENARIO
    return Location(beside) if system == BUILT and beside.is_file() else None


def assignments(texts: Iterable[str]) -> dict[str, str]:
    """{component.variable: value} from the texts 'component.variable=value'."""
    values = {}
    for text in texts:
        name, equals, value = text.partition("=")
        if not equals or not name.strip():
            raise Problem(f"--set {text}: expected component.variable=value")
        values[name.strip()] = value.strip()
    return values
