"""The search of a steady state on plants of a few lines: limits at their values, steps by hand, notes."""

# ruff: noqa: ARG005  (rates and matrices take x and u, whatever a plant uses of them)

from types import SimpleNamespace

import numpy as np
import pytest
from kit.mistakes import problem

from orchestrator import Problem
from orchestrator.base.units import DeclaredUnit, parse_unit
from orchestrator.engine.plant import Matrices
from orchestrator.linear.steady_state import HeldJoint, Search, SteadyEquations, find_steady_state
from orchestrator.ssp.system import Inlet, Port

UNITS = {n: DeclaredUnit(n, parse_unit(n).exponents) for n in ("rad", "rad/s", "Pa", "V")}
NAMES = {"boom_angle": "rad", "boom_speed": "rad/s", "boom_pressure": "Pa", "boom_command": "V"}
JOINT = HeldJoint("boom", 0, 1, 0)


class Plant:
    """dx/dt = f(x, u) with matrices A and B, numbers or functions of (x, u).

    size, requested   nominal value of inputs, and the number of those that were asked for
    refused           number of evaluations that fail, the first ones
    seen, asked       the points of all evaluations, and how often matrices were asked for
    """

    def __init__(self, f, a, b=None, *, x, u=(), nominal=None, names=(), size=None, requested=0, refused=0):
        self.rate, self.parts, self.size = f, (a, np.zeros((len(x), len(u))) if b is None else b), size
        self.x, self.u, self.nominal = (np.array(v, float) for v in (x, u, nominal or np.ones(len(x))))
        self.refused, self.seen, self.asked = refused, [], 0
        ports = [
            Port("m", n) for n in names or [*(f"x{k}" for k in range(len(x))), *["boom_command"][: len(u)]]
        ]
        self.states, inputs = ports[: len(x)], ports[len(x) :]
        inlets = [Inlet(p.variable, UNITS["V"], ((p, None),)) for p in inputs]
        self.cut, self.system = SimpleNamespace(inputs=inlets, requested_count=requested), self
        self.f = np.array(f(self.x, self.u), float)

    def variable(self, port):
        return SimpleNamespace(nominal=self.size, unit=UNITS.get(NAMES.get(port.variable)))

    def settle(self, x, u):
        self.seen.append((x.copy(), u.copy()))
        if len(self.seen) <= self.refused:
            raise Problem("out of range")
        self.x, self.u, self.f = x.copy(), u.copy(), np.array(self.rate(x, u), float)

    def matrices(self):
        self.asked += 1
        parts = (np.array(m(self.x, self.u) if callable(m) else m, float) for m in self.parts)
        return Matrices(*parts, None, None)


def equations(plant, *joints):
    return SteadyEquations(plant, joints, ())


# ---- Newton's method


@pytest.mark.parametrize(("level", "steady"), [(0.99, True), (1.0, True), (1.01, False)])
def test_a_rate_that_noise_keeps_is_steady_up_to_1e_11_of_its_terms(level, steady):
    """Terms of 1/4 from the state and 1/4 from its nominal value: up to 0.5e-11 is noise."""
    assert equations(Plant(lambda x, u: [level * 0.5e-11], [[-0.25]], x=[1])).solve() == steady


@pytest.mark.parametrize(("start", "solved"), [(0.99, True), (1.01, False)])
def test_newtons_method_has_forty_iterations(start, solved):
    """On -x^3 each removes a third; its terms are 6 x^2 with nominal 1, so x = 6e-11 is steady."""
    x = start * 6e-11 * 1.5**39  # the last iteration tests what 39 steps have left
    plant = Plant(lambda x, u: -(x**3), lambda x, u: [-3 * x**2], x=[x])
    assert equations(plant).solve() == solved
    assert solved or plant.x == x  # left as it was found


@pytest.mark.parametrize(("refused", "solved"), [(7, True), (8, False)])
def test_a_step_is_halved_seven_times(refused, solved):
    """A plant that cannot be evaluated at first: the attempts are 1, 1/2 ... 1/128 of the way."""
    plant = Plant(lambda x, u: -x, [[-1]], x=[1], refused=refused)
    assert equations(plant).solve() == solved
    np.testing.assert_allclose([x[0] for x, _ in plant.seen[:8]], 1 - 0.5 ** np.arange(8), atol=1e-15)
    assert plant.x[0] == pytest.approx(0.0 if solved else 1.0, abs=1e-15)  # rounding, as above


@pytest.mark.parametrize(("ratio", "attempt"), [(0.75, 1), (0.76, 2), (0.875, 2), (0.88, 3)])
def test_a_step_has_to_shorten_the_next_one(ratio, attempt):
    """By a quarter for the whole step, an eighth for half of it: powers of 2, so the limits are exact."""
    one = Plant(lambda x, u: [2.0 if x[0] == 1 else 2 * ratio], [[-1]], x=[1])
    r = 2 * 0.999 * ratio  # matrices 2 x 2: rounding
    two = Plant(lambda x, u: [2, 0] if x[0] == 1 else [r, r], [[-1, -1], [0, -1]], x=[1, 1])  # (2, 0), (0, r)
    for plant in (one, two):
        assert not equations(plant).solve()  # beyond the first step rates stay: eight attempts, then back
        assert len(plant.seen) == attempt + 8 + 1


