"""The command `harvester variants`, as far as it runs FMUs."""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from pathlib import Path

from orchestrator.commands import folder
from orchestrator.errors import Problem
from orchestrator.ssp import load
from orchestrator.variety.combinations import HEAD, cells, combinations
from orchestrator.variety.cost import inside

STEP = 1e-3  # communication step [s]
LENGTH, REPEATS = 4.0, 2  # of the runs that measure what a variant costs [s]
RUN = {"step": STEP, "record_step": 0.02}  # of each combination [s]
MAKE = "harvester build"


def costs(system: Path, variants: Sequence[tuple[str, str]]) -> dict[tuple[str, str], float]:
    """(component, variant) -> time [us] per step inside its FMU, with the usual variants around it."""
    whole = load(system)
    machines = [whole.swapped({part: variant}) for part, variant in variants]
    spent = inside(machines, REPEATS, stop=LENGTH, **RUN)
    return {(part, variant): times[part] for (part, variant), times in zip(variants, spent, strict=True)}


def table(system: Path, variants: Mapping[str, Sequence[str]], watch: Sequence[str], out: Path) -> bool:
    """Run every combination, print a table and write it to `out`; True when all came to the end."""
    if not system.exists():
        raise Problem(f"{system}: no such file; make it with: {MAKE}")
    folder(out.parent)
    widths = [max(map(len, (part, *names))) for part, names in variants.items()]
    print("  ".join(n.ljust(w) for n, w in zip(variants, widths, strict=True)), *(f"{h:>12}" for h in HEAD))
    complete = True
    with out.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow([*variants, *HEAD, "failure"])
        for row in combinations(load(system), variants, watch, **RUN):
            chosen, figures = list(row.variants.values()), cells(row)
            named = "  ".join(n.ljust(w) for n, w in zip(chosen, widths, strict=True))
            print(named, *(f"{cell:>12}" for cell in figures), row.failure, flush=True)
            writer.writerow([*chosen, *figures, row.failure])
            complete = complete and not row.failure
    print(f"\n{out}: change is that of {', '.join(watch)} against the first row, RMS over range")
    return complete
