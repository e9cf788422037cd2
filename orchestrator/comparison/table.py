"""A comparison as text for the terminal."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from orchestrator.comparison.compare import USUAL, Comparison
from orchestrator.comparison.runs import Run
from orchestrator.sidecar import Facts
from orchestrator.validation import wording
from orchestrator.validation.compare import Row


def text(comparison: Comparison) -> str:
    """Cost of each run, the worst signal of each quantity, the chosen signals, and notes."""
    parts = [_costs(comparison.runs)]
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
    for note, labels in about.items():
        yield note if len(labels) == len(comparison.against) else f"{', '.join(labels)}: {note}"


def _costs(runs: Sequence[Run]) -> list[str]:
    """What is known of each run; nothing where nothing is known."""
    if not any(run.facts for run in runs):
        return []
    head = ["run", "step", "times real time", "wall ms/s", "FMUs ms/s", "of them (ms per simulated second)"]
    return aligned(head, [_cost(run) for run in runs], left=(0, 5))


def _cost(run: Run) -> list[str]:
    if run.facts is None:
        return [run.label, *[wording.NONE] * 4, ""]
    known, length = run.facts, run.facts.simulated or float("nan")
    inside = {name: 1e3 * spent / length for name, spent in known.inside.items()}
    ranked = sorted(inside.items(), key=lambda entry: -entry[1])
    each = ", ".join(f"{_named(known, name)} {wording.number(ms, 2)}" for name, ms in ranked)
    factor = wording.number(length / known.wall if known.wall else None)
    wall = wording.number(1e3 * known.wall / length)
    return [run.label, f"{known.step:g} s", factor, wall, wording.number(sum(inside.values()), 2), each]


def _named(known: Facts, component: str) -> str:
    """A component, with the model in its place if that has another name."""
    model = known.fmus.get(component, component)
    return f"{component}={model}" if component in known.swapped and model != component else component


def _worst(comparison: Comparison, label: str) -> list[str]:
    """The worst signal of each quantity: speeds, pressures and angles first."""
    groups = comparison.quantities()
    order = [q for q in USUAL if q in groups] + [q for q in groups if q not in USUAL]
    rows = []
    for quantity in order:
        worst = comparison.worst(label, quantity)
        many = str(len(groups[quantity]))
        rows.append(
            [quantity, many, *_cells(worst), worst.signal]
            if worst
            else [quantity, many, *[wording.NONE] * 2, "none of them moves"]
        )
    head = [f"{label} against {comparison.reference.label}", "signals", "NRMSE", "max error", "worst signal"]
    return aligned(head, rows, left=(0, 4))


def _signals(comparison: Comparison) -> list[str]:
    """NRMSE and largest error of the chosen signals, a column for each run."""
    by_run = [{row.signal: row for row in v.rows} for v in comparison.against.values()]
    rows, before = [], ""
    for signal in comparison.signals:
        row = by_run[0][signal]
        if row.group != before:
            rows.append([f"{row.group}"] + [""] * len(by_run))
        before = row.group
        rows.append([f"  {signal}", *(", ".join(_cells(rows_[signal])) for rows_ in by_run)])
    return aligned(["NRMSE, max error", *comparison.against], rows, left=(0,))


def _cells(row: Row) -> tuple[str, str]:
    """NRMSE, of a reference that stands still none, and the largest error in the unit of a reader."""
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
