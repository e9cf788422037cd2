"""A sampled controller at 1 kHz on the harvester, FMI 3.0: `python -m benchmarks.clocked`.

The controller is an FMU with a constant clock of 1 ms in place of the operator's boom lever. It sums a
pressure in event mode, so that each communication step of 1 ms has an instant in which all FMUs with event
mode take part. Beside it the same machine without the controller, and with others that have no clock: one
announces each sample, the other only asks for event mode at the end of the step that reaches it. The bars are
5 times real time, and 1.5 times the processor time of the one that announces. The processor time of a run in
this process does not depend on what else the computer does.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from math import inf
from pathlib import Path
from time import process_time

from fmus.machine.build import harvester
from orchestrator import System, assemble, load, run

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from kit.any_fmu.models import stopping_fmu, ticking_fmu

TARGET, READ = "boom_stick.boom_command", "boom_stick.boom_head_pressure"
STEP, STOP, LIMIT, RATIO = 1e-3, 4.0, 5.0, 1.5


def controlled(
    system: System, folder: Path, unit: Path, output: str, reads: bool = False, **values: float
) -> System:
    """The system with a controller at the boom's command [V], which stays near zero: 1e-15 V."""
    files = {name: folder / f"{name}.fmu" for name in system.components}
    wires = [
        (str(c.source), str(c.target), c.map.factor, c.map.offset)
        for c in system.connections
        if str(c.target) != TARGET
    ]
    starts = {f"{n}.{v}": x for n, c in system.components.items() for v, x in c.start.items()}
    driven = {str(c.target) for c in system.connections} | {TARGET}
    starts = {name: value for name, value in starts.items() if name not in driven}
    read = [(READ, "unit.u")] * reads
    given = {**starts, **{f"unit.{name}": value for name, value in values.items()}}
    return assemble({**files, "unit": unit}, [*wires, *read, (f"unit.{output}", TARGET, 1e-15, 0.0)], given)


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
        ticker = stopping_fmu(home / "ticker.fmu", "ticker")
        systems = {
            "without": plain,
            "clock": controlled(plain, home, unit, "y", reads=True, every=1_000_000),
            "announces": controlled(plain, home, ticker, "level", period=STEP),
            "asks": controlled(plain, home, ticker, "level", period=STEP, how=18),
        }
        options = {"step": STEP, "stop": STOP, "master": "gauss-seidel"}
        cards = {name: run(system, **options).card for name, system in systems.items()}
        used = dict.fromkeys(systems, inf)
        for _ in range(repeats):
            for name, system in systems.items():
                card = run(system, **options).card
                cards[name] = min(card, cards[name], key=lambda card: card.wall)
                began = process_time()
                run(system, **options, isolate=False)
                used[name] = min(used[name], process_time() - began)
        for name, card in cards.items():
            wall, times = 1e6 * card.wall * STEP / STOP, card.real_time_factor
            per_ms = f"{wall:8.1f} us per step {times:8.1f} times real time"
            spent = f"{1e6 * used[name] * STEP / STOP:8.1f} us of processor time"
            print(f"{name:<10} {per_ms} {spent} {card.steps:6} steps {card.repeated:6} repeated")
        factor, ratio = cards["clock"].real_time_factor, used["asks"] / used["announces"]
        print(f"bar: {LIMIT:g} times, {'met' if factor >= LIMIT else 'MISSED'}")
        print(
            f"bar: {RATIO:g} times one that announces, {ratio:.2f}, {'met' if ratio <= RATIO else 'MISSED'}"
        )


if __name__ == "__main__":
    main()
