"""What a path asks of a machine, before it moves: reach, strokes, speeds, flow of the pump, pressure.

The joints follow the path as the controller's reference does, by resolved rates. At rest in each pose the
arm's weight, with the payload, loads the pistons with the forces F; dynamic forces are left out. The speeds
y of the actuators ask for

    the speed W of a fully open valve at the pressure of the supply and the load F (`fmus.controller.valve`),
    at most that of the controller's limits
    Q = sum A_in |y|            A_in: area of the side that is filled
    P = (F + A' P_t)/A + 0.5 MPa        as `pressure_use` of the controller

A pump gives at most D w, and T w/P of the torque T of its engine, or of its torque limit. What a path asks in
proportion to its speed it asks less of if it lasts longer: use y/W or Q/Q_max times as long.
"""

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from fmus.contract import (
    Subsystem,
    column,
    quantities,
    stack,
    symbolic,
    symbols,
    unstack,
    with_derived,
)
from fmus.controller import CONTROLLER
from fmus.controller.arm import Arm
from fmus.controller.reference import speed_limits
from fmus.controller.valve import MARGIN, needed_pressures, nominal_full_speeds, section_speeds
from fmus.controller.variables import LEARNED
from fmus.machine.sway import Mode, sway
from fmus.manipulator import VARIANTS
from fmus.parameters import values
from orchestrator.base.errors import Problem
from orchestrator.data.table import Array
from orchestrator.ssp.system import Component, System

RATE = 100.0  # Hz, at which a path is examined
SEARCHES = 3  # steps of the search for the pose at each instant, from that before
FAR, LONG = 0.01, 20  # m, rows: a tip so far from its path for so long does not reach it; less is a jump
SLOW = 0.02  # of its limit: a slower actuator asks for nothing
SETTINGS = ("pressure_setting", "pump_1_pressure_setting", "pump_2_pressure_setting", "pressure_cut_off")
UNITS = {True: "rad/s", False: "m/s"}  # of an axis that turns the column, of a piston


@dataclass(frozen=True)
class Mechanics:
    """What is known of a machine: its controller, variants of its manipulator, the default one first."""

    controller: Subsystem
    manipulators: Mapping[str, Subsystem]

    @property
    def manipulator(self) -> Subsystem:
        """The default variant."""
        return next(iter(self.manipulators.values()))

    def sway(self, component: Component) -> list[Mode]:
        """Modes of what hangs from this manipulator; empty: nothing swings."""
        own = component.real_parameters().keys()
        like = max(self.manipulators.values(), key=lambda sub: len(own & quantities(sub.parameters).keys()))
        return sway(like, component)

    @property
    def arm(self) -> Arm:
        """As its controller knows it."""
        arm: Arm = self.controller.model.arm
        return arm

    def parameters(self, component: Component) -> Any:
        """Those of the controller in a system, derived ones with their values."""
        sub, own = self.controller, component.real_parameters()
        p = symbols(sub.parameters)
        derived = ca.Function("derived", [stack(p)], [stack(with_derived(sub, p))])
        given = [own.get(n, x) for n, x in values(sub).p.items()]
        return unstack(sub.parameters, derived(given).full()[:, 0].tolist())

    def learned_outputs(self, controller: str) -> list[str]:
        """Outputs of a controller with what it has learned."""
        return [f"{controller}.{a.name}_{n}" for a in self.arm.axes for n in (*LEARNED, "half_width")]

    def learned(self, component: Component, last: Mapping[str, float]) -> dict[str, float]:
        """Start values with what a controller has learned, by variable; last: its outputs at the end.

        Each run begins with one `hysteresis` of all valves: the mean of those that were learned.
        """
        p, name, plays = self.parameters(component), component.name, list[float]()
        for a in self.arm.axes:
            plays.append(2 * last[f"{name}.{a.name}_half_width"] / float(self.arm.valve(a, p).full_command))
        found = {n: x for n, x in last.items() if not n.endswith("_half_width")}
        return found | ({f"{name}.hysteresis": float(np.mean(plays))} if p.hysteresis > 0 else {})


MECHANICS = Mechanics(CONTROLLER, VARIANTS)  # of the harvester


@dataclass(frozen=True)
class Demand:
    """What a path asks of each actuator at each instant; arrays (axes, n).

    positions   of the pistons [m], speeds likewise
    limits      of the controller, for the speeds
    full        speeds of fully open valves at the pressure of the supply, in the direction of motion
    needed      pressure of the supply for load and valve [Pa], likewise
    flows       into the actuators [m3/s]
    """

    positions: Array
    speeds: Array
    limits: Array
    full: Array
    needed: Array
    flows: Array


