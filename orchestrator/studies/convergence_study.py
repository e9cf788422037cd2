"""The command `harvester convergence`: what is studied, against what, and what is told of it."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from math import isfinite
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn

from orchestrator.base.errors import Problem
from orchestrator.base.files import folder, there
from orchestrator.results.reference import read_reference
from orchestrator.results.validate import another_model
from orchestrator.ssp.load import load
from orchestrator.ssp.system import System
from orchestrator.studies.convergence import (
    Row,
    Study,
    Truth,
    choose,
    finest,
    from_reference,
    possible,
    rates,
    study,
    usual,
)
from orchestrator.studies.convergence_report import duration, ends, show, tables, write

OTHERS = ("scenario", "parameters", "set", "swap")  # with one of them the usual reference is of another run


def convergence(
    system: Path,
    reference: Path | None,
    out: Path,
    steps: str,
    masters: str,
    signals: Sequence[str],
    repeats: int,
    usually: Path,
    cut: Sequence[str] = (),
    swap: Mapping[str, str] | None = None,
    **options: Any,
) -> Study:
    """Study, print, write; a study that is interrupted leaves what it has.

    usually   the reference where none is given, if the system and the run are those it is of
    """
    if repeats < 1:
        raise Problem(f"repeats: expected at least 1, got {repeats}")
    settings, lengths = choose(words(masters)), durations(steps)
    whole = load(there(system)).without(*cut).swapped(swap or {})
    if not whole.connections:
        raise Problem(f"{system}: expected connected FMUs, got no connection: there is nothing to couple")
    folder(out)
    given = {name: value for name, value in options.items() if value not in (None, (), {})}
    if reference is None and not swap and not given.keys() & set(OTHERS):
        reference = _fitting(whole, usually)
    truth, note = _truth(whole, reference, signals, lengths, given)
    bare = rates(whole)
    chosen, rows = possible(settings, bare), list[Row]()
    plain = any(setting.bare for setting in chosen)
    wires = f"plain: without the wires of rate ports: {', '.join(bare)}" if plain else ""
    notes = tuple(filter(None, (note, *truth.notes, wires)))
    try:
        found = study(whole, truth, chosen, lengths, repeats, bare, **given)
        total = sum(len(setting.own) or len(lengths) for setting in chosen)
        for row in watched(found, total):
            rows.append(row)
    finally:
        told = Study(truth, tuple(rows), notes)
        if rows:
            tell(told, out)
    return told


def words(text: str) -> list[str]:
    """The parts of a list with commas."""
    return [part.strip() for part in text.split(",") if part.strip()]


def durations(text: str) -> list[float]:
    """Steps [s] from a list with commas, the smallest first."""
    found = []
    for word in words(text):
        try:
            found.append(float(word))
        except ValueError:
            raise Problem(f"steps {text}: expected numbers of seconds with commas, got {word!r}") from None
        if not (found[-1] > 0 and isfinite(found[-1])):
            raise Problem(f"steps {text}: expected positive times, got {word}")
    if not found:
        raise Problem("steps: expected at least one, got none")
    return sorted(set(found))


def _fitting(system: System, usually: Path) -> Path | None:
    """The usual reference, if the system has its signals."""
    truth = from_reference(read_reference(usually))
    return usually if set(truth.names) <= set(system.names()) else None


def _truth(
    system: System,
    reference: Path | None,
    signals: Sequence[str],
    steps: Sequence[float],
    given: Mapping[str, Any],
) -> tuple[Truth, str]:
    """What to compare with, and what to say about it."""
    if reference:
        against = read_reference(reference)
        return from_reference(against, signals), another_model(system, against)
    truth = finest(system, usual(system, signals), steps, **given)
    return truth, f"no reference for this run: {truth.title}, half the smallest step, takes its place"


def watched(rows: Iterable[Row], total: int) -> Iterator[Row]:
    """The rows as they come, with a bar that tells how many are done."""
    text = TextColumn("{task.completed} of {task.total}  {task.description}")
    console = Console(stderr=True)
    with Progress(text, BarColumn(), console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task("", total=total)
        for row in rows:
            bar.update(task, advance=1, description=f"{row.setting.label}, {row.case or duration(row.step)}")
            yield row


def tell(study: Study, out: Path) -> None:
    """Print the tables and notes, write the files."""
    console = Console()
    for text in tables(study):
        show(console, text)
    lines = [*ends(study), *(f"note: {note}" for note in study.notes)]
    print("\n".join([*lines, "", *map(str, write(study, out))]))
