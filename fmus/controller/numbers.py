"""Numbers of the controller: its own gains, and those of the machine's parts as they are."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from fmus.contract import Subsystem, quantities, symbolic
from fmus.controller.gains import Gains
from fmus.controller.variables import CYLINDERS, GEOMETRY, MOTOR, NOMINAL, VALVE, ControllerInputs
from fmus.parameters import Number, Tables, numbers, read, values

JOINTS = ("swing", "boom", "stick")
MEASURED = tuple(n for n, q in quantities(ControllerInputs).items() if q.unit == "Pa")
OWN = tuple(quantities(Gains))
FILE = Path(__file__).with_name("parameters.toml")


def merged(swing: Subsystem, boom_stick: Subsystem, manipulator: Subsystem) -> Tables:
    """All numbers of the controller of a machine of these parts."""
    own, oil, motor, arm = read(FILE), numbers(boom_stick), numbers(swing), numbers(manipulator)
    found = {n: own["parameters"][n] for n in OWN}
    found |= {n: _of(arm["parameters"][n], "manipulator") for n in GEOMETRY}
    found |= {n: _of(oil["parameters"][n], "boom_stick") for n in CYLINDERS}
    found |= {f"swing_{n}": _of(motor["parameters"][n], "swing") for n in VALVE}
    found |= {n: _of(motor["parameters"][n], "swing") for n in MOTOR}
    found |= {f"nominal_{n}": _of(oil["start"][n], "boom_stick") for n in NOMINAL}
    start = {f"{j}_angle": _of(arm["parameters"][f"initial_{j}_angle"], "manipulator") for j in JOINTS}
    start |= {n: _of(oil["start"][n], "boom_stick") for n in ("supply_pressure", "tank_pressure")}
    pressures = start_pressures(swing) | start_pressures(boom_stick)
    at_rest = "pressure at rest in the nominal pose"
    start |= {n: Number(value, "Pa", "derived", at_rest) for n, value in pressures.items()}
    return {"parameters": found, "start": start}


def start_pressures(sub: Subsystem, inputs: Mapping[str, float] | None = None) -> dict[str, float]:
    """Pressures of a drive at the start that the controller measures; `inputs` by name, else its own."""
    v = values(sub)
    u = {**v.u, **(inputs or {})}
    x = symbolic(sub).initial()(*(list(group.values()) for group in (v.x, u, v.p))).full()[:, 0]
    return {n: float(f"{a:.9g}") for n, a in zip(v.x, x, strict=True) if n in MEASURED}


def _of(number: Number, part: str) -> Number:
    return replace(number, note=f"{number.note} (as in {part})")
