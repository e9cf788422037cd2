"""The search of a steady state on plants of a few lines: its limit, dead bands, leakage, notes."""

# ruff: noqa: ARG005  (rates and matrices take x and u, whatever a plant uses of them)

from types import SimpleNamespace

import numpy as np
import pytest
from kit.mistakes import problem

from orchestrator.base.units import DeclaredUnit, parse_unit
from orchestrator.engine.plant import Matrices
from orchestrator.linear.steady_state import SteadyEquations, find_steady_state
from orchestrator.ssp.system import Inlet, Port

UNITS = {n: DeclaredUnit(n, parse_unit(n).exponents) for n in ("rad", "rad/s", "Pa", "V")}
NAMES = {"boom_angle": "rad", "boom_speed": "rad/s", "boom_pressure": "Pa", "boom_command": "V"}


class Plant:
    """dx/dt = f(x, u) with matrices A and B, numbers or functions of (x, u).

    requested   number of the inputs that were asked for
    """

    def __init__(self, f, a, b=None, *, x, u=(), names=(), requested=0):
        self.rate, self.parts = f, (a, np.zeros((len(x), len(u))) if b is None else b)
        self.x, self.u, self.nominal = (np.array(v, float) for v in (x, u, np.ones(len(x))))
        ports = [
            Port("m", n) for n in names or [*(f"x{k}" for k in range(len(x))), *["boom_command"][: len(u)]]
        ]
        self.states, inputs = ports[: len(x)], ports[len(x) :]
        inlets = [Inlet(p.variable, UNITS["V"], ((p, None),)) for p in inputs]
        self.cut, self.system = SimpleNamespace(inputs=inlets, requested_count=requested), self
        self.f = np.array(f(self.x, self.u), float)

    def variable(self, port):
        return SimpleNamespace(nominal=None, unit=UNITS.get(NAMES.get(port.variable)))

    def settle(self, x, u):
        self.x, self.u, self.f = x.copy(), u.copy(), np.array(self.rate(x, u), float)

    def matrices(self):
        parts = (np.array(m(self.x, self.u) if callable(m) else m, float) for m in self.parts)
        return Matrices(*parts, None, None)


@pytest.mark.parametrize(("level", "steady"), [(0.99, True), (1.0, True), (1.01, False)])
def test_a_rate_that_noise_keeps_is_steady_up_to_1e_11_of_its_terms(level, steady):
    """Terms of 1/4 from the state and 1/4 from its nominal value: up to 0.5e-11 is noise."""
    plant = Plant(lambda x, u: [level * 0.5e-11], [[-0.25]], x=[1])
    assert SteadyEquations(plant, (), ()).solve() == steady


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize(("load", "dead"), [(0.5, 0.2), (-0.5, 0.29), (0.5, 0.31)])
def test_a_command_leaves_its_dead_band_to_the_side_that_holds_the_load(side, load, dead):
    """p' = g dz(u) - p, a = p - load: u = load / g beyond a dead band of less than 30 % of the command."""
    gain = 2.0 * side
    plant = Plant(
        lambda x, u: [x[1], x[2] - load, gain * np.sign(u[0]) * max(abs(u[0]) - dead, 0) - x[2]],
        [[0, 1, 0], [0, 0, 1], [0, 0, -1]], lambda x, u: [[0], [0], [gain * (abs(u[0]) > dead)]],
        x=[0, 0, 0], u=[0], names=NAMES,
    )  # fmt: skip
    if dead > 0.3:  # no sign is found with a command of 30 %
        told = r"found with m\.boom_speed = {}: m\.boom_speed still changes; use {}"
        problem(lambda: find_steady_state(plant), told.format(0, "a time"))
        problem(lambda: find_steady_state(plant, {"boom": 9.0}), told.format(9, "lower speeds"))
        return
    (notes, _), u = find_steady_state(plant), load / gain + np.copysign(dead, load / gain)
    assert plant.u[0] == pytest.approx(u, rel=1e-10)  # Newton's method stops at 1e-11 of the terms
    np.testing.assert_allclose(plant.x, [0, 0, load], atol=1e-10)
    assert notes[1] == f"constant inputs of the steady state: boom_command = {u:g} V"


def test_a_joint_is_held_on_oil_that_only_leakage_lets_out():
    """A check valve fills a chamber in milliseconds, leakage empties it in hours: p = load at rest."""
    load, gain, leakage, opening = 0.5, 40.0, 1e-4, 0.003

    def valve(u):
        return np.sign(u) * gain * max(abs(u) - 0.06, 0.0)

    def passed(x, u):
        return leakage + 1e3 * (valve(u[0]) - x[2] > opening)

    def rate(x, u):
        left = valve(u[0]) - x[2]
        return [x[1], x[2] - load, leakage * left + 1e3 * max(left - opening, 0)]

    plant = Plant(
        rate,
        lambda x, u: [[0, 1, 0], [0, 0, 1], [0, 0, -passed(x, u)]],
        lambda x, u: [[0], [0], [passed(x, u) * gain * (abs(u[0]) > 0.06)]],
        x=[0, 0, 1.3], u=[0], names=NAMES,
    )  # fmt: skip
    find_steady_state(plant)
    np.testing.assert_allclose([plant.x[2], plant.u[0]], [load, 0.06 + load / gain], rtol=1e-8)  # as above


# ---- notes


@pytest.mark.parametrize(
    ("a", "told"),
    [
        ([[-1, 0], [-1, -2.4e-13]], ""),  # each row divided by its sum: singular values as 1 to 1.2e-13
        ([[-1, 0], [-1, -1.6e-13]], "one value is"),  # as 1 to 0.8e-13
        (-np.ones((3, 3)), "2 values are"),
    ],
)
def test_values_that_nothing_determines_are_counted(a, told):
    """Equations that are equal to 1e-13 count as one."""
    notes, _ = find_steady_state(Plant(lambda x, u: 0 * x, a, x=np.zeros(len(a))))
    more = [f"{told} not unique, such as a command in its dead band"] if told else []
    assert notes == ("no joint is held: all states are unknowns", *more)


@pytest.mark.parametrize("requested", [0, 1])
def test_a_requested_input_holds_the_joint(requested):
    """Of two inputs it is the one asked for; one that nobody asked for is told, below 1e-12 as zero."""
    every = slice(None, 1 + requested)
    plant = Plant(
        lambda x, u: [x[1], u[0] - 4e-13], [[0, 1], [0, 0]], [[0, 0][every], [1, 0][every]], x=[0, 0],
        u=[4e-13, 0][every], requested=requested,
        names=["boom_angle", "boom_speed", *["boom_command", "boom_lever"][every]],
    )  # fmt: skip
    told = [] if requested else ["constant inputs of the steady state: boom_command = 0 V"]
    assert find_steady_state(plant)[0] == ("joints held at their angles: m.boom_angle", *told)
