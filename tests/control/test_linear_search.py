"""The search of a steady state on plants of a few lines: limits at their values, steps by hand, notes."""

# ruff: noqa: ARG005  (rates and matrices take x and u, whatever a plant uses of them)

from types import SimpleNamespace

import numpy as np
import pytest

from orchestrator import Problem
from orchestrator.base.units import DeclaredUnit, parse_unit
from orchestrator.linear.steady_state import HeldJoint, Search, SteadyEquations, find_steady_state
from orchestrator.monolithic.plant import Matrices
from orchestrator.ssp.system import Inlet, Port

UNITS = {"angle": "rad", "speed": "rad/s", "pressure": "Pa", "command": "V"}
JOINT = HeldJoint("boom", 0, 1, 0)


class EnoughError(Exception):
    """Ends a search that has been seen long enough."""


class Plant:
    """dx/dt = f(x, u) with matrices A and B, numbers or functions of (x, u).

    sizes     nominal values of inputs
    refused   number of evaluations that fail, the first ones
    most      number of evaluations after which the test ends
    seen      the points of all evaluations; asked: how often for its matrices
    """

    def __init__(
        self, f, a, b=None, x=(1.0,), u=(), nominal=None, names=None, requested=0, refused=0, most=0
    ):
        self.rate, self.x, self.u, self.sizes = f, np.array(x, float), np.array(u, float), {}
        self.nominal = np.ones(len(x)) if nominal is None else np.array(nominal, float)
        self.of_x, self.of_u = (m if callable(m) else lambda x, u, m=m: m for m in (a, b))
        self.refused, self.most, self.seen, self.asked = refused, most, [], 0
        names = names or [f"x{k}" for k in range(len(x))] + ["boom_command"]
        ports = [Port("m", n) for n in names]
        self.states, inputs = ports[: len(x)], ports[len(x) : len(x) + len(u)]
        inlets = [Inlet(p.variable, self.unit(p), ((p, None),)) for p in inputs]
        self.cut = SimpleNamespace(inputs=inlets, requested_count=requested)
        self.system = SimpleNamespace(variable=self.variable)
        self.f = np.array(f(self.x, self.u), float)

    def unit(self, port):
        text = UNITS.get(port.variable.rpartition("_")[2])
        return text and DeclaredUnit(text, parse_unit(text).exponents)

    def variable(self, port):
        return SimpleNamespace(nominal=self.sizes.get(port.variable), unit=self.unit(port))

    def settle(self, x, u):
        self.seen.append((x.copy(), u.copy()))
        if len(self.seen) == self.most:
            raise EnoughError
        if len(self.seen) <= self.refused:
            raise Problem("out of range")
        self.x, self.u = x.copy(), u.copy()
        self.f = np.array(self.rate(self.x, self.u), float)

    def matrices(self):
        self.asked += 1
        n, m = len(self.x), len(self.u)
        a, b = (np.array(self.of_x(self.x, self.u), float), self.of_u(self.x, self.u))
        return Matrices(a.reshape(n, n), np.zeros((n, m)) if b is None else np.array(b, float), None, None)


def equations(plant, joints=()):
    return SteadyEquations(plant, joints, ())


# ---- Newton's method


@pytest.mark.parametrize(("level", "steady"), [(0.99, True), (1.0, True), (1.01, False)])
def test_a_rate_that_noise_keeps_is_steady_up_to_1e_11_of_its_terms(level, steady):
    """Terms of 1/4 from the state and 1/4 from its nominal value: noise up to 0.5e-11 counts as nothing."""
    assert equations(Plant(lambda x, u: [level * 0.5e-11], [[-0.25]])).solve() == steady


@pytest.mark.parametrize(("start", "solved"), [(0.99, True), (1.01, False)])
def test_newtons_method_has_forty_iterations(start, solved):
    """On -x^3 each removes a third; its terms are 6 x^2 with nominal 1, so x = 6e-11 is steady."""
    x = start * 6e-11 * 1.5**39  # what 39 steps before the last test of convergence reduce to 6e-11
    plant = Plant(lambda x, u: -(x**3), lambda x, u: [-3 * x**2], x=[x])
    assert equations(plant).solve() == solved
    assert solved or plant.x == x  # left as it was found


@pytest.mark.parametrize(("refused", "solved"), [(7, True), (8, False)])
def test_a_step_is_halved_seven_times(refused, solved):
    """A plant that cannot be evaluated at first: the attempts are 1, 1/2 ... 1/128 of the way."""
    plant = Plant(lambda x, u: -x, [[-1.0]], refused=refused)
    assert equations(plant).solve() == solved
    np.testing.assert_allclose([x[0] for x, _ in plant.seen[:8]], 1.0 - 0.5 ** np.arange(8), atol=1e-15)
    assert plant.x[0] == pytest.approx(0.0 if solved else 1.0, abs=1e-15)  # rounding