@dataclass(frozen=True)
class Supply:
    """What a supply gives: its highest pressure [Pa], its flow at a pressure [Pa] of the loads [m3/s]."""

    pressure: float
    tank: float
    flow: Callable[[Array], Array]


def exceeded(
    system: System, mechanics: Mechanics, parts: tuple[str, str], time: Array, path: Array
) -> Iterator[str]:
    """One line for each kind of limit that a path exceeds; a Problem if the tip does not reach it.

    system   with the start values of the run: the tip is on the first point
    parts    names of manipulator and controller in it
    path     radius [m], height [m], angle [rad] over the time, shape (3, n)
    """
    manipulator, controller = (system.components[n] for n in parts)
    p, arm = mechanics.parameters(controller), mechanics.arm
    supply = _supply(system, p.nominal_supply_pressure)
    even = np.arange(time[0], time[-1] + 0.5 / RATE, 1 / RATE)
    path = np.array([np.interp(even, time, x) for x in path])
    joints, away = _follow(arm, p, path, manipulator.real_parameters())

    def at(row: int) -> str:
        return f"at {even[row]:.1f} s (radius {path[0, row]:.2f} m, height {path[1, row]:.2f} m)"

    ends = np.minimum(np.arange(even.size) + np.arange(LONG)[:, None], even.size - 1)
    if (lost := ~(away <= FAR)[ends].any(axis=0)).any():
        row = int(np.argmax(lost))
        raise Problem(f"{at(row)}: out of reach, the tip stays {away[row]:.2g} m away")
    found = _demand(
        mechanics, p, joints, _loads(mechanics, manipulator, joints), supply.pressure, supply.tank
    )
    inside = np.ones(even.size, bool)
    for a, x in zip(arm.axes[1:], found.positions[1:], strict=True):
        low, high = p.stroke_margin, getattr(p, a.name).stroke - p.stroke_margin
        row = int(np.argmax(np.abs(x - (low + high) / 2)))
        inside &= (ends := (low <= x) & (x <= high))
        if not ends[row]:
            place = f"the piston of {a.name} is at {x[row]:.3f} m"
            yield f"{at(row)}: {place}, expected {low:.3f} to {high:.3f} m"
    for row, line in _beyond(arm, found, supply, inside):
        yield f"{at(row)}: {line}"


def _beyond(arm: Arm, found: Demand, supply: Supply, inside: NDArray[np.bool_]) -> Iterator[tuple[int, str]]:
    """Row and text of too little pressure, speed and flow, where all pistons are within their strokes."""
    moving = inside & (np.abs(found.speeds) > SLOW * found.limits)
    lasting = float(moving.any(axis=0).sum() / RATE)
    need = np.where(moving, found.needed, 0.0)
    k, row = _largest(need)
    if need[k, row] > supply.pressure:
        needs = f"{arm.axes[k].name} needs {need[k, row] / 1e5:.0f} bar for its load and its valve"
        yield row, f"{needs}, the supply gives {supply.pressure / 1e5:.0f} bar"
    speed = np.where(moving, np.abs(found.speeds), 0.0)
    full = np.where(need < supply.pressure, found.full, math.inf)  # else that is the reason
    most = np.where(moving, np.minimum(found.limits, full), math.inf)
    k, row = _largest(speed / most)
    if (use := speed[k, row] / most[k, row]) > 1:
        of = "its valve gives" if full[k, row] < found.limits[k, row] else "the controller allows"
        needs, unit = f"{arm.axes[k].name} needs {speed[k, row]:.3g}", UNITS[arm.axes[k].turns]
        yield row, f"{needs} {unit}, {of} {most[k, row]:.3g} {unit}; {_lasting(use, lasting)}"
    flow, given = np.where(moving, found.flows, 0.0).sum(axis=0), supply.flow(need.max(axis=0))
    _, row = _largest((flow / given)[None])
    if (use := flow[row] / given[row]) > 1:
        needs = f"the functions need {6e4 * flow[row]:.0f} L/min"
        yield row, f"{needs}, the pump gives {6e4 * given[row]:.0f} L/min; {_lasting(use, lasting)}"


def _largest(values: Array) -> tuple[int, int]:
    k, row = np.unravel_index(np.argmax(values), values.shape)
    return int(k), int(row)


