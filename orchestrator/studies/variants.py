"""`harvester variants`: cost of each variant of a component, and its effect on the results.

The cost is the time inside an FMU: from setting its inputs to the end of its fmi2DoStep or fmi3DoStep, as
measured by the simulation loop in C. The minimum of several runs counts, as it is the least disturbed.
Compare only times that were measured on one computer in one session.

Every combination of variants is run once. Its row contains the time reached, cost and change.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from math import prod
from pathlib import Path
from typing import Unpack

import numpy as np

from orchestrator.base.errors import Problem
from orchestrator.base.files import make_folder, write_rows
from orchestrator.base.signals import rms, span
from orchestrator.data.trace import Trace
from orchestrator.engine.arguments import RunArguments
from orchestrator.engine.run import attempt, run
from orchestrator.ssp.load import load
from orchestrator.ssp.swap import with_swaps
from orchestrator.ssp.system import System


def inside(
    systems: Sequence[System], repeats: int = 3, **options: Unpack[RunArguments]
) -> list[dict[str, float]]:
    """For each system: component -> mean time per step inside its FMU [us]; `options` go to `run`.

    The systems take turns, so that a temporary disturbance of the computer affects all of them.
    """
    least: list[dict[str, float]] = [{} for _ in systems]
    for _ in range(repeats):
        for system, times in zip(systems, least, strict=True):
            card = run(system, **options).card
            for name, spent in card.inside.items():
                times[name] = min(times.get(name, float("inf")), spent / card.steps * 1e6)
    return least


@dataclass(frozen=True)
class Combination:
    """The run of one combination of variants.

    reached    simulated time [s]
    failure    why the run ended early; empty if it did not
    inside     time in the steps of all FMUs [us] per simulated millisecond
    factor     real-time factor of the whole run
    residual   largest energy error of the coupling at a power bond, relative to the energy exchanged there
    change     largest RMS difference of a watched signal from the first combination, relative to its range
    warnings   number of warnings of the FMUs
    """

    variants: Mapping[str, str]
    reached: float = 0.0
    failure: str = ""
    inside: float = float("nan")
    factor: float = float("nan")
    residual: float = float("nan")
    change: float = float("nan")
    warnings: int = 0


def combinations(
    system: System,
    variants: Mapping[str, Sequence[str]],
    watch: Sequence[str],
    **options: Unpack[RunArguments],
) -> Iterator[Combination]:
    """Run each combination of `variants` {component: names}; `options` go to `run`."""
    first = None
    for names in product(*variants.values()):
        chosen = dict(zip(variants, names, strict=True))
        swapped = with_swaps(system, chosen)
        try:
            result, failure = attempt(swapped, **options)
        except Problem as problem:  # before the first step; the next combination may run
            yield Combination(chosen, failure=str(problem))
            continue
        first, card = first or result.trace, result.card
        yield Combination(
            variants=chosen,
            reached=card.simulated,
            failure=failure,
            inside=sum(card.inside.values()) * 1e3 / max(card.simulated, 1e-9),
            factor=card.real_time_factor,
            residual=max((abs(bond.relative) for bond in card.bonds), default=0.0),
            change=_change(result.trace, first, watch),
            warnings=len(card.warnings),
        )


def _change(trace: Trace, first: Trace, watch: Sequence[str]) -> float:
    """Largest RMS difference of a watched signal over the common time, relative to its range."""
    count = min(len(trace.time), len(first.time))
    pairs = [(trace[name][:count], first[name][:count]) for name in watch] if count else []
    return max((rms(a - b) / size for a, b in pairs if (size := span(b))), default=0.0)


# Attribute of a combination, headings on the terminal and in the CSV file, and how its value is printed
COLUMNS = (
    ("reached", "reached s", "reached [s]", "{:.6g}", 1),
    ("inside", "us per ms", "inside all FMUs [us per ms]", "{:.2f}", 1),
    ("factor", "x real time", "times real time", "{:.1f}", 1),
    ("residual", "residual", "residual [1]", "{:.2g} %", 100),
    ("change", "change", "change [1]", "{:.2f} %", 100),
    ("warnings", "warnings", "warnings", "{}", 1),
)
STEP = 1e-3  # communication step [s]
LENGTH, REPEATS = 4.0, 2  # duration [s] and number of the runs that measure the cost of a variant
RUN: RunArguments = {"step": STEP, "record_step": 0.02}  # options of all runs [s]


def costs(system: Path, variants: Sequence[tuple[str, str]]) -> dict[tuple[str, str], float]:
    """(component, variant) -> time [us] per step inside its FMU, with the default variants of the others."""
    default, options = load(system), RUN | {"stop": LENGTH}
    spent = inside([with_swaps(default, {p: v}) for p, v in variants], REPEATS, **options)
    return {(part, variant): times[part] for (part, variant), times in zip(variants, spent, strict=True)}


def table(
    system: Path,
    variants: Mapping[str, Sequence[str]],
    watch: Sequence[str],
    out: Path,
    report: Callable[[str], object],
) -> bool:
    """Run every combination, report a table and write it to `out`; True if all came to the end.

    Each row is written at once, so the file contains all finished rows if the user interrupts.
    """
    make_folder(out.parent)
    widths = [max(map(len, (part, *names))) for part, names in variants.items()]
    total, done, complete = prod(map(len, variants.values())), 0, True
    count = len(f"{total}/{total}")

    def show(index: str, names: Iterable[str], cells: Iterable[str], failure: str) -> None:
        padded = "  ".join(n.ljust(w) for n, w in zip(names, widths, strict=True))
        report(" ".join((index.rjust(count), padded, *(f"{cell:>12}" for cell in cells), failure)))

    show("", variants, (head for _, head, *_ in COLUMNS), "")
    rows = [[*variants, *(head for _, _, head, *_ in COLUMNS), "failure"]]
    try:
        for done, row in enumerate(combinations(load(system), variants, watch, **RUN), 1):
            chosen, values = list(row.variants.values()), [getattr(row, name) for name, *_ in COLUMNS]
            printed = (f.format(k * v) for v, (*_, f, k) in zip(values, COLUMNS, strict=True))
            show(f"{done}/{total}", chosen, printed, row.failure)
            cells = ("" if np.isnan(value) else f"{value:.6g}" for value in values)
            rows.append([*chosen, *cells, row.failure])
            write_rows(out, rows)
            complete = complete and not row.failure
    except KeyboardInterrupt:
        report(f"\n{done} of {total} combinations, in {out}")
        raise
    report(
        f"\n{out}: change is that of {', '.join(watch)} against the first row, RMS over range;"
        " us per ms is the time in the steps of all FMUs, calls from Python included"
    )
    return complete