@pytest.mark.parametrize(("ratio", "attempt"), [(0.75, 1), (0.76, 2), (0.875, 2), (0.88, 3)])
def test_a_step_has_to_shorten_the_next_one(ratio, attempt):
    """By a quarter for the whole step, an eighth for half of it: powers of 2, so the limits are exact."""
    plant = Plant(lambda x, u: [2.0 if x[0] == 1.0 else 2.0 * ratio], [[-1.0]])
    assert not equations(plant).solve()  # beyond the first step the rate stays: eight attempts, then back
    assert len(plant.seen) == attempt + 8 + 1


@pytest.mark.parametrize(("x", "end"), [(0.8e-14, 0.8e-14), (1e-14, 1e-14), (1.2e-14, 0.0)])
def test_a_step_below_1e_14_of_nominal_is_not_taken(x, end):
    """Where the rate is nothing but rounding, one step more is taken if it is longer."""
    plant = Plant(lambda x, u: -x, [[-1.0]], x=[x])
    assert equations(plant).solve()
    assert plant.x[0] == end


@pytest.mark.parametrize(("slope", "free"), [(1.6e-13, 1), (2.4e-13, 0)])
def test_nearly_equal_equations_leave_a_direction_free(slope, free):
    """Rows (1, 0) and (1, s), each divided by its sums 2 and 2 + 2 s: singular values as 1 to s / 2."""
    plant = Plant(lambda x, u: [0.0, 0.0], [[-1.0, 0.0], [-1.0, -slope]], x=(0.0, 0.0))
    found = equations(plant)
    assert found.solve()
    assert found.free == free  # below and above 1e-13


def test_rows_and_columns_are_scaled_by_what_is_added():
    """Row 1: terms 2 and 40 of x, 1, 40 and 6 of a change by nominal values; a row of zeros stays."""
    names = ("x0", "x1", "boom_speed", "boom_command")
    plant = Plant(
        lambda x, u: [0.0, 1.0, 50.0], [[0, 0, 0], [0, 0, 0], [-1, 4, 0]], [[0], [0], [3]],
        x=(2.0, -0.5, 0.0), u=[0.0], nominal=(1, 10, 1), names=names,
    )  # fmt: skip
    plant.sizes["boom_command"] = 2.0
    found = equations(plant, [HeldJoint("boom", 0, 2, 0)])
    matrix, scale = found.matrix()
    np.testing.assert_allclose(scale, [1.0, 2 + 40 + 40 + 6], rtol=1e-15)  # small whole numbers
    np.testing.assert_allclose(matrix, [[0, 0], [40 / 88, 6 / 88]], rtol=1e-15)
    assert found.worst() == "m.x1"  # 1 of 1, not 50 of 88
    plant.sizes.clear()
    np.testing.assert_array_equal(equations(plant, [JOINT]).nominal, [1.0, 1.0])  # none declared: 1


# ---- the transient


@pytest.mark.parametrize(
    ("ratio", "factor"), [(0.04, 5.0), (0.06, 1.5), (0.24, 1.5), (0.26, 0.8), (0.49, 0.8), (0.51, 0.25)]
)
def test_steps_grow_on_straight_paths_and_are_repeated_on_bent_ones(ratio, factor):
    """The rate changes by `ratio` in the first step, of 0.1 ms; above 0.5 the step is repeated."""
    plant = Plant(lambda x, u: [3.0 if x[0] == 1.0 else 3.0 * (1 + ratio)], [[0.0]], nominal=[4.0], most=4)
    with pytest.raises(EnoughError):
        Search(plant, (), ()).run({})
    x = [x[0] for x, _ in plant.seen]
    assert (x[2] == x[0]) == (ratio > 0.5)
    first, then = (
        (x[1] - x[0]) / 3.0,
        (x[3] - x[2]) / 3.0 if ratio > 0.5 else (x[2] - x[1]) / 3.0 / (1 + ratio),
    )
    np.testing.assert_allclose((first, then), (1e-4, 1e-4 * factor), rtol=1e-9)  # differences of 1 + 1e-4


def test_a_search_ends_after_600_steps_with_each_of_three_lags():
    """A plant that cannot be evaluated: its matrices are asked for once in each step."""
    plant = Plant(lambda x, u: [1.0], [[0.0]], refused=10**6)
    assert not Search(plant, (), ()).run({})
    assert plant.asked == 3 * 600


