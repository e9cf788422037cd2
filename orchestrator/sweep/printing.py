"""What a finished study tells on the command line."""

from __future__ import annotations

from orchestrator.sweep.running import FAILED
from orchestrator.sweep.store import Results
from orchestrator.sweep.units import factor, seen

REASONS = 5  # of failed runs, that are told


def text(results: Results) -> str:
    """How many runs there are of each kind, what the outputs are, why runs failed."""
    counts = results.table["status"].value_counts()
    lines = [f"{len(results.table)} runs: {', '.join(f'{n} {kind}' for kind, n in counts.items())}", ""]
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
    table = results.table
    reasons = table.loc[table["status"] == FAILED, "reason"].value_counts()
    told = [f"{n} failed: {reason}" for reason, n in reasons.head(REASONS).items()]
    more = [f"... and for {len(reasons) - REASONS} other reasons"] if len(reasons) > REASONS else []
    return ["", *told, *more] if told else []
