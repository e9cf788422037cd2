"""What a finished study tells on the command line."""

from __future__ import annotations

from orchestrator.sweep.reasons import alike
from orchestrator.sweep.running import EARLY, FAILED, OK
from orchestrator.sweep.store import Results
from orchestrator.sweep.units import factor, seen

REASONS = 5  # of failed runs, that are told


def text(results: Results) -> str:
    """How many runs there are of each kind, what the outputs are, why runs failed."""
    counts = results.table["status"].value_counts()
    kinds = ", ".join(f"{counts[kind]} {kind}" for kind in (OK, EARLY, FAILED) if kind in counts)
    lines = [f"{len(results.table)} runs: {kinds}", ""]
    return "\n".join([*lines, *_outputs(results), *_reasons(results)])


def _outputs(results: Results) -> list[str]:
    rows = [("output", "minimum", "mean", "maximum", "unit")]
    for output in results.study.outputs:
        column = results.table[output.column]
        unit = seen(output.unit, column.abs().max())
        low, mean, high = (f"{v * factor(unit):.5g}" for v in (column.min(), column.mean(), column.max()))
        rows.append((output.name, low, mean, high, unit.shown))
    widths = [max(len(row[i]) for row in rows) for i in range(5)]
    return [
        "  ".join(
            [row[0].ljust(widths[0]), *(row[i].rjust(widths[i]) for i in (1, 2, 3)), row[4]],
        ).rstrip()
        for row in rows
    ]


def _reasons(results: Results) -> list[str]:
    """Reasons that differ by their numbers alone are told once, by the first run that has one."""
    reasons = results.table.loc[results.table["status"] == FAILED, "reason"]
    kinds = [own for _, own in reasons.groupby(alike(reasons), sort=False)]
    kinds.sort(key=len, reverse=True)
    told = [
        f"{len(own)} failed{', such as' if own.nunique() > 1 else ''}: {own.iloc[0]}"
        for own in kinds[:REASONS]
    ]
    more = [f"... and for {len(kinds) - REASONS} other reasons"] if len(kinds) > REASONS else []
    return ["", *told, *more] if told else []
