"""Equations by name: of one subsystem as numbers and expressions, of the joined machine over time."""

from collections.abc import Callable, Mapping, Sequence
from functools import cache, cached_property
from types import SimpleNamespace

import casadi as ca
import numpy as np
from scipy.optimize import brentq

from fmus.components.spool_valve import CurvedValve
from fmus.contract import Subsystem, Symbolic, nested, quantities, symbolic
from fmus.machine.machine import wiring
from fmus.machine.parts import FERIC
from fmus.machine.poses import POSES, parameter
from fmus.monolith import Monolith, join, simulate
from fmus.operator_input.work_cycle import COMMANDS, PROGRAMS, sample
from fmus.parameters import values

SUPPLY = 20.684e6  # Pa
# the valve of the paper, written out here; its edges have no tables
_NUMBERS = {
    "area": 4e-5,
    "discharge_coefficient": 0.62,
    "dead_band": 0.6,
    "full_command": 10.0,
    "command_rounding": 0.4,
    "leakage": 1.6e-14,
    "transition_reynolds": 10.0,
}
VALVE = nested(CurvedValve, dict.fromkeys(quantities(CurvedValve), 0.0) | _NUMBERS)
OIL = SimpleNamespace(density=970.0, viscosity=0.02, kinematic_viscosity=0.02 / 970.0)  # at 60 degC
EDGES = ("pa", "at", "pb", "bt")
JOINTS = ("swing", "boom", "stick")


def number(value: object) -> float:
    """What CasADi made of numbers."""
    return float(ca.DM(value))


def lines(supply: float = SUPPLY, tank: float = 0.0, sensing: float = 0.0) -> SimpleNamespace:
    """Pressures [Pa] of the lines at a valve."""
    return SimpleNamespace(supply_pressure=supply, tank_pressure=tank, load_sensing_pressure=sensing)


def random_curve(rng: np.random.Generator, prefix: str) -> dict[str, float]:
    """Parameters of an opening curve with three to ten points in every second case, else none: all zero."""
    count = rng.integers(3, 11) if rng.random() < 0.5 else 0
    commands, openings = np.zeros(10), np.zeros(10)
    commands[:count] = np.sort(rng.uniform(0.3, 10.0, count)) + 0.01 * np.arange(count)
    openings[1:count] = np.sort(rng.uniform(0.0, 1.0, max(count - 1, 0)))
    columns = (("command", commands), ("opening", openings))
    return {f"{prefix}_{name}_{i}": float(v) for name, column in columns for i, v in enumerate(column, 1)}


def cavity(pressure: float) -> float:
    """C_cav [m3/Pa] as docs/equations.md, section 3, prints it."""
    return 1e-12 * np.exp(np.clip((-20e3 - pressure) / 5e3, -60, 40))


def piston_areas(p: Mapping[str, float], name: str) -> tuple[float, float]:
    """A_h, A_r [m2] of a cylinder."""
    head = np.pi / 4 * p[f"{name}_bore"] ** 2
    return head, head - np.pi / 4 * p[f"{name}_rod"] ** 2


def edge_resistance(p: Mapping[str, float], command: float) -> float:
    """C_R [Pa.s2/m6] of one edge by eq. (2) at a command [V] beyond the rounded foot."""
    shift = p["valve_dead_band"] + p["valve_command_rounding"] / 2
    share = (command - shift) / (p["valve_full_command"] - shift)
    return p["density"] / (2 * p["valve_discharge_coefficient"] ** 2 * (p["valve_area"] * share) ** 2)


def hose_drop(p: Mapping[str, float], name: str, flow: float) -> float:
    """Drop [Pa] in a hose with oil of 60 degC: Hagen-Poiseuille below Re 2300, Blasius above."""
    length, bore = p[f"{name}_hose_length"], p[f"{name}_hose_bore"]
    speed = flow / (np.pi / 4 * bore**2)
    reynolds = speed * bore * p["density"] / p["viscosity"]
    factor = 64 / reynolds if reynolds < 2300 else 0.3164 / reynolds**0.25
    return factor * length / bore * p["density"] * speed**2 / 2


def steady_velocity(p: Mapping[str, float], name: str, command: float, load: float) -> float:
    """Speed [m/s] at which the drops over edges and hoses leave a cylinder the force of a load [N].

    Of the hoses, 1 % of the drops, Blasius' factor of their Reynolds number.
    """
    head, rod = piston_areas(p, name)
    c_r = edge_resistance(p, abs(command))
    drive = head * SUPPLY - load if command > 0 else rod * SUPPLY + load

    def excess(speed: float) -> float:
        lost = (a * (c_r * (a * speed) ** 2 + hose_drop(p, name, a * speed)) for a in (head, rod))
        return sum(lost) - drive

    return float(np.copysign(brentq(excess, 1e-6, 10.0, xtol=1e-12), command))