@pytest.mark.parametrize(("x", "end"), [(0.8e-14, 0.8e-14), (1e-14, 1e-14), (1.2e-14, 0.0)])
def test_a_step_up_to_1e_14_of_nominal_is_not_taken(x, end):
    """After convergence one more step is taken, if it is longer."""
    plant = Plant(lambda x, u: -x, [[-1]], x=[x])
    assert equations(plant).solve()
    assert plant.x[0] == end


def test_rows_and_columns_are_scaled_by_what_is_added():
    """Row 2: terms 2 and 40 of x, 40 and 6 of changes by nominal values; a row of zeros stays."""
    rates, names = [0, 1, 50], ("x0", "x1", "boom_speed", "boom_command")
    a, b = [[0, 0, 0], [0, 0, 0], [-1, 4, 0]], [[0], [0], [3]]
    plant = Plant(lambda x, u: rates, a, b, x=[2, -0.5, 0], u=[0], nominal=[1, 10, 1], names=names, size=2.0)
    found = equations(plant, HeldJoint("boom", 0, 2, 0))
    matrix, scale = found.matrix()
    np.testing.assert_array_equal(scale, [1, 2 + 40 + 40 + 6])
    np.testing.assert_allclose(matrix, [[0, 0], [40 / 88, 6 / 88]], rtol=1e-15)  # quotients
    assert found.worst() == "m.boom_speed"  # 50 times its nominal value per second; m.x1: a tenth
    plant.size = None  # without a nominal value of the input: 1
    np.testing.assert_array_equal(equations(plant, HeldJoint("boom", 0, 2, 0)).nominal, [10, 1])


# ---- the transient


@pytest.mark.parametrize(
    ("ratio", "factor"), [(0.04, 5.0), (0.06, 1.5), (0.24, 1.5), (0.26, 0.8), (0.49, 0.8), (0.51, 0.25)]
)
def test_steps_grow_on_straight_paths_and_are_repeated_on_bent_ones(ratio, factor):
    """The rate changes by `ratio` in the first step, of 0.1 ms; above 0.5 the step is repeated."""
    plant = Plant(lambda x, u: [3.0 if x[0] == 1 else 3 * (1 + ratio)], [[0]], x=[1], nominal=[4])
    assert not Search(plant, (), ()).run({})
    start, first, *then = (x[0] for x, _ in plant.seen[:4])
    assert (then[0] == start) == (ratio > 0.5)
    second = then[1] - start if ratio > 0.5 else (then[0] - first) / (1 + ratio)
    np.testing.assert_allclose([first - start, second], [3e-4, 3e-4 * factor], rtol=1e-9)  # of 1 + 3e-4


def test_a_search_ends_after_3000_steps():
    """A plant that cannot be evaluated: its matrices are asked for at first and after each step taken."""
    plant = Plant(lambda x, u: [1], [[0]], x=[1], refused=10**6)
    assert not Search(plant, (), ()).run({})
    assert plant.asked == 1 + 3000 - 9  # nine shorten the step to 1e-9 s; below, it is taken as it is


def test_joints_reach_their_speeds_in_half_a_second():
    """Nothing bends: steps from 0.1 ms, each five times the last, until one is longer than 10 s."""
    plant = Plant(lambda x, u: [x[1], u[0]], [[0, 1], [0, 0]], [[0], [1]], x=[0.3, 0], u=[0])
    assert Search(plant, [JOINT], ()).run({"boom": 2.0})
    speeds = [x[1] for x, _ in plant.seen if x[1]]
    times = 1e-4 * (5.0 ** np.arange(1, 10) - 1) / 4
    np.testing.assert_allclose(speeds[:9], 2 * np.minimum(times / 0.5, 1), rtol=1e-12)  # rounding
    assert plant.x.tolist() == [0.3, 2.0]


@pytest.mark.parametrize(("side", "speed"), [(1.0, 0.0), (-1.0, 0.0), (1.0, 2.0)])
def test_an_input_acts_against_acceleration_and_jerk(side, speed):
    """u' = -k (a + T a') with p' = g u, a = p - load, by one implicit Euler step: two equations, by hand."""
    gain, load, p, u, nominal, size = side * 3.0, 1.5, 0.5, 0.25, 2.0, 4.0
    a = np.zeros((4, 4))
    a[0, 1] = a[1, 2] = 1
    plant = Plant(
        lambda x, u: [x[1], x[2] - load, gain * u[0], 1],  # the last never rests: no end
        a, [[0], [0], [gain], [0]], x=[0, 0, p, 0], u=[u], nominal=[1, 1, nominal, 1], size=size,
    )  # fmt: skip
    assert not Search(plant, [JOINT], ()).run({"boom": speed})
    starts = [k for k, (x, v) in enumerate(plant.seen) if x.tolist() == [0, 0, p, 0] and v[0] == u]
    h, jerk, full = 1e-4, 0.005, 2 * nominal  # full acceleration: of p and of a change by its nominal value
    lags = (0.005, 0.05, 0.1, 10.0, *(() if speed else (1e3, 1e4)))  # longer ones for a joint at rest, too
    for k, lag in zip(starts, lags, strict=True):
        push = side * size / lag / full * h
        wanted = -push * (p - load + (jerk + h) * gain * u) / (1 + push * gain * (jerk + h))
        change = plant.seen[k + 1][1][0] - u
        assert change == pytest.approx(wanted, rel=1e-9, abs=1e-16)  # a difference of 0.25


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
        problem(lambda: find_steady_state(plant), r"found with m\.boom_speed = 0: m\.boom_speed still")
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
