"""Every combination of variants of a system: does it come to the end, what does it cost and change."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np

from orchestrator.errors import Problem
from orchestrator.files.trace import Trace
from orchestrator.runs.simulation import Result, RunFailed, run
from orchestrator.system.system import System

NAN = float("nan")


@dataclass(frozen=True)
class Row:
    """One combination.

    reached    simulated time [s]
    failure    why it ended there; empty when it came to the end
    inside     time in the steps of all FMUs [us] for each millisecond simulated, ctypes included
    factor     times real time, all included
    residual   largest energy that the coupling made up at a power bond, share of what the bond exchanged
    change     largest RMS difference of a watched signal from the first combination, share of its range
    warnings   of the FMUs
    """

    variants: Mapping[str, str]
    reached: float
    failure: str
    inside: float
    factor: float
    residual: float
    change: float
    warnings: int


def combinations(
    system: System, variants: Mapping[str, Sequence[str]], watch: Sequence[str], **options: Any
) -> Iterator[Row]:
    """Run each combination of `variants` {component: names}; `options` go to `run`."""
    first = None
    for names in product(*variants.values()):
        chosen = dict(zip(variants, names, strict=True))
        whole, failure = system.swapped(chosen), ""
        try:
            result = run(whole, **options)
        except RunFailed as failed:
            result, failure = failed.result, str(failed)
        except Problem as problem:  # before the first step: the next combination may come further
            yield Row(chosen, 0.0, str(problem), NAN, NAN, NAN, NAN, 0)
            continue
        first = first or result.trace
        yield _row(chosen, result, failure, _change(result.trace, first, watch))


def _row(chosen: Mapping[str, str], result: Result, failure: str, change: float) -> Row:
    card = result.card
    return Row(
        variants=chosen,
        reached=card.simulated,
        failure=failure,
        inside=sum(card.inside.values()) * 1e3 / max(card.simulated, 1e-9),
        factor=card.real_time_factor,
        residual=max((abs(bond.relative) for bond in card.bonds), default=0.0),
        change=change,
        warnings=len(card.warnings),
    )


def _change(trace: Trace, first: Trace, watch: Sequence[str]) -> float:
    """Over the time that both have."""
    rows = min(len(trace.time), len(first.time))
    found = [0.0]
    for name in watch if rows else ():
        reference = first[name][:rows]
        span = float(np.ptp(reference))
        found.append(float(np.sqrt(np.mean((trace[name][:rows] - reference) ** 2))) / span if span else 0.0)
    return max(found)


HEAD = ("reached s", "us per ms", "x real time", "residual", "change", "warnings")


COLUMNS = (
    "reached [s]",
    "inside all FMUs [us per ms]",
    "times real time",
    "residual [share]",
    "change [share]",
    "warnings",
)


def figures(row: Row) -> tuple[str, ...]:
    """The figures of a row as plain numbers, empty where there are none."""
    numbers = (row.reached, row.inside, row.factor, row.residual, row.change, row.warnings)
    return tuple("" if np.isnan(number) else f"{number:.6g}" for number in numbers)


def cells(row: Row) -> tuple[str, ...]:
    """The figures of a row as text."""
    return (
        f"{row.reached:.6g}",
        f"{row.inside:.2f}",
        f"{row.factor:.1f}",
        f"{100 * row.residual:.2g} %",
        f"{100 * row.change:.2f} %",
        str(row.warnings),
    )