def _lasting(use: float, duration: float) -> str:
    return f"the motion needs {use * duration:.1f} s, asked {duration:.1f} s"


def _supply(system: System, nominal: float) -> Supply:
    """The supply of a system; `nominal`: pressure [Pa] of one that is not known."""
    p = next((p for c in system.components.values() if (p := c.real_parameters()).keys() & {*SETTINGS}), None)
    if p is None:
        return Supply(nominal, 0.0, lambda load: np.full_like(load, math.inf))
    pressure = max(p[n] for n in SETTINGS if n in p)
    size = p.get("main_pump_displacement", 2 * p.get("pump_displacement", math.inf))
    speed = p.get("engine_rated_speed", 1.0)
    torque = min(p.get(n, math.inf) for n in ("engine_rated_torque", "torque_limit"))

    def flow(load: Array) -> Array:
        at = load + p["margin"] if "margin" in p else np.full_like(load, pressure)
        return np.minimum(size * speed, torque * speed / np.clip(at, 1e5, pressure))

    return Supply(pressure, p.get("reservoir_pressure", 0.0) + p.get("return_preload", 0.0), flow)


def _follow(arm: Arm, p: Any, path: Array, given: Mapping[str, float]) -> tuple[Array, Array]:
    """Coordinates of the axes along a path, (axes, n), and the distance of the tip from it [m], (n,)."""
    (step, far), often = arm.search(p), np.repeat(path, SEARCHES, axis=1)
    start = [given[f"initial_{a.coordinate[0]}"] for a in arm.axes]
    joints = step.mapaccum(often.shape[1])(start, often).full()[:, SEARCHES - 1 :: SEARCHES]
    return joints, far.map(path.shape[1])(joints, path).full()[0]


def _loads(mechanics: Mechanics, manipulator: Component, joints: Array) -> Array:
    """Forces of the pistons that hold the arm at rest with its payload [N], torque of the motor [N.m]."""
    sub, axes, n = mechanics.manipulator, mechanics.arm.axes, joints.shape[1]
    model, v, own = symbolic(sub), values(sub), manipulator.real_parameters()
    names = list(v.p)
    p = np.tile(np.array([own.get(k, x) for k, x in v.p.items()])[:, None], n)
    p[[names.index(f"initial_{a.coordinate[0]}") for a in axes]] = joints
    payload = {"payload_mass": float(manipulator.value("payload_mass"))}
    x, u = (np.tile(np.array([*of.values()])[:, None], n) for of in (v.x, {**v.u, **payload}))
    rest = model.initial().map(n)(x, u, p)
    held = dict(zip(quantities(sub.outputs), model.function().map(n)(rest, u, p)[1].full(), strict=True))
    ends = ("_holding_torque", "_holding_force")
    none = np.zeros(n)
    return np.array([next((held[k] for e in ends if (k := a.name + e) in held), none) for a in axes])


def _demand(mechanics: Mechanics, p: Any, joints: Array, loads: Array, supply: float, tank: float) -> Demand:
    """loads: of `_loads`; pressures of supply and tank [Pa]."""
    arm, (m, n) = mechanics.arm, joints.shape
    q, w, load = (ca.SX.sym(k, m) for k in ("q", "w", "load"))
    pistons = arm.pistons(ca.vertsplit(q), p)
    limits, found = speed_limits(arm, pistons, p), list[Any]()
    driven = arm.actuators([x for x, _ in pistons], p)
    each = zip(driven.items(), pistons, ca.vertsplit(w), ca.vertsplit(load), strict=True)
    for (name, a), (x, lever), speed, force in each:
        y = lever * speed
        full = nominal_full_speeds(a, force, supply)
        hose = ca.sqrt(1 + a.hose.turbulent * a.gain**2)
        both = zip(section_speeds(a), full, strict=True)
        up, down = (ca.if_else(a.section_flows[0] > 0, s, f / hose) for s, f in both)
        needed = needed_pressures(a, force, tank)
        found.append(
            [
                *(x, y, limits[name], ca.if_else(y > 0, up, down)),
                ca.if_else(y > 0, *needed) + MARGIN,
                ca.if_else(y > 0, a.head_area, -a.rod_area) * y,
            ]
        )
    of = ca.Function("of", [q, w, load], [column(*row) for row in zip(*found, strict=True)])
    speeds = np.gradient(joints, 1 / RATE, axis=1)
    return Demand(*(x.full() for x in of.map(n)(joints, speeds, loads)))
