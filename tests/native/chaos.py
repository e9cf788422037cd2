"""Runs of an FMU that does anything, by an engine with sanitizers: the program of test_engine.py.

python chaos.py ENGINE FOLDER FIRST COUNT    seeds FIRST to FIRST + COUNT - 1; prints what became of the runs
"""

import json
import sys
from collections import Counter
from pathlib import Path
from random import Random
from typing import Any

from orchestrator import Coupling, Problem, assemble, run
from orchestrator.engine import c_library
from orchestrator.ssp.system import System

COUPLINGS = [Coupling("jacobi", order=2), Coupling("gauss-seidel"), Coupling("hermite")]
COUPLINGS += [Coupling("jacobi", adaptive=1e-2), Coupling("hermite", adaptive=1e-3)]
WIRES = ["{}.y -> {}.u", "{}.y[2] -> {}.u[1]", "{}.n -> {}.k[3]", "{}.fired -> {}.come", "{}.text -> {}.word"]
FMUS = ("fixed", "tunable", "changing", "countdown", "exchange")  # a clock, or Model Exchange


def system(folder: Path, random: Random) -> System:
    """One to three FMUs with wires of any kind, each input with one at most."""
    parts = {name: random.choice(FMUS) for name in "abc"[: random.randint(1, 3)]}
    wires = dict[str, str]()
    for wire in random.choices(WIRES, k=2 * len(parts)):
        source, target = random.choice([*parts]), random.choice([*parts])
        clocked = "fired" in wire or "text" in wire
        whole = wire.format(source, target).partition(" -> ")[2].partition("[")[0]
        if source != target and not (clocked and "exchange" in (parts[source], parts[target])):
            wires.setdefault(whole, wire.format(source, target))
    values = {f"{name}.seed": random.randrange(1 << 30) for name in parts}
    for option in ("wild", "fair"):
        values |= dict.fromkeys((f"{name}.{option}" for name in parts), random.randint(0, 1))
    return assemble({name: folder / f"{kind}.fmu" for name, kind in parts.items()}, [*wires.values()], values)


def outcome(folder: Path, seed: int) -> str:
    """What became of a run: complete, or ended by a message of one line."""
    random = Random(seed)
    options: dict[str, Any] = {"step": random.choice([0.01, 0.1, 0.3]), "stop": random.choice([0.5, 1.0])}
    try:
        run(system(folder, random), isolate=False, master=random.choice(COUPLINGS), **options)
    except Problem as problem:
        return "ended" if len(str(problem).splitlines()) == 1 else "with many lines"
    return "complete"


if __name__ == "__main__":
    engine, place, first, count = sys.argv[1:]
    c_library.shared_library = lambda *_: Path(engine)  # type: ignore[assignment]  # that with sanitizers
    found = Counter[str]()
    for number in range(int(first), int(first) + int(count)):
        print(f"seed {number}", file=sys.stderr)  # a sanitizer ends the process there
        found[outcome(Path(place), number)] += 1
    assert c_library.library()._name == engine
    print(json.dumps(found))
