"""The command `harvester variants`, as far as it runs FMUs."""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from math import prod
from pathlib import Path

from orchestrator.commands.commands import folder
from orchestrator.errors import Problem
from orchestrator.system.ssp import load
from orchestrator.variety.combinations import COLUMNS, HEAD, cells, combinations, figures
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
    """Run every combination, print a table and write it to `out`; True when all came to the end.

    The file is complete after each row, also when the user ends it early.
    """
    if not system.exists():
        raise Problem(f"{system}: no such file; make it with: {MAKE}")
    folder(out.parent)
    widths = [max(map(len, (part, *names))) for part, names in variants.items()]
    total, done, complete = prod(map(len, variants.values())), 0, True
    count = len(f"{total}/{total}")
    head = "  ".join(n.ljust(w) for n, w in zip(variants, widths, strict=True))
    print(" " * count, head, *(f"{h:>12}" for h in HEAD))
    with out.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow([*variants, *COLUMNS, "failure"])
        try:
            for done, row in enumerate(combinations(load(system), variants, watch, **RUN), 1):
                chosen = list(row.variants.values())
                named = "  ".join(n.ljust(w) for n, w in zip(chosen, widths, strict=True))
                place = f"{done}/{total}".rjust(count)
                print(place, named, *(f"{cell:>12}" for cell in cells(row)), row.failure, flush=True)
                writer.writerow([*chosen, *figures(row), row.failure])
                file.flush()
                complete = complete and not row.failure
        except KeyboardInterrupt:
            print(f"\n{done} of {total} combinations, in {out}")
            raise
    print(
        f"\n{out}: change is that of {', '.join(watch)} against the first row, RMS over range;"
        " us per ms is the sum over the steps of all FMUs, calls from Python included"
    )
    return complete
