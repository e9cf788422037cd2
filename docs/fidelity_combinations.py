"""Runs of all combinations of variants, and their effects on the results, for docs/fidelity.md."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import product
from typing import NamedTuple, Unpack

from orchestrator.base.errors import Problem
from orchestrator.base.signals import rms, span
from orchestrator.data.trace import Trace
from orchestrator.engine.arguments import RunArguments
from orchestrator.engine.run import attempt
from orchestrator.ssp.swap import with_swaps
from orchestrator.ssp.system import System


class Combination(NamedTuple):
    """The run of one combination of variants.

    reached    simulated time [s]
    failure    why the run ended early; empty if it did not
    residual   largest energy error of the coupling at a power bond, relative to the energy exchanged there
    change     largest RMS difference of a watched signal from the first combination, relative to its range
    """

    variants: Mapping[str, str]
    reached: float = 0.0
    failure: str = ""
    residual: float = float("nan")
    change: float = float("nan")


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
        try:
            result, failure = attempt(with_swaps(system, chosen), **options)
        except Problem as problem:  # before the first step; the next combination may run
            yield Combination(chosen, failure=str(problem))
            continue
        first, card = first or result.trace, result.card
        residual = max((abs(bond.relative) for bond in card.bonds), default=0.0)
        change = _change(result.trace, first, watch)
        yield Combination(chosen, card.simulated, failure, residual, change)


def _change(trace: Trace, first: Trace, watch: Sequence[str]) -> float:
    """Largest RMS difference of a watched signal over the common time, relative to its range."""
    count = min(len(trace.time), len(first.time))
    pairs = [(trace[name][:count], first[name][:count]) for name in watch] if count else []
    return max((rms(a - b) / size for a, b in pairs if (size := span(b))), default=0.0)
