"""Cost of each variant of a component.

The cost is the time inside an FMU: from setting its inputs to the end of its fmi2DoStep or fmi3DoStep, as
measured by the simulation loop in C. The minimum of several runs counts, as it is the least disturbed.
Compare only times that were measured on one computer in one session.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Unpack

from orchestrator.engine.arguments import RunArguments
from orchestrator.engine.run import run
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


STEP = 1e-3  # communication step [s]
LENGTH, REPEATS = 4.0, 2  # duration [s] and number of the runs that measure the cost of a variant


def costs(system: Path, variants: Sequence[tuple[str, str]]) -> dict[tuple[str, str], float]:
    """(component, variant) -> time [us] per step inside its FMU, with the default variants of the others."""
    default = load(system)
    swapped = [with_swaps(default, {part: variant}) for part, variant in variants]
    spent = inside(swapped, REPEATS, step=STEP, record_step=0.02, stop=LENGTH)
    return {(part, variant): times[part] for (part, variant), times in zip(variants, spent, strict=True)}
