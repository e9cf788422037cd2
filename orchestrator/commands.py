"""What the commands of the command line do; prints results, raises Problem for mistakes."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

from orchestrator.archive import Location
from orchestrator.errors import Problem
from orchestrator.simulation import Interrupted, Result, RunFailed
from orchestrator.simulation import run as simulate
from orchestrator.ssp import load
from orchestrator.trace import check_suffix, write

BUILT, MAKE = Path("build/harvester.ssp"), "harvester build"
SCENARIO = "work_cycle.csv"


def run(system: Path, scenario: Path | Location | None, out: Path, **options: Any) -> None:
    """Co-simulate, write the trace, print the accuracy card; an aborted run leaves its trace too."""
    check_suffix(out)
    if not system.exists():
        raise Problem(f"{system}: no such file" + (f"; make it with: {MAKE}" if system == BUILT else ""))
    try:
        result = simulate(load(system), scenario, progress=True, **options)
    except (RunFailed, Interrupted) as ended:
        save(ended.result, out)
        raise
    save(result, out)


def validate(
    system: Path,
    scenario: Path | Location | None,
    reference: Path,
    layout: Path | None,
    out: Path,
    **options: Any,
) -> bool:
    """Co-simulate, compare, write the trace and the report, print the table; True when no limit is missed."""
    from rich.console import Console

    from orchestrator.judge import judge
    from orchestrator.validation import read_reference, summary
    from orchestrator.validation.layout import Layout, read_layout

    against, shown = read_reference(reference), read_layout(layout) if layout else Layout()
    try:
        result = simulate(load(system), scenario, progress=True, **options)
    except (RunFailed, Interrupted) as ended:
        save(ended.result, out / "run.csv")
        raise
    card = result.card
    facts = {
        "system": str(system),
        "scenario": str(scenario) if scenario else "none: start values",
        "reference": against.title,
        "master": card.master,
        "communication step [s]": card.step,
        "simulated [s]": card.simulated,
    } | {f"set {name}": value for name, value in options.get("set", {}).items()}
    validation, html, data = judge(result, against, shown, out, facts)
    write(result.trace, out / "run.csv")
    Console().print(summary(validation))
    print(f"\n{card.text()}\n\nreport: {html}\nnumbers: {data}\ntrace: {out / 'run.csv'}")
    return validation.passed


def save(result: Result, out: Path) -> None:
    """Write the trace and print the card."""
    write(result.trace, out)
    print(result.card.text())
    end = f"up to t = {result.trace.time[-1]:.6g} s " if len(result.trace.time) else ""
    kept = "" if result.complete else f"the run ended early; what was recorded {end}is kept in "
    print(f"\n{kept}{out}: {len(result.trace.signals)} signals, {len(result.trace.time)} rows")


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
