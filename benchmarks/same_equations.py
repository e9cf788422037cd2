"""Do two checkouts have the same subsystems? What each subsystem declares, and its equations at 300 states.

    python -m benchmarks.same_equations write new [CRANE.toml ...]
    cd OTHER_CHECKOUT && python HERE/benchmarks/same_equations.py write old [CRANE.toml ...]
    python -m benchmarks.same_equations compare old new

Compared are names, order, texts, units, bounds and start values of all variables, requirements, the structure
of the Jacobians, and rates, outputs and initial states with parameters within 10 % of theirs. The largest
difference is over the largest magnitude of each equation.
"""

import json
import sys
import zlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from fmus.contract import Subsystem, quantities, symbolic
from fmus.parameters import values
from orchestrator.data.table import Array

STATES = 300
GROUPS = ("parameters", "states", "inputs", "outputs")


def subsystems(cranes: Sequence[str]) -> Iterator[tuple[str, Subsystem]]:
    """Those of the harvester, and of cranes from files."""
    from fmus.crane.description import read
    from fmus.crane.machine import crane_machine
    from fmus.machine.parts import FERIC

    machines = {"harvester": FERIC} | {Path(file).stem: crane_machine(read(Path(file))) for file in cranes}
    for name, machine in machines.items():
        drivers = (
            machine.operator,
            machine.controller,
            machine.actuation,
            machine.sensors,
            machine.diagnosis,
        )
        variants = (sub for family in machine.families.values() for sub in family.values())
        for sub in (*variants, *filter(None, drivers)):
            yield f"{name}.{sub.name}", sub


def around(group: type[Any], start: Mapping[str, float], share: float, random: np.random.Generator) -> Array:
    """Values around a start, within a share of the nominal values, shape (n, STATES)."""
    scale = np.array([q.nominal for q in quantities(group).values()])[:, None]
    spread = scale * random.uniform(-share, share, (len(start), STATES))
    return np.array([*start.values()], float)[:, None] + spread


def write(folder: Path, cranes: Sequence[str]) -> None:
    """Write what each subsystem declares and computes."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, sub in subsystems(cranes):
        m, v, random = symbolic(sub), values(sub), np.random.default_rng(zlib.crc32(name.encode()))
        equations = ca.Function("equations", [m.x, m.u, m.p], [m.dx, m.y, m.require])
        declared = {g: [[n, asdict(q)] for n, q in quantities(getattr(sub, g)).items()] for g in GROUPS}
        structure = [ca.jacobian_sparsity(e, a).find() for e in (m.dx, m.y) for a in (m.x, m.u)]
        told = {"text": sub.text, "validity": sub.validity, "step": sub.step, "statements": [*m.statements]}
        told |= {**declared, "structure": structure, "start": [v.x, v.u, v.p]}
        (folder / f"{name}.json").write_text(json.dumps(told, default=str), encoding="utf-8")

        p = np.array([*v.p.values()], float)[:, None] * random.uniform(0.9, 1.1, (len(v.p), STATES))
        u, x = around(sub.inputs, v.u, 0.3, random), around(sub.states, v.x, 0.5, random)
        initial = m.initial().map(STATES)(x, u, p).full()
        index = [[*v.x].index(n) for n in m.calculated]
        x[index] = initial[index]
        dx, y, require = (a.full() for a in equations.map(STATES)(x, u, p))
        np.savez(folder / f"{name}.npz", rates=dx, outputs=y, requirements=require, initial=initial)


def compare(old: Path, new: Path) -> bool:
    """Print a line for each subsystem; whether all agree within 1e-12."""
    good = True
    for file in sorted(old.glob("*.json")):
        if not (new / file.name).is_file():
            print(f"{file.stem}: missing")
            good = False
            continue
        a, b = (json.loads((folder / file.name).read_text(encoding="utf-8")) for folder in (old, new))
        other, worst = [key for key in a if a[key] != b.get(key)], 0.0
        x, y = (np.load(folder / f"{file.stem}.npz") for folder in (old, new))
        for key in x.files:
            if x[key].shape != y[key].shape:
                worst = np.inf
            elif x[key].size:
                scale = np.nanmax(np.abs(x[key]), axis=1, keepdims=True) + 1e-300
                finite = np.isfinite(x[key]) & np.isfinite(y[key])
                worst = max(worst, float((np.abs(x[key] - y[key]) / scale)[finite].max(initial=0.0)))
        print(f"{file.stem}: {', '.join(other) or 'the same'}; largest difference {worst:.1e}")
        good &= not other and worst <= 1e-12
    return good


if __name__ == "__main__":
    what, *arguments = sys.argv[1:]
    if what == "write":
        write(Path(arguments[0]), arguments[1:])
    else:
        sys.exit(not compare(*map(Path, arguments)))
