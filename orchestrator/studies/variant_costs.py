"""Cost of each variant of a component, and its effect on the results.

The cost is the time inside an FMU: from setting its inputs to the end of its fmi2DoStep or fmi3DoStep, as
measured by the simulation loop in C. The minimum of several runs counts, as it is the least disturbed.
Compare only times that were measured on one computer in one session.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Unpack

from orchestrator.base.errors import Problem
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


STEP = 1e-3  # communication step [s]
LENGTH, REPEATS = 4.0, 2  # duration [s] and number of the runs that measure the cost of a variant


def costs(system: Path, variants: Sequence[tuple[str, str]]) -> dict[tuple[str, str], float]:
    """(component, variant) -> time [us] per step inside its FMU, with the default variants of the others."""
    default = load(system)
    swapped = [with_swaps(default, {part: variant}) for part, variant in variants]
    spent = inside(swapped, REPEATS, step=STEP, record_step=0.02, stop=LENGTH)
    return {(part, variant): times[part] for (part, variant), times in zip(variants, spent, strict=True)}
