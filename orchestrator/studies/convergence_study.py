"""`harvester convergence`: choose settings, steps and reference, run, print tables, write files."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from math import isfinite
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn

from orchestrator.base.errors import Problem
from orchestrator.base.files import folder, there
from orchestrator.data.recording import read_recording
from orchestrator.results.validate_system import another_model
from orchestrator.ssp.load import load
from orchestrator.ssp.swap import with_swaps
from orchestrator.studies.convergence import (
    ConvergenceStudy,
    SettingRun,
    choose,
    finest,
    from_reference,
    possible,
    rates,
    run_settings,
    usual,
)
from orchestrator.studies.convergence_report import duration, ends, tables, write

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
) -> ConvergenceStudy:
    """Run, print and write a study; after an interrupt what is finished is printed and written.

    steps     times [s] with commas
    masters   names with commas, as of `choose`
    usually   the reference if none is given, provided that it is one of this system and this run
    options   of `run`
    """
    if repeats < 1:
        raise Problem(f"repeats: expected at least 1, got {repeats}")
    settings, lengths = choose(_items(masters)), durations(steps)
    whole = with_swaps(load(there(system)).without(*cut), swap or {})
    if not whole.connections:
        raise Problem(f"{system}: expected connected FMUs, got no connection: there is nothing to couple")
    folder(out)
    given = {name: value for name, value in options.items() if value not in (None, (), {})}
    if reference is None and not swap and not given.keys() & set(OTHERS):
        truth = from_reference(read_recording(usually))
        reference = usually if set(truth.names) <= set(whole.names()) else None
    if reference:
        against = read_recording(reference)
        truth, note = from_reference(against, signals), another_model(whole, against)
    else:
        truth = finest(whole, usual(whole, signals), lengths, **given)
        note = f"no reference for this run: {truth.title}, half the smallest step, takes its place"
    bare, rows = rates(whole), list[SettingRun]()
    chosen = possible(settings, bare)
    plain = any(setting.bare for setting in chosen)
    wires = f"plain: without the wires of rate ports: {', '.join(bare)}" if plain else ""
    notes = tuple(filter(None, (note, *truth.notes, wires)))
    try:
        running = run_settings(whole, truth, chosen, lengths, repeats, bare, **given)
        for row in watched(running, sum(len(setting.own) or len(lengths) for setting in chosen)):
            rows.append(row)
    finally:
        study = ConvergenceStudy(truth, tuple(rows), notes)
        if rows:
            report(study, out)
    return study


def durations(text: str) -> list[float]:
    """Steps [s] from a list with commas, the smallest first."""
    found = []
    for word in _items(text):
        try:
            found.append(float(word))
        except ValueError:
            raise Problem(f"steps {text}: expected numbers of seconds with commas, got {word!r}") from None
        if not (found[-1] > 0 and isfinite(found[-1])):
            raise Problem(f"steps {text}: expected positive times, got {word}")
    if not found:
        raise Problem("steps: expected at least one, got none")
    return sorted(set(found))


def _items(text: str) -> list[str]:
    """The items of a list with commas."""
    return [part.strip() for part in text.split(",") if part.strip()]


def watched(rows: Iterable[SettingRun], total: int) -> Iterator[SettingRun]:
    """The rows as they come, with a progress bar."""
    text = TextColumn("{task.completed} of {task.total}  {task.description}")
    console = Console(stderr=True)
    with Progress(text, BarColumn(), console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task("", total=total)
        for row in rows:
            bar.update(task, advance=1, description=f"{row.setting.label}, {row.case or duration(row.step)}")
            yield row


def report(study: ConvergenceStudy, out: Path) -> None:
    """Print the tables and notes, write the files."""
    console = Console()
    for table in tables(study):
        table.print(console)
    lines = [*ends(study), *(f"note: {note}" for note in study.notes)]
    print("\n".join([*lines, "", *map(str, write(study, out))]))
