"""A sampled controller at 1 kHz on the harvester, FMI 3.0: `python -m benchmarks.clocked`.

The controller is an FMU with a constant clock of 1 ms in place of the operator's boom lever. It sums a
pressure in event mode, so that each communication step of 1 ms has an instant in which all FMUs with event
mode take part. Beside it the same machine without the controller. The bar is 5 times real time. The processor
time of a run in this process does not depend on what else the computer does.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path
from time import process_time

from fmus.machine.build import harvester
from orchestrator import System, assemble, load, run

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from kit.any_fmu.models import ticking_fmu

TARGET, READ = "boom_stick.boom_command", "boom_stick.boom_head_pressure"
STEP, STOP, LIMIT = 1e-3, 4.0, 5.0


def controlled(system: System, folder: Path, unit: Path) -> System:
    """The system with the controller at the boom's command [V], which stays near zero: 1e-15 V/Pa."""
    files = {name: folder / f"{name}.fmu" for name in system.components}
    wires = [
        (str(c.source), str(c.target), c.map.factor, c.map.offset)
        for c in system.connections
        if str(c.target) != TARGET
    ]
    starts = {f"{n}.{v}": x for n, c in system.components.items() for v, x in c.start.items()}
    driven = {str(c.target) for c in system.connections} | {TARGET}
    starts = {name: value for name, value in starts.items() if name not in driven}
    return assemble(
        {**files, "unit": unit},
        [*wires, (READ, "unit.u"), ("unit.y", TARGET, 1e-15, 0.0)],
        {**starts, "unit.every": 1_000_000},
    )


def main() -> None:
    """Print times real time, best of the repeats."""
    parser = argparse.ArgumentParser(prog="benchmarks.clocked", description=__doc__.splitlines()[0])
    parser.add_argument("--repeats", type=int, default=5)
    repeats = parser.parse_args().repeats
    with tempfile.TemporaryDirectory() as temporary:
        home = Path(temporary)
        harvester().write(home, versions=(3,))
        home = home / "fmi3"
        plain = load(home / "harvester.ssp")
        unit = ticking_fmu(home / "unit.fmu", f'intervalVariability="constant" intervalDecimal="{STEP}"')
        for name, system in (("without", plain), ("with", controlled(plain, home, unit))):
            options = {"step": STEP, "stop": STOP, "master": "gauss-seidel"}
            best = min((run(system, **options).card for _ in range(repeats)), key=lambda card: card.wall)
            factor = best.real_time_factor
            began = process_time()
            run(system, **options, isolate=False)
            used = 1e6 * (process_time() - began) / best.steps
            wall = f"{1e6 * best.wall / best.steps:8.1f} us per step {factor:8.1f} times real time"
            print(f"{name:<8} {wall} {used:8.1f} us of processor time")
        print(f"bar: {LIMIT:g} times, {'met' if factor >= LIMIT else 'MISSED'}")


if __name__ == "__main__":
    main()
