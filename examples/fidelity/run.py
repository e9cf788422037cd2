"""The work cycle with every variant of one part: `python examples/fidelity/run.py [part]`.

Needs a folder made by `harvester build`; the other parts stay the usual ones. Printed is how far each variant
is from the most detailed one, that with the most states, and what it costs; drawn is what differs most.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping
from pathlib import Path

from fmus.contract import Subsystem, quantities
from fmus.machine.parts import FAMILIES
from orchestrator import Problem, compare, load, run, with_swaps
from orchestrator.base.text import percentage
from orchestrator.results.comparison import Comparison
from orchestrator.results.comparison_report import report
from orchestrator.studies.variant_costs import inside

KINDS = ("speed", "angle", "pressure")  # joint speeds and angles [rad/s, rad], all pressures
TIMED = 4.0  # s of the work cycle that the cost inside the FMU is measured on


def states(sub: Subsystem) -> int:
    """How many states a variant has."""
    return len(quantities(sub.states))


def simulate(system: Path, part: str, stop: float) -> Comparison:
    """A run with each variant, compared with the one that has the most states."""
    variants = FAMILIES[part]
    runs = {name: run(system, swap={part: name}, stop=stop) for name in variants}
    return compare(runs, against=max(variants, key=lambda name: states(variants[name])))


def costs(system: Path, part: str, stop: float) -> dict[str, float]:
    """Of each variant: milliseconds inside the FMU for each second simulated."""
    machines = [with_swaps(load(system), {part: name}) for name in FAMILIES[part]]
    spent = inside(machines, stop=min(stop, TIMED), step=1e-3)
    return {name: max(found[part], 0.0) for name, found in zip(FAMILIES[part], spent, strict=True)}


def table(part: str, found: Comparison, cost: Mapping[str, float]) -> str:
    """A line for each variant: states, costs, and of each kind the worst error with its signal."""
    lines = [f"{part:<20}{'states':>6}{'FMU ms/s':>10}{'all ms/s':>10}   worst NRMSE of each kind"]
    for one in found.runs:
        told = "the reference"
        if one is not found.reference:
            worst = [row for kind in KINDS if (row := found.worst(one.label, kind))]
            told = ", ".join(f"{percentage(row.metrics.nrmse)} {row.signal}" for row in worst)
        assert one.metadata is not None
        whole = 1e3 * one.metadata.wall / one.metadata.simulated
        size = states(FAMILIES[part][one.label])
        lines.append(f"{one.label:<20}{size:>6}{cost[one.label]:>10.2f}{whole:>10.1f}   {told}")
    return "\n".join(lines)


def main() -> None:
    """Read the command line, run, print and draw."""
    parser = argparse.ArgumentParser(description="The work cycle with every variant of one part")
    parser.add_argument("part", nargs="?", choices=FAMILIES, default="boom_stick")
    parser.add_argument("--build", type=Path, default=Path("build"), help="where `harvester build` built")
    parser.add_argument("--stop", type=float, default=42.0, help="[s]")
    parser.add_argument("--out", type=Path, default=Path("build/fidelity"), help="folder of the page")
    chosen = parser.parse_args()
    system = chosen.build / "harvester.ssp"
    if not system.exists():
        sys.exit(f"{system} is not there: run `harvester build` first")
    found = simulate(system, chosen.part, chosen.stop)
    print(table(chosen.part, found, costs(system, chosen.part, chosen.stop)))
    print(*report(found).write(chosen.out / "comparison.html"))


if __name__ == "__main__":
    try:
        main()
    except Problem as problem:
        sys.exit(str(problem))
