"""What a crane can do, axis by axis, from its description: range, lever, forces, holding pressures, speeds.

    harvester crane check my.toml

The range of a joint is followed from its start pose in both directions, until the piston is at an end of its
stroke, its lever passes zero, or the linkage no longer closes; the last two are mistakes.

Holding pressures are those of the start pose without payload, with the other side of the piston at 0 bar.
Speeds are those of a valve at full opening, half of the supply pressure lost in each edge, no load.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from fmus.boom_stick import BOOM_STICK
from fmus.components.cylinder import areas
from fmus.contract import Subsystem, nested, quantities, symbolic
from fmus.crane.description import CraneDescription, JointDescription
from fmus.crane.manipulator import CraneManipulator, manipulator
from fmus.parameters import Values, values
from orchestrator.base.errors import Mistakes, Problem
from orchestrator.base.text import TextTable

STEP = {"revolute": math.radians(0.25), "prismatic": 2e-3}  # rad, m: of the search for the ends of a range
FARTHEST = {"revolute": 2 * math.pi, "prismatic": 50.0}
LEAST_LEVER = 0.02  # m: a smaller one is near zero


@dataclass(frozen=True)
class AxisCheck:
    """One driven joint.

    low, high         range of its coordinate [rad or m], infinite for a motor
    levers            least and largest |J| over it [m], of a motor 1
    push, pull        largest forces of the piston, or torque of the motor to both sides [N or N.m]
    holding           pressure that holds the start pose [Pa], on the side of the piston that carries
    speeds            of the joint at the start pose, forwards and backwards [rad/s or m/s]
    """

    joint: JointDescription
    low: float
    high: float
    levers: tuple[float, float]
    push: float
    pull: float
    holding: float
    speeds: tuple[float, float]


def check(crane: CraneDescription) -> list[AxisCheck]:
    """All axes; a Problem with a line for each mistake."""
    sub = manipulator(crane)
    of, v = _functions(sub), values(sub)
    start = outputs_at_start(sub)
    found, mistakes = list[AxisCheck](), list[str]()
    for joint in crane.driven:
        try:
            found.append(_axis(crane, of, joint, v, start))
        except Problem as problem:
            mistakes.append(f"{crane.file}: [{joint.name}] {problem}")
    if mistakes:
        raise Mistakes(mistakes)
    return found


def levers_at_start(crane: CraneDescription) -> dict[str, float]:
    """dx/dq of each drive in the start pose [m or 1]; positive: extending makes the coordinate grow."""
    sub = manipulator(crane)
    of, v = _functions(sub), values(sub)
    pistons = [j for j in crane.driven if j.drive != "motor"]
    levers = {j.name: float(_transmission(of, j, v)(j.start.value)[1]) for j in pistons}
    return {j.name: levers.get(j.name, 1.0) for j in crane.driven}


def _functions(sub: Subsystem) -> CraneManipulator:
    own: Any = sub.dynamics
    functions: CraneManipulator = own.__self__
    return functions


def outputs_at_start(sub: Subsystem) -> Mapping[str, float]:
    """Outputs of a manipulator at its start pose."""
    model, v = symbolic(sub), values(sub)
    x = model.initial()(list(v.x.values()), list(v.u.values()), list(v.p.values()))
    y = model.function()(x, list(v.u.values()), list(v.p.values()))[1].full()[:, 0]
    return dict(zip(quantities(sub.outputs), map(float, y), strict=True))


def _axis(
    crane: CraneDescription,
    of: CraneManipulator,
    joint: JointDescription,
    v: Values,
    start: Mapping[str, float],
) -> AxisCheck:
    pressure = crane.numbers["supply"]["pressure_setting"].value
    density = crane.numbers["oil"]["density"].value
    coefficient = values(BOOM_STICK).p["valve_discharge_coefficient"]
    flow = coefficient * joint["valve_area"] * math.sqrt(pressure / density)
    if joint.drive == "motor":
        per_turn = joint["motor_displacement"] * joint["gear_ratio"]
        torque, speed = pressure * per_turn, flow / per_turn
        return AxisCheck(joint, -math.inf, math.inf, (1.0, 1.0), torque, torque, 0.0, (speed, speed))
    head, rod = (float(x) for x in areas(joint["bore"], joint["rod"]))
    low, high, levers = _range(of, joint, v)
    force = start[f"{joint.name}_holding_force"]
    holding = force / head if force > 0 else -force / rod
    if holding > pressure:
        raise Problem(
            f"holds the arm at the start with {holding / 1e5:.0f} bar, expected at most the supply's "
            f"{pressure / 1e5:.0f} bar: a larger bore, a larger lever, or another start pose"
        )
    lever = abs(float(_transmission(of, joint, v)(joint.start.value)[1]))
    return AxisCheck(
        joint,
        low,
        high,
        levers,
        pressure * head,
        pressure * rod,
        holding,
        (flow / head / lever, flow / rod / lever),
    )


def _transmission(of: CraneManipulator, joint: JointDescription, v: Values) -> ca.Function:
    """q -> position, lever."""
    q, p = ca.SX.sym("q"), nested(of.parameters, v.p)
    t = of.transmission(joint, q, p)
    return ca.Function("transmission", [q], [t.position, ca.SX(t.arm)])


def _range(
    of: CraneManipulator, joint: JointDescription, v: Values
) -> tuple[float, float, tuple[float, float]]:
    """Ends of the coordinate over the stroke, least and largest lever."""
    unit, scale = ("deg", 180 / math.pi) if joint.kind == "revolute" else ("mm", 1e3)
    function, step = _transmission(of, joint, v), STEP[joint.kind]
    first, lever = (float(x) for x in function(joint.start.value))
    at = f"start {scale * joint.start.value:.4g} {unit}"
    if not math.isfinite(first):
        raise Problem(f"{at}: the four-bar linkage does not close there")
    if not 0 <= first <= joint["stroke"]:
        raise Problem(
            f"{at}: the piston is at {1e3 * first:.0f} mm, expected 0 to {1e3 * joint['stroke']:.0f} mm"
        )
    ends, levers = list[float](), [abs(lever)]
    for sign in (-1.0, 1.0):
        grid = joint.start.value + sign * step * np.arange(1, round(FARTHEST[joint.kind] / step))
        positions, arms = (np.asarray(x)[0] for x in function(grid[None, :]))
        for q, x, arm in zip(grid, positions, arms, strict=True):
            if not (math.isfinite(x) and math.isfinite(arm)):
                raise Problem(
                    f"the four-bar linkage does not close from {scale * q:.4g} {unit} on, at "
                    f"{1e3 * positions[np.isfinite(positions)][-1]:.0f} mm of {1e3 * joint['stroke']:.0f} mm"
                )
            if not 0 <= x <= joint["stroke"]:
                break
            if arm * lever <= 0 or abs(arm) < LEAST_LEVER:
                raise Problem(
                    f"the lever passes zero at {1e3 * x:.0f} mm of {1e3 * joint['stroke']:.0f} mm: the "
                    f"cylinder cannot move the joint through {scale * q:.4g} {unit}"
                )
            levers.append(abs(float(arm)))
        ends.append(float(q))
    return min(ends), max(ends), (min(levers), max(levers))


def table(crane: CraneDescription, found: list[AxisCheck]) -> str:
    """The axes as a table for a terminal."""
    head = ("joint", "drive", "start", "range", "lever", "push", "pull", "holds with", "speed out/in")
    rows = "\n".join(TextTable(head, [*map(_row, found)]).lines())
    pressure = crane.numbers["supply"]["pressure_setting"].value
    return f"{crane.title}: {len(crane.joints)} joints, {len(found)} driven, {pressure / 1e5:.0f} bar\n{rows}"


def _row(a: AxisCheck) -> list[str]:
    revolute = a.joint.kind == "revolute"
    unit, scale = ("deg", 180 / math.pi) if revolute else ("m", 1.0)
    force, lever = (
        ("kN.m", "1") if a.joint.drive == "motor" else ("kN", f"{a.levers[0]:.3f} to {a.levers[1]:.3f} m")
    )
    ends = f"{scale * a.low:.1f} to {scale * a.high:.1f} {unit}" if math.isfinite(a.low) else "no end"
    return [
        a.joint.name,
        a.joint.drive,
        f"{scale * a.joint.start.value:.1f} {unit}",
        ends,
        lever,
        *(f"{x / 1e3:.3g} {force}" for x in (a.push, a.pull)),
        f"{a.holding / 1e5:.0f} bar",
        "/".join(f"{scale * x:.3g}" for x in a.speeds) + f" {unit}/s",
    ]