def test_joints_reach_their_speeds_in_half_a_second():
    """Nothing bends: steps from 0.1 ms, each five times the last, until one is longer than 10 s."""
    plant = Plant(lambda x, u: [x[1], u[0]], [[0, 1], [0, 0]], [[0], [1]], x=(0.3, 0.0), u=[0.0])
    search = Search(plant, [JOINT], ())
    assert search.run({"boom": 2.0})
    speeds = [x[1] for x, _ in plant.seen if x[1]]
    times = 1e-4 * (5.0 ** np.arange(1, 10) - 1) / 4
    np.testing.assert_allclose(speeds[:9], 2.0 * np.minimum(times / 0.5, 1.0), rtol=1e-12)  # rounding
    assert plant.x.tolist() == [0.3, 2.0]


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_an_input_acts_against_acceleration_and_jerk(side):
    """u' = -k (a + T a') with p' = g u, a = p - load, by one implicit Euler step: two equations, by hand."""
    gain, load, p, u, nominal, size = side * 3.0, 1.5, 0.5, 0.25, 2.0, 4.0
    plant = Plant(
        lambda x, u: [x[1], x[2] - load, gain * u[0], 1.0],  # the last never rests: no end
        [[0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 0], [0, 0, 0, 0]], [[0], [0], [gain], [0]],
        x=(0.0, 0.0, p, 0.0), u=[u], nominal=(1, 1, nominal, 1),
    )  # fmt: skip
    plant.sizes["boom_command"] = size
    assert not Search(plant, [JOINT], ()).run({})
    start = [k for k, (x, v) in enumerate(plant.seen) if x.tolist() == [0, 0, p, 0] and v[0] == u]
    h, jerk, acceleration = 1e-4, 0.005, p - load
    full = 2 * nominal  # the sum of the terms: p and a change by its nominal value
    for k, lag in zip(start, (0.005, 0.02, 0.1), strict=True):
        push = side * size / lag / full * h
        wanted = -push * (acceleration + (jerk + h) * gain * u) / (1 + push * gain * (jerk + h))
        assert plant.seen[k + 1][1][0] - u == pytest.approx(wanted, rel=1e-9)  # a difference of 0.25


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize("load", [0.5, -0.5])
def test_a_command_leaves_its_dead_band_to_the_side_that_holds_the_load(side, load):
    """p' = g dz(u) - p with a dead band of 0.2, a = p - load: steady at u = load/g + 0.2 on that side."""

    def opening(u):
        return np.sign(u) * max(abs(u) - 0.2, 0.0)

    gain = 2.0 * side
    plant = Plant(
        lambda x, u: [x[1], x[2] - load, gain * opening(u[0]) - x[2]],
        [[0, 1, 0], [0, 0, 1], [0, 0, -1]],
        lambda x, u: [[0], [0], [gain * (abs(u[0]) > 0.2)]],
        x=(0.0, 0.0, 0.0), u=[0.0], names=("boom_angle", "boom_speed", "boom_pressure", "boom_command"),
    )  # fmt: skip
    notes = find_steady_state(plant)
    u = load / gain + np.copysign(0.2, load / gain)
    assert plant.u[0] == pytest.approx(u, rel=1e-10)  # Newton's method stops at 1e-11 of the terms
    np.testing.assert_allclose(plant.x, [0.0, 0.0, load], atol=1e-10)
    assert notes[1] == f"constant inputs of the steady state: boom_command = {u:g} V"


# ---- notes


@pytest.mark.parametrize(("count", "told"), [(1, ""), (2, "one value is"), (3, "2 values are")])
def test_values_that_nothing_determines_are_counted(count, told):
    """Lags that see only their sum: all but one are free."""
    plant = Plant(lambda x, u: -np.full(count, x.sum()), -np.ones((count, count)), x=np.zeros(count))
    notes = ["no joint is held: all states are unknowns"]
    notes += [f"{told} not unique, such as a command in its dead band"] if told else []
    assert find_steady_state(plant) == tuple(notes)


@pytest.mark.parametrize("requested", [0, 1])
def test_a_requested_input_holds_the_joint(requested):
    """Of two inputs it is the one asked for; one that nobody asked for is told, below 1e-12 as zero."""
    every = slice(None, 1 + requested)
    plant = Plant(
        lambda x, u: [x[1], u[0] - 4e-13], [[0, 1], [0, 0]], [[0, 0][every], [1, 0][every]],
        x=(0.0, 0.0), u=[4e-13, 0.0][every], requested=requested,
        names=("boom_angle", "boom_speed", "boom_command", "boom_lever"),
    )  # fmt: skip
    notes = ["joints held at their angles: m.boom_angle"]
    notes += [] if requested else ["constant inputs of the steady state: boom_command = 0 V"]
    assert find_steady_state(plant) == tuple(notes)
