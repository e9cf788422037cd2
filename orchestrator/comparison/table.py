"""A comparison as text for the terminal."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

from orchestrator.comparison.compare import CONSTANT, USUAL, Comparison
from orchestrator.comparison.runs import Run
from orchestrator.runs.sidecar import Facts
from orchestrator.validation import wording
from orchestrator.validation.compare import Row


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
        return [run.label, *[wording.NONE] * 6, ""]
    known, length = run.facts, run.facts.simulated or float("nan")
    inside, usual = _inside(known), sum(_inside(reference.facts).values())
    ranked = sorted(inside.items(), key=lambda entry: -entry[1])
    each = ", ".join(f"{name} {wording.number(spent, 2)}" for name, spent in ranked)
    factor = wording.number(length / known.wall if known.wall else None)
    wall, whole = wording.number(1e3 * known.wall / length), sum(inside.values())
    times = wording.number(whole / usual if usual else None, 2)
    return [
        _named(run.label, known),
        known.master,
        f"{known.step:.3g} s mean" if known.adaptive else f"{known.step:g} s",
        factor,
        wall,
        wording.number(whole, 2),
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
        nrmse = wording.share(worst.metrics.nrmse) if worst else wording.NONE
        same = "the same" if worst and largest.signal == worst.signal else largest.signal
        rows.append([quantity, str(len(groups[quantity])), nrmse, _who(worst)])
        rows[-1] += [wording.difference(most, largest.unit), same if most else ""]
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
    nrmse = wording.NONE if still and m.rmse else wording.share(m.nrmse)
    return nrmse, wording.difference(m.maximum_error, row.unit)


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
