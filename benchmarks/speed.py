"""Cost of the native FMUs and of the co-simulation: `make bench`, shorter with ARGS="--repeats 1".

The work cycle, in turn by the FMUs of the parts and by harvester.fmu, which is all of them in one;
`orchestrator.studies.variant_costs` says how the time inside an FMU is measured. Then the throughput of
`batch` on two cores: one by one in two processes, and in the vector lanes of two threads.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

import numpy as np

from fmus.machine.build import data, harvester
from fmus.machine.parts import FERIC
from orchestrator import System, batch, load, run
from orchestrator.studies.variant_costs import inside

SETTINGS = (("jacobi", 1e-3), ("gauss-seidel", 1e-3), ("gauss-seidel", 5e-3))
WHOLE = "harvester"
SECONDS, CORES = 10.0, 2  # of each machine in the throughput
MACHINES = {False: 64, True: 1024}  # one by one and in lanes: some seconds each
LIMIT = 2e6  # machine-steps of 1 ms per second in lanes


def speed(system: System, master: str, step: float, repeats: int) -> tuple[float, float]:
    """Time [us] per step with all that the orchestrator does, and times real time; best of the repeats."""
    cards = [
        run(system, data("scenarios/work_cycle.csv"), master=master, step=step).card for _ in range(repeats)
    ]
    best = min(cards, key=lambda card: card.wall)
    return best.wall / best.steps * 1e6, best.real_time_factor


def throughput(system: System, mass: str, in_lanes: bool, repeats: int) -> float:
    """Steps of 1 ms of all machines per second, of machines with different masses; best of the repeats."""
    masses = {mass: np.linspace(300.0, 400.0, MACHINES[in_lanes])}
    options = {"step": 1e-3, "stop": SECONDS, "record": [mass.replace("head_mass", "swing_angle")]}
    walls = []
    for _ in range(repeats):
        result = batch(
            system, masses, data("scenarios/work_cycle.csv"), lanes=in_lanes, workers=CORES, **options
        )
        assert set(result.status) == {"ok"}
        walls.append(result.wall)
    return MACHINES[in_lanes] * SECONDS / 1e-3 / min(walls)


def print_throughput(parts: System, whole: System, repeats: int) -> None:
    """Print the table of `batch`."""
    print(
        f"\nbatch on {CORES} cores: million machine-steps of 1 ms per second (bar in lanes {LIMIT / 1e6:g})"
    )
    print(f"{'':<22}{'one by one':>12}{'in lanes':>12}{'ratio':>12}")
    for name, system, component in (("parts", parts, "manipulator"), ("whole", whole, WHOLE)):
        single, lanes = (
            throughput(system, f"{component}.head_mass", way, repeats) / 1e6 for way in (False, True)
        )
        print(f"{name:<22}{single:>12.2f}{lanes:>12.2f}{lanes / single:>12.1f}", flush=True)


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(prog="benchmarks.speed", description=__doc__.splitlines()[0])
    parser.add_argument("--repeats", type=int, default=5)
    repeats = parser.parse_args().repeats
    cycle = data("scenarios/work_cycle.csv")
    with tempfile.TemporaryDirectory() as folder:
        harvester().write(Path(folder))
        parts, whole = (load(Path(folder) / f"{WHOLE}.{suffix}") for suffix in ("ssp", "fmu"))
        print(f"{'':<22}us per step inside the FMUs{'':<33}{'us per step in all':>20}{'times real time':>20}")
        heads = [*FERIC.subsystems, "sum", WHOLE, "whole/sum", "parts", "whole", "parts", "whole"]
        print(f"{'master':<14}{'step':>8}" + "".join(f"{head:>12}" for head in heads))
        for master, step in SETTINGS:
            found = inside([parts, whole], repeats, scenario=cycle, master=master, step=step)
            means = found[0] | found[1]
            total = sum(means[name] for name in FERIC.subsystems)
            inside_fmus = [
                *(means[name] for name in FERIC.subsystems),
                total,
                means[WHOLE],
                means[WHOLE] / total,
            ]
            (slow, slow_factor), (fast, fast_factor) = (
                speed(s, master, step, repeats) for s in (parts, whole)
            )
            cells = "".join(f"{cost:>12.2f}" for cost in inside_fmus) + f"{slow:>12.1f}{fast:>12.1f}"
            print(f"{master:<14}{step * 1e3:>5g} ms{cells}{slow_factor:>12.0f}{fast_factor:>12.0f}")
        print_throughput(parts, whole, repeats)


if __name__ == "__main__":
    main()
