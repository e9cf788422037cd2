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


def run(system: Path, scenario: Path | Location | None, out: Path, **options: Any) -> None:
    """Co-simulate, write the trace, print the accuracy card; an aborted run leaves its trace too."""
    check_suffix(out)
    try:
        result = simulate(load(system), scenario, progress=True, **options)
    except (RunFailed, Interrupted) as ended:
        save(ended.result, out)
        raise
    save(result, out)


def save(result: Result, out: Path) -> None:
    """Write the trace and print the card."""
    write(result.trace, out)
    print(result.card.text())
    end = f"up to t = {result.trace.time[-1]:.6g} s " if len(result.trace.time) else ""
    kept = "" if result.complete else f"the run ended early; what was recorded {end}is kept in "
    print(f"\n{kept}{out}: {len(result.trace.signals)} signals, {len(result.trace.time)} rows")


def default_scenario(system: Path, built: Path, name: str) -> Location | None:
    """The scenario inside the SSP's resources, else, for the built system, the one in data/scenarios."""
    if system.suffix.lower() == ".ssp" and system.is_file():
        inside = Location(system).member(f"resources/{name}")
        if inside.inside[0] in Location(system).names():
            return inside
    beside = Path("data/scenarios") / name
    return Location(beside) if system == built and beside.is_file() else None


def assignments(texts: Iterable[str]) -> dict[str, str]:
    """{component.variable: value} from the texts 'component.variable=value'."""
    values = {}
    for text in texts:
        name, equals, value = text.partition("=")
        if not equals or not name.strip():
            raise Problem(f"--set {text}: expected component.variable=value")
        values[name.strip()] = value.strip()
    return values