class Part:
    """A subsystem with its numbers, those named here changed.

    p, u   parameters and inputs that hold where nothing else is said
    """

    def __init__(self, sub: Subsystem, **changed: float) -> None:
        own = values(sub)
        self.sub = sub
        self.p = {**own.p, **{n: v for n, v in changed.items() if n in own.p}}
        self.u, self._x = dict(own.u), list(own.x.values())
        self.states, self.inputs, self.outputs = (
            list(quantities(g)) for g in (sub.states, sub.inputs, sub.outputs)
        )
        self.nominal = np.array([q.nominal for q in quantities(sub.states).values()])

    @cached_property
    def model(self) -> Symbolic:
        """The equations, when a test first asks for them."""
        return symbolic(self.sub)

    @cached_property
    def function(self) -> ca.Function:
        """(x, u, p) -> dx, y."""
        return self.model.function()

    @cached_property
    def expressions(self) -> dict[str, dict[str, ca.SX]]:
        """Symbols of "x" and "u" and expressions of the outputs "y", by name."""
        m = self.model
        columns = {"x": (self.states, m.x), "u": (self.inputs, m.u), "y": (self.outputs, m.y)}
        return {k: dict(zip(names, ca.vertsplit(v), strict=True)) for k, (names, v) in columns.items()}

    def at(self, name: str) -> int:
        """Place of a state among the states."""
        return self.states.index(name)

    def start(self, inputs: Mapping[str, float] | None = None, **states: float) -> np.ndarray:
        """The states at the start (n,), those named here as given."""
        u = list((self.u | dict(inputs or {})).values())
        x = self.model.initial()(self._x, u, list(self.p.values())).full()[:, 0]
        for name, value in states.items():
            x[self.at(name)] = value
        return x

    def __call__(self, x: np.ndarray, **inputs: float) -> tuple[np.ndarray, dict[str, float]]:
        """Rates (n,) and outputs by name."""
        dx, y = self.function(x, list((self.u | inputs).values()), list(self.p.values()))
        return dx.full()[:, 0], dict(zip(self.outputs, y.full()[:, 0], strict=True))

    def of(self, *expressions: ca.SX) -> Callable[..., list[np.ndarray]]:
        """The expressions as a function (x, **inputs) -> matrices."""
        m = self.model
        function = ca.Function("of", [m.x, m.u, m.p], list(expressions))

        def at(x: np.ndarray, **inputs: float) -> list[np.ndarray]:
            found = function.call([x, list((self.u | inputs).values()), list(self.p.values())])
            return [value.full() for value in found]

        return at

    def along(self, expression: ca.SX) -> ca.SX:
        """d/dt along the solution: positions and speeds move on, other inputs with their rates, if any."""
        rate, u = ca.jtimes(expression, self.model.x, self.model.dx), self.expressions["u"]
        motion = {"position": "velocity", "velocity": "acceleration", "speed": "acceleration"}
        for name, symbol in u.items():
            stem, _, kind = name.rpartition("_")
            source = f"{stem}_{motion[kind]}" if kind in motion else f"{name}_rate"
            if source in u:
                rate += ca.jacobian(expression, symbol) * u[source]
        return rate

    def follow(
        self,
        time: np.ndarray,
        inputs: Callable[[ca.SX], Mapping[str, ca.SX | float]] = lambda _: {},
        tolerance: float = 1e-9,
        x: np.ndarray | None = None,
    ) -> dict[str, np.ndarray]:
        """Outputs (n,) by name from the start, or from x on, with inputs that are functions of the time."""
        t, z = ca.SX.sym("t"), ca.SX.sym("z", len(self.states))
        nominal = self.nominal
        u, p = ca.vertcat(*(self.u | dict(inputs(t))).values()), list(self.p.values())
        driven = ca.Function("driven", [t], [u])
        rate = self.function(z * nominal, u, p)[0] / nominal
        options = {"reltol": tolerance, "abstol": tolerance, "max_num_steps": 1_000_000}
        ode = {"t": t, "x": z, "ode": rate}
        solver = ca.integrator("follow", "cvodes", ode, time[0], time[1:], options)
        usual = self.model.initial()(self._x, driven(time[0]), p)
        start = (usual if x is None else ca.DM(x)) / nominal
        x = ca.horzcat(start, solver(x0=start)["xf"]) * nominal
        y = self.function.map(time.size)(x, driven.map(time.size)(time[None, :]), ca.DM(p))[1]
        return dict(zip(self.outputs, y.full(), strict=True))


@cache
def machine(**variants: str) -> Monolith:
    """The machine with these variants as one ODE."""
    chosen = FERIC.chosen(**variants)
    return join(chosen, *wiring(chosen))


def in_pose(model: Monolith, pose: str, changed: Mapping[str, float] | None = None) -> np.ndarray:
    """Parameters of the machine that starts in a pose; `changed`: others by `part.name`."""
    p = model.p.copy()
    given = {f"manipulator.{parameter(joint)}": getattr(POSES[pose], joint) for joint in JOINTS}
    for name, value in (given | dict(changed or {})).items():
        p[model.parameters.index(name)] = value
    return p


def played(
    model: Monolith,
    time: np.ndarray,
    inputs: Mapping[str, np.ndarray | float],
    p: np.ndarray | None = None,
    tolerance: float = 1e-9,
) -> dict[str, np.ndarray]:
    """Time and outputs (n,) by name; inputs that are not given stay as they are at the start."""
    u = np.tile(model.u, (time.size, 1))
    for name, samples in inputs.items():
        u[:, model.inputs.index(name)] = samples
    _, y = simulate(model, time, u, p, tolerance)
    return {"time": time} | dict(zip(model.output_names, y.T, strict=True))


def corners(
    stop: float, commands: Mapping[str, tuple[Sequence[float], Sequence[float]]], rate: int = 200
) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Time (n,) at `rate` [Hz] and commands (n,) by input, straight between their corners (times, values)."""
    time = np.linspace(0, stop, round(rate * stop) + 1)
    return time, {name: np.interp(time, *points) for name, points in commands.items()}


def work_cycle(stop: float) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Time (n,) and commands (n,) by input of the first seconds of the work cycle."""
    time, commands = sample(PROGRAMS["work_cycle"], stop)
    return time, dict(zip(COMMANDS, commands.T, strict=True))
