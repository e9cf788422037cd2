"""A comparison of runs as text for the terminal, as numbers for programs and as a picture for people.

In the picture signals of several runs lie over each other, with their differences from the reference below.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from orchestrator.base.html_page import write_json
from orchestrator.base.plotting import (
    LINE_STYLES,
    PALETTE,
    TraceLine,
    TracePanel,
    draw_traces,
    legend_entry,
    png,
)
from orchestrator.base.text import NO_VALUE, TextTable, error_display_unit, number, percentage
from orchestrator.base.units import convert, factor_and_offset, reader_unit
from orchestrator.engine.result import RunMetadata
from orchestrator.results.comparison import CONSTANT, DEFAULT_QUANTITIES, Comparison, Run
from orchestrator.results.validation import ValidatedSignal

PANELS = 6  # more rows than these do not fit on a page
EACH = 3  # of one quantity
ALIKE = 0.01  # of its range: two curves that are nearer cannot be distinguished in the picture


def chosen(comparison: Comparison) -> list[str]:
    """The signals that fit into one picture: of each quantity those that differ most, in their order."""
    groups: dict[str, list[ValidatedSignal]] = {}
    for validation in comparison.against.values():
        for row in validation.rows:
            if row.signal in comparison.signals:
                groups.setdefault(row.group, []).append(row)
    most = EACH if len(groups) > 1 else PANELS
    kept = {row.signal for rows in groups.values() for row in _distinct(rows, most)}
    return [signal for signal in comparison.signals if signal in kept][:PANELS]


def _distinct(rows: Sequence[ValidatedSignal], most: int) -> list[ValidatedSignal]:
    """The rows with the largest differences, without those that look like one before."""
    found: list[ValidatedSignal] = []
    for row in sorted(rows, key=lambda r: -r.metrics.maximum_error):
        if len(found) < most and not any(_alike(row, other) for other in found):
            found.append(row)
    return found


def _alike(row: ValidatedSignal, other: ValidatedSignal) -> bool:
    """The same signal, or another one that lies on it."""
    if row.signal == other.signal or len(row.time) != len(other.time):
        return row.signal == other.signal
    apart = [
        np.abs(a - b).max() for a, b in ((row.reference, other.reference), (row.simulation, other.simulation))
    ]
    return bool(max(apart) < ALIKE * np.ptp(row.reference))


def draw(comparison: Comparison, signals: Sequence[str] | None = None) -> Figure:
    """The picture; `signals` default to those of the comparison that differ most."""
    reference = comparison.reference
    styles = {reference.label: {"color": PALETTE.faint, "linewidth": 2.8, "alpha": 0.6}}
    for place, run in enumerate(run for run in comparison.runs if run.label in comparison.against):
        dashes = LINE_STYLES[place % len(LINE_STYLES)]
        styles[run.label] = {"color": PALETTE.colour(place), "linewidth": 1.2, "linestyle": dashes}
    names = list(signals) if signals is not None else chosen(comparison)
    key = [
        legend_entry(f"{label} (reference)" if label == reference.label else label, **style)
        for label, style in styles.items()
    ]
    return draw_traces([_panel(comparison, styles, name) for name in names], comparison.window, key=key)


def _panel(comparison: Comparison, styles: Mapping[str, Mapping[str, Any]], name: str) -> TracePanel:
    """A signal of all runs, and below it its differences from the reference."""
    unit = comparison.reference.trace.units.get(name, "")
    runs = {run.label: run.trace for run in comparison.runs}
    lines = []
    for label, style in styles.items():
        trace = runs[label]
        seen = (trace.time >= comparison.window[0]) & (trace.time <= comparison.window[1])
        values = convert(trace[name][seen], trace.units.get(name, unit), reader_unit(unit), name)
        lines.append(TraceLine(trace.time[seen], values, style))
    rows = {label: validation[name] for label, validation in comparison.against.items()}
    error_unit = error_display_unit(next(iter(rows.values())).unit).display if rows else ""
    errors = [
        TraceLine(
            row.time,
            factor_and_offset(row.unit, error_unit, name)[0] * (row.simulation - row.reference),
            styles[label],
        )
        for label, row in rows.items()
    ]
    return TracePanel(
        reader_unit(unit), lines, "", name, errors, "difference", error_unit, heights=(2.5, 1.2)
    )


def text(comparison: Comparison) -> str:
    """Cost of each run, the worst signal of each quantity, the chosen signals, and notes."""
    parts = [_costs(comparison)]
    parts += [_worst(comparison, label) for label in comparison.against]
    parts += [_signals(comparison), [f"note: {note}" for note in _notes(comparison)]]
    return "\n\n".join("\n".join(part) for part in parts if part)


def _notes(comparison: Comparison) -> Iterator[str]:
    """What concerns all first, then what is true for single runs."""
    yield from comparison.notes
    about: dict[str, list[str]] = {}
    for label, validation in comparison.against.items():
        for note in validation.notes:
            about.setdefault(note, []).append(label)
    rows = (comparison.worst(label, q) for label in comparison.against for q in comparison.quantities())
    if any(row and CONSTANT in row.notes for row in rows):
        yield f"{CONSTANT}: its NRMSE is over the range of the other run"
    for note, labels in about.items():
        yield note if len(labels) == len(comparison.against) else f"{', '.join(labels)}: {note}"


def _costs(comparison: Comparison) -> list[str]:
    """What is known of each run; nothing where nothing is known."""
    runs, reference = comparison.runs, comparison.reference
    if not any(run.facts for run in runs):
        return []
    times = ["times real time", "wall us/ms", "FMUs us/ms", f"x {reference.label}", "of them"]
    rows = [_cost(run, reference) for run in runs]
    note = "us/ms: per millisecond simulated; FMUs: the steps of all FMUs, calls from Python included"
    return [*TextTable(["run", "master", "step", *times], rows, left=(0, 1, 7)).lines(), note]


def _cost(run: Run, reference: Run) -> list[str]:
    if run.facts is None:
        return [run.label, *[NO_VALUE] * 6, ""]
    known, length = run.facts, run.facts.simulated or float("nan")
    inside, usual = _inside(known), sum(_inside(reference.facts).values())
    ranked = sorted(inside.items(), key=lambda entry: -entry[1])
    each = ", ".join(f"{name} {number(spent, 2)}" for name, spent in ranked)
    factor = number(length / known.wall if known.wall else None)
    wall, whole = number(1e3 * known.wall / length), sum(inside.values())
    times = number(whole / usual if usual else None, 2)
    return [
        _named(run.label, known),
        known.master,
        f"{known.step:.3g} s mean" if known.adaptive else f"{known.step:g} s",
        factor,
        wall,
        number(whole, 2),
        times,
        each,
    ]


def _inside(known: RunMetadata | None) -> dict[str, float]:
    """Component -> time in its steps [us] for each millisecond simulated."""
    length = (known.simulated if known else 0) or float("nan")
    return {name: 1e3 * spent / length for name, spent in known.inside.items()} if known else {}


def _named(label: str, known: RunMetadata) -> str:
    """A run, with the FMUs that were swapped in."""
    swaps = ", ".join(f"{component}={Path(file).stem}" for component, file in known.swapped.items())
    return f"{label} ({swaps})" if swaps else label


def _worst(comparison: Comparison, label: str) -> list[str]:
    """The worst signals of each quantity, of all signals: speeds, pressures and angles first."""
    groups = comparison.quantities()
    order = [q for q in DEFAULT_QUANTITIES if q in groups] + [
        q for q in groups if q not in DEFAULT_QUANTITIES
    ]
    rows = []
    for quantity in order:
        worst, largest = comparison.worst(label, quantity), comparison.largest(label, quantity)
        most = largest.metrics.maximum_error
        nrmse = percentage(worst.metrics.nrmse) if worst else NO_VALUE
        same = "the same" if worst and largest.signal == worst.signal else largest.signal
        rows.append([quantity, str(len(groups[quantity])), nrmse, _who(worst)])
        rows[-1] += [error_display_unit(largest.unit).ascii(most), same if most else ""]
    against = f"{label} against {comparison.reference.label}, all signals"
    head = [against, "number", "largest NRMSE", "of", "largest difference", "of"]
    return TextTable(head, rows, left=(0, 3, 5)).lines()


def _who(worst: ValidatedSignal | None) -> str:
    """The signal with the largest NRMSE, if there is any."""
    if worst is None:
        return "none of them moves"
    return (
        f"{worst.signal}{f' ({CONSTANT})' if CONSTANT in worst.notes else ''}" if worst.metrics.rmse else ""
    )


def _signals(comparison: Comparison) -> list[str]:
    """NRMSE and largest difference of the chosen signals, a column for each run."""
    by_run = [{row.signal: row for row in v.rows} for v in comparison.against.values()]
    rows, before = [], ""
    for signal in comparison.signals:
        row = by_run[0][signal]
        if row.group != before:
            rows.append([f"{row.group}"] + [""] * len(by_run))
        before = row.group
        rows.append([f"  {signal}", *(", ".join(_cells(rows_[signal])) for rows_ in by_run)])
    return TextTable(["NRMSE, largest difference", *comparison.against], rows).lines()


def _cells(row: ValidatedSignal) -> tuple[str, str]:
    """NRMSE, of a reference that stands still none, and the largest difference in the unit of a reader."""
    m = row.metrics
    still = any(note.startswith("the reference is") for note in row.metrics.notes)
    nrmse = NO_VALUE if still and m.rmse else percentage(m.nrmse)
    return nrmse, error_display_unit(row.unit).ascii(m.maximum_error)


def write(comparison: Comparison, folder: str | Path) -> tuple[Path, Path]:
    """Write comparison.png and comparison.json to a folder; returns both."""
    picture = Path(folder) / "comparison.png"
    numbers = write_json(picture.with_suffix(".json"), data(comparison))
    picture.write_bytes(png(draw(comparison)))
    return picture, numbers


def data(comparison: Comparison) -> Mapping[str, Any]:
    """All numbers: of each run its cost, the difference of each common signal, the worst of each quantity."""
    return {
        "reference": comparison.reference.label,
        "shown": list(comparison.signals),
        "runs": {run.label: _about(run) | _difference_data(comparison, run.label) for run in comparison.runs},
        "notes": list(comparison.notes),
    }


def _about(run: Run) -> dict[str, Any]:
    known = run.facts
    if known is None:
        return {"file": run.file}
    return {
        "file": run.file,
        "system": known.system,
        "fmus": dict(known.fmus),
        "swapped": dict(known.swapped),
        "given": dict(known.given),
        "master": known.master,
        "coupling": dict(known.coupling),
        "step [s]": known.step,
        "steps": known.steps,
        "passes": known.passes,
        "repeated": known.repeated,
        "simulated [s]": known.simulated,
        "wall [s]": known.wall,
        "inside [s]": dict(known.inside),
        "times real time": known.simulated / known.wall if known.wall else None,
    }


def _difference_data(comparison: Comparison, label: str) -> dict[str, Any]:
    if label not in comparison.against:
        return {}
    found = comparison.against[label]
    worst = {q: row.signal for q in comparison.quantities() if (row := comparison.worst(label, q))}
    return {
        "window [s]": list(found.window),
        "notes": list(found.notes),
        "worst": worst,
        "largest": {q: comparison.largest(label, q).signal for q in comparison.quantities()},
        "signals": {row.signal: _row(row) for row in found.rows},
    }


def _row(row: ValidatedSignal) -> dict[str, Any]:
    m = row.metrics
    return {
        "quantity": row.group,
        "unit": row.unit,
        "nrmse": m.nrmse,
        "rmse": m.rmse,
        "maximum": m.maximum_error,
        "time of maximum [s]": m.time_of_maximum,
    }
