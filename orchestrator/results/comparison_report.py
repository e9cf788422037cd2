"""Signals of several runs over each other, and below each the difference from the reference.

A comparison as text for the terminal.

A comparison as files: numbers for programs, a picture for people.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.lines import Line2D

from orchestrator.base.units import convert, linear, shown
from orchestrator.engine.result import Facts
from orchestrator.results import summary
from orchestrator.results.compare import Row
from orchestrator.results.comparison import CONSTANT, USUAL, Comparison, Run
from orchestrator.results.figures import PALETTE, decimate, frame, png
from orchestrator.results.summary import finer

PANELS = 6  # more rows than these do not fit on a page
EACH = 3  # of one quantity
ALIKE = 0.01  # of its range: two curves that are nearer cannot be told apart in the picture
# Colours that differ in hue and lightness (Okabe and Ito, darkened), each with its own dashes for print.
COLOURS = ("#0b5fa5", "#b34700", "#00735a", "#8f3f8f", "#7a6400", "#333333")
DASHES = ("-", (0, (4, 2)), (0, (1, 1.2)), (0, (6, 1.5, 1, 1.5)), (0, (3, 1)), (0, (8, 2)))


def chosen(comparison: Comparison) -> list[str]:
    """The signals that fit into one picture: of each quantity those that differ most, in their order."""
    groups: dict[str, list[Row]] = {}
    for validation in comparison.against.values():
        for row in validation.rows:
            if row.signal in comparison.signals:
                groups.setdefault(row.group, []).append(row)
    most = EACH if len(groups) > 1 else PANELS
    kept = {row.signal for rows in groups.values() for row in _distinct(rows, most)}
    return [signal for signal in comparison.signals if signal in kept][:PANELS]


def _distinct(rows: Sequence[Row], most: int) -> list[Row]:
    """The rows with the largest differences, without those that look like one before."""
    found: list[Row] = []
    for row in sorted(rows, key=lambda r: -r.metrics.maximum_error):
        if len(found) < most and not any(_alike(row, other) for other in found):
            found.append(row)
    return found


def _alike(row: Row, other: Row) -> bool:
    """The same signal, or another one that lies on it."""
    if row.signal == other.signal or len(row.time) != len(other.time):
        return row.signal == other.signal
    apart = [
        np.abs(a - b).max() for a, b in ((row.reference, other.reference), (row.simulation, other.simulation))
    ]
    return bool(max(apart) < ALIKE * np.ptp(row.reference))


def draw(comparison: Comparison, signals: Sequence[str] | None = None) -> Figure:
    """The picture; `signals` default to those of the comparison that differ most."""
    names = list(signals) if signals is not None else chosen(comparison)
    heights = [2.5, 1.2] * len(names)
    figure = Figure(figsize=(9.6, 0.46 * sum(heights) + 0.9), layout=ConstrainedLayoutEngine(h_pad=0.02))
    FigureCanvasAgg(figure)
    axes = figure.subplots(len(heights), 1, sharex=True, squeeze=False, height_ratios=heights)[:, 0]
    for place, name in enumerate(names):
        _curves(axes[2 * place], comparison, name)
        _differences(axes[2 * place + 1], comparison, name)
    axes[-1].set_xlabel("time [s]", color=PALETTE.ink)
    axes[-1].set_xlim(*comparison.window)
    _legend(figure, comparison)
    figure.align_ylabels()
    return figure


def _curves(axes: Axes, comparison: Comparison, name: str) -> None:
    frame(axes)
    unit = comparison.reference.trace.units.get(name, "")
    for run in [comparison.reference, *_others(comparison)]:
        own = run.trace.units.get(name, unit)
        seen = (run.trace.time >= comparison.window[0]) & (run.trace.time <= comparison.window[1])
        values = convert(run.trace[name][seen], own, shown(unit), name)
        axes.plot(*decimate(run.trace.time[seen], values), **_style(comparison, run))
    axes.set_ylabel(f"[{shown(unit) or '1'}]", color=PALETTE.ink, fontsize=9)
    axes.set_title(name, loc="left", fontsize=9, color=PALETTE.ink, pad=3)


def _differences(axes: Axes, comparison: Comparison, name: str) -> None:
    """Run - reference, on a scale of its own."""
    frame(axes)
    axes.axhline(0, color=PALETTE.faint, linewidth=0.8)
    largest, unit = 0.0, ""
    for run in _others(comparison):
        row = comparison.against[run.label][name]
        unit = finer(row.unit)
        difference = (row.simulation - row.reference) * linear(row.unit, unit, name)[0]
        largest = max(largest, float(np.abs(difference).max()))
        axes.plot(*decimate(row.time, difference), **_style(comparison, run) | {"linewidth": 0.9})
    axes.set_ylim(-1.2 * largest or -1, 1.2 * largest or 1)
    axes.set_ylabel(f"difference\n[{unit or '1'}]", color=PALETTE.ink, fontsize=7)
    axes.locator_params(axis="y", nbins=3)


def _others(comparison: Comparison) -> list[Run]:
    return [run for run in comparison.runs if run.label in comparison.against]


def _style(comparison: Comparison, run: Run) -> dict[str, Any]:
    """The reference broad and pale, the others thin, each in its colour."""
    if run is comparison.reference:
        return {"color": PALETTE.faint, "linewidth": 2.8, "alpha": 0.6}
    place = _others(comparison).index(run)
    dashes = DASHES[place % len(DASHES)]
    return {"color": COLOURS[place % len(COLOURS)], "linewidth": 1.2, "linestyle": dashes}


def _legend(figure: Figure, comparison: Comparison) -> None:
    """Title on the left, the runs on the right."""
    runs = [comparison.reference, *_others(comparison)]
    labels = [f"{run.label} (reference)" if run is comparison.reference else run.label for run in runs]
    handles = [
        Line2D([], [], label=label, **_style(comparison, run))
        for run, label in zip(runs, labels, strict=True)
    ]
    figure.legend(
        handles=handles,
        loc="outside upper center",
        ncols=min(len(runs), 4),
        fontsize=9,
        frameon=False,
        labelcolor=PALETTE.ink,
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
    told = "us/ms: per millisecond simulated; FMUs: the steps of all FMUs, calls from Python included"
    return [*aligned(["run", "master", "step", *times], rows, left=(0, 1, 7)), told]


def _cost(run: Run, reference: Run) -> list[str]:
    if run.facts is None:
        return [run.label, *[summary.NONE] * 6, ""]
    known, length = run.facts, run.facts.simulated or float("nan")
    inside, usual = _inside(known), sum(_inside(reference.facts).values())
    ranked = sorted(inside.items(), key=lambda entry: -entry[1])
    each = ", ".join(f"{name} {summary.number(spent, 2)}" for name, spent in ranked)
    factor = summary.number(length / known.wall if known.wall else None)
    wall, whole = summary.number(1e3 * known.wall / length), sum(inside.values())
    times = summary.number(whole / usual if usual else None, 2)
    return [
        _named(run.label, known),
        known.master,
        f"{known.step:.3g} s mean" if known.adaptive else f"{known.step:g} s",
        factor,
        wall,
        summary.number(whole, 2),
        times,
        each,
    ]


def _inside(known: Facts | None) -> dict[str, float]:
    """Component -> time in its steps [us] for each millisecond simulated."""
    length = (known.simulated if known else 0) or float("nan")
    return {name: 1e3 * spent / length for name, spent in known.inside.items()} if known else {}


def _named(label: str, known: Facts) -> str:
    """A run, with the FMUs that were swapped in."""
    swaps = ", ".join(f"{component}={Path(file).stem}" for component, file in known.swapped.items())
    return f"{label} ({swaps})" if swaps else label


def _worst(comparison: Comparison, label: str) -> list[str]:
    """The worst signals of each quantity, of all signals: speeds, pressures and angles first."""
    groups = comparison.quantities()
    order = [q for q in USUAL if q in groups] + [q for q in groups if q not in USUAL]
    rows = []
    for quantity in order:
        worst, largest = comparison.worst(label, quantity), comparison.largest(label, quantity)
        most = largest.metrics.maximum_error
        nrmse = summary.share(worst.metrics.nrmse) if worst else summary.NONE
        same = "the same" if worst and largest.signal == worst.signal else largest.signal
        rows.append([quantity, str(len(groups[quantity])), nrmse, _who(worst)])
        rows[-1] += [summary.difference(most, largest.unit), same if most else ""]
    against = f"{label} against {comparison.reference.label}, all signals"
    head = [against, "number", "largest NRMSE", "of", "largest difference", "of"]
    return aligned(head, rows, left=(0, 3, 5))


def _who(worst: Row | None) -> str:
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
    return aligned(["NRMSE, largest difference", *comparison.against], rows, left=(0,))


def _cells(row: Row) -> tuple[str, str]:
    """NRMSE, of a reference that stands still none, and the largest difference in the unit of a reader."""
    m = row.metrics
    still = any(note.startswith("the reference is") for note in row.metrics.notes)
    nrmse = summary.NONE if still and m.rmse else summary.share(m.nrmse)
    return nrmse, summary.difference(m.maximum_error, row.unit)


def aligned(head: Sequence[str], rows: Sequence[Sequence[str]], left: Sequence[int]) -> list[str]:
    """Columns of equal width; those in `left` begin, the others end, below each other."""
    table = [list(head), *map(list, rows)]
    widths = [max(len(row[i]) for row in table) for i in range(len(head))]
    return [
        "  ".join(
            c.ljust(w) if i in left else c.rjust(w) for i, (c, w) in enumerate(zip(r, widths, strict=True))
        ).rstrip()
        for r in table
    ]


def write(comparison: Comparison, folder: str | Path) -> tuple[Path, Path]:
    """Write comparison.png and comparison.json to a folder; returns both."""
    home = Path(folder)
    home.mkdir(parents=True, exist_ok=True)
    picture, numbers = home / "comparison.png", home / "comparison.json"
    picture.write_bytes(png(draw(comparison)))
    text = json.dumps(data(comparison), indent=1, ensure_ascii=False)
    numbers.write_text(text + "\n", encoding="utf-8", newline="\n")
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


def _row(row: Row) -> dict[str, Any]:
    m = row.metrics
    return {
        "quantity": row.group,
        "unit": row.unit,
        "nrmse": m.nrmse,
        "rmse": m.rmse,
        "maximum": m.maximum_error,
        "time of maximum [s]": m.time_of_maximum,
    }
