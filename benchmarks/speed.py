"""Cost of the native FMUs and of the co-simulation: `make bench`.

The work cycle, in turn by the FMUs of the parts and by harvester.fmu, which is all of them in one;
`orchestrator.studies.variants` says how the time inside an FMU is measured.
"""

from __future__ import annotations

import tempfile
from pathlib import Path

from fmus.machine.build import build_machine, data
from fmus.machine.parts import SUBSYSTEMS
from orchestrator import System, load, run
from orchestrator.studies.variants import inside

REPEATS = 5
SETTINGS = (("jacobi", 1e-3), ("gauss-seidel", 1e-3), ("gauss-seidel", 5e-3))
WHOLE = "harvester"


def speed(system: System, master: str, step: float) -> tuple[float, float]:
    """Time [us] per step with all that the orchestrator does, and times real time; best of the repeats."""
    cards = [
        run(system, data("scenarios/work_cycle.csv"), master=master, step=step).card for _ in range(REPEATS)
    ]
    best = min(cards, key=lambda card: card.wall)
    return best.wall / best.steps * 1e6, best.real_time_factor


def main() -> None:
    """Print the table."""
    cycle = data("scenarios/work_cycle.csv")
    print(f"{'':<22}us per step inside the FMUs{'':<33}{'us per step in all':>20}{'times real time':>20}")
    heads = [*SUBSYSTEMS, "sum", WHOLE, "whole/sum", "parts", "whole", "parts", "whole"]
    print(f"{'master':<14}{'step':>8}" + "".join(f"{head:>12}" for head in heads))
    with tempfile.TemporaryDirectory() as folder:
        build_machine(Path(folder))
        parts, whole = (load(Path(folder) / f"{WHOLE}.{suffix}") for suffix in ("ssp", "fmu"))
        for master, step in SETTINGS:
            found = inside([parts, whole], REPEATS, scenario=cycle, master=master, step=step)
            means = found[0] | found[1]
            total = sum(means[name] for name in SUBSYSTEMS)
            costs = [*(means[name] for name in SUBSYSTEMS), total, means[WHOLE], means[WHOLE] / total]
            (slow, slow_factor), (fast, fast_factor) = (speed(s, master, step) for s in (parts, whole))
            cells = "".join(f"{cost:>12.2f}" for cost in costs) + f"{slow:>12.1f}{fast:>12.1f}"
            print(f"{master:<14}{step * 1e3:>5g} ms{cells}{slow_factor:>12.0f}{fast_factor:>12.0f}")


if __name__ == "__main__":
    main()
