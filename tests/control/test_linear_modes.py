"""Names of modes, eigenvalues near the limits of rounding, and the text, of matrices written by hand."""

import math
from dataclasses import replace

import numpy as np
import pytest
from kit.mistakes import entry

from orchestrator.base.units import DeclaredUnit, parse_unit
from orchestrator.linear.model import LinearModel
from orchestrator.linear.modes import LinearVariable, eigen, mode_name, modes, quantity_kind

DECLARED = ("1", "N", "m", "m/s", "Pa", "m3/s", "m3", "rad")
UNITS = {n: DeclaredUnit(n, parse_unit(n).exponents) for n in DECLARED}
LEFT, GROWS, SWINGS = -1.0, 0.5, -1 + 2j


def variable(name, unit="1", nominal=1.0):
    """A state, input or output."""
    return LinearVariable(name, UNITS[unit], "", nominal)


def linear(a, states, f0, u0=(), inputs=()):
    """A linear model without outputs."""
    n, m = len(states), len(u0)
    b, c, d, x0, y0 = map(np.zeros, ((n, m), (0, n), (0, m), n, 0))
    given = (np.array(v, float) for v in (u0, y0, f0))
    return LinearModel("demo", states, inputs, (), np.array(a, float), b, c, d, x0, *given)


KIND_OF = {
    **dict.fromkeys(("m", "rad", "deg"), "position"),
    **dict.fromkeys(("m/s", "rad/s", "rpm"), "speed"),
    **{"Pa": "pressure", "bar": "pressure", "m3/s": "flow", "L/min": "flow", "m3": "volume", "L": "volume"},
}
NOTHING = ("1", "kg", "N", "V", "kg/s", "m/s2", "rad/s2", "m2", "1/s", "A.m", "A.rad", "rad2", "N.rad", "m.s")


def test_a_unit_tells_the_quantity():
    """Lengths and angles, their rates, pressures, flows and volumes; of other units nothing is known."""
    every = [*KIND_OF, *NOTHING]
    found = {n: quantity_kind(DeclaredUnit(n, parse_unit(n).exponents)) for n in every}
    assert found == dict.fromkeys(every, "") | KIND_OF
    assert quantity_kind(DeclaredUnit("furlong")) == quantity_kind(None) == ""


@pytest.mark.parametrize(
    ("shares", "count"),
    [
        ((0.5, 0.3, 0.2), 2),  # 80 % is reached
        ((0.5, 0.29, 0.21), 3),
        ((0.2, 0.18, 0.17, 0.16, 0.15, 0.14), 4),  # 80 % would need five
        ((0.7, 0.05, 0.04, 0.039, 0.038, 0.033), 3),  # the fourth has less than 4 %
        ((0.035, 0.034, *[0.03] * 31), 1),  # none has 4 %
    ],
)
def test_main_states_are_the_fewest_with_80_percent(shares, count):
    """At most four, each but the first with at least 4 %, the largest first, in whatever order they come."""
    names = [f"x{k}_a" for k in range(len(shares))]
    for order in (slice(None), slice(None, None, -1)):
        main = mode_name(LEFT, np.array(shares)[order], names[order], [None] * len(names))[1]
        assert main == tuple(names[:count])


@pytest.mark.parametrize(
    ("value", "states", "name"),
    [
        (0.0, "swing_angle rad 100", "integrator of swing"),
        (GROWS, "swing_angle rad 100", "divergence of swing"),
        (GROWS + 1j, "swing_angle rad 100", "growing oscillation of swing"),
        (2j, "swing_angle rad 100", "oscillation of swing"),  # undamped, but it does not grow
        (SWINGS, "boom_speed m/s 88, boom_rod_pressure Pa 12", "hydraulic oscillation of boom"),
        (SWINGS, "boom_speed m/s 89, boom_rod_pressure Pa 11", "oscillation of boom"),
        (SWINGS, "boom_speed m/s 88, boom_a m3/s 6, boom_b m3/s 6", "hydraulic oscillation of boom"),
        (SWINGS, "boom_rod_pressure Pa 50, boom_rod_flow m3/s 50", "oil oscillation of boom rod"),
        (SWINGS, "lag_a 1 100", "oscillation of lag a"),
        (LEFT, "boom_angle rad 100", "position decay of boom"),
        (LEFT, "boom_angle rad 50, boom_speed m/s 50", "speed decay of boom"),
        (LEFT, "boom_angle rad 50, boom_flow m3/s 50", "overdamped hydraulic motion of boom"),
        (LEFT, "boom_flow m3/s 100", "flow decay of boom"),
        (LEFT, "boom_flow m3/s 50, boom_pressure Pa 50", "pressure decay of boom"),
        (LEFT, "lag.x 1 100", "decay of lag x"),
        (LEFT, "speed 1 50, flow 1 50", "decay of speed and flow"),
        (LEFT, "boom_x 1 50, stick_x 1 50", "decay of boom and stick"),
        (LEFT, "a_x 1 28, b_x 1 24, b_y 1 24, c_x 1 24", "decay of b and a"),
    ],
)  # fmt: skip
def test_a_mode_is_named_by_its_states(value, states, name):
    """The eigenvalue and quantities with at least 12 % give the kind, words of the names give the part."""
    names, units, percents = zip(*map(str.split, states.split(", ")), strict=True)
    shares = np.array(percents, float) / 100
    assert mode_name(value, shares, names, [UNITS[u] for u in units])[0] == name


@pytest.mark.parametrize(
    ("a", "wanted"),
    [
        (np.diag([4.0, 4.8e-18]), [4.8e-18, 4.0]),  # 1.2e-18 of the norm
        (np.diag([4.0, 4e-18]), [0.0, 4.0]),
        (np.diag([1e3, 0.8e-15]), [0.0, 1e3]),
        ([[-1e3, 1.2e-9], [-1.2e-9, -1e3]], [-1e3 - 1.2e-9j, -1e3 + 1.2e-9j]),  # 1.2e-12 of the magnitude
        ([[-1.0, 1e-12], [-1e-12, -1.0]], [-1.0, -1.0]),
        ([[-1e3, 0.8e-9], [-0.8e-9, -1e3]], [-1e3, -1e3]),
    ],
)
def test_small_eigenvalues_are_zero_and_small_imaginary_parts_too(a, wanted):
    """Up to 1e-18 of the norm is zero, up to 1e-12 of the magnitude is real; above, neither is."""
    found = np.sort_complex(eigen(np.array(a), np.ones(2))[0])
    np.testing.assert_array_equal(found == 0.0, np.array(wanted) == 0.0)
    np.testing.assert_array_equal(found.imag == 0.0, np.imag(wanted) == 0.0)
    np.testing.assert_allclose(found, wanted, rtol=1e-15)  # 2 x 2: rounding


def test_modes_have_frequency_damping_and_time_constant():
    """-3 +- 4i, 0.1 +- 0.5i, 0, -2 and twice -8: oscillations first, each slowest first."""
    blocks = [[-3, 4], [-4, -3]], [[0.1, 0.5], [-0.5, 0.1]], [[0]], [[-2]], [[-8]], [[-8]]
    a, k = np.zeros((8, 8)), 0
    for block in blocks:
        a[k : k + len(block), k : k + len(block)], k = block, k + len(block)
    found = modes(a, [variable(f"lag.x{k}", nominal=10.0**k) for k in range(8)])
    told = [(m.frequency * 2 * math.pi, m.damping, m.time_constant) for m in found]
    slow = math.sqrt(0.26)
    wanted = [(slow, -0.1 / slow, -10.0), (5.0, 0.6, 1 / 3), (0.0, 0.0, math.inf), (0.0, 1.0, 0.5)]
    np.testing.assert_allclose(told, [*wanted, (0.0, 1.0, 1 / 8), (0.0, 1.0, 1 / 8)], rtol=1e-14)  # rounding
    np.testing.assert_allclose(found[1].participation, [0.5, 0.5, *np.zeros(6)], atol=1e-15)  # of a rotation
    assert [m.name for m in found[3:]] == [f"decay of x{k}" for k in (5, 6, 7)]
    assert modes(np.zeros((0, 0)), ()) == ()


def test_equal_names_are_numbered_and_equal_variables_have_their_component():
    """Two modes of a lag, and two states x, which keep their component."""
    names = ("a.lag_speed", "b.lag_flow", "a.x", "b.x")
    found = modes(np.diag([-1.0, -2.0, -3.0, -4.0]), [variable(n) for n in names])
    assert [m.name for m in found] == [f"decay of {n}" for n in ("lag (1)", "lag (2)", "a x", "b x")]
    assert [m.main_states[0] for m in found] == ["lag_speed", "lag_flow", "a.x", "b.x"]


TEXT = entry(__file__, "text")


def test_the_text_has_inputs_rates_and_modes():
    """-3 +- 4i is 5/2 pi Hz with the damping 3/5; numbers stand right in the table, words left."""
    units = {"arm.boom_position": "m", "arm.boom_speed": "m/s", "oil.pump_pressure": "Pa"}
    states = [variable(n, unit, 1e5 if unit == "Pa" else 1.0) for n, unit in units.items()]
    inputs = variable("arm.force", "N"), variable("gain")
    a = [[0, 1, 0], [-25, -6, 0], [0, 0, -2]]
    model = linear(a, states, (0.0, 0.0, 5e3), (2.5, 0.125), inputs)
    assert model.text() == TEXT
    assert repr(model).splitlines() == [*TEXT.splitlines()[:4], "print(model.text())"]
    for length in (120, 121):  # a longer line is cut at a blank
        name = (length - len(TEXT.splitlines()[0]) + len("demo")) * "x"
        first = repr(replace(model, name=name)).splitlines()[0]
        assert first.endswith("0 outputs" if length == 120 else "0 ...")


@pytest.mark.parametrize(
    ("slope", "rate", "told"),
    [
        *[(0.0, 1e-4, ""), (0.0, -1.2e-4, "-0.00024")],  # of a state with the nominal value 2
        *[(-1000.0, 5.0, "10"), (-1200.0, 5.0, ""), (1200.0, 5.0, "10")],  # T of 1 ms, and below
        *[(-2000.0, 20.0, ""), (-2000.0, 20.1, "40.2")],  # 1 % on the way, and more
        (-0.5, 0.004, "0.008"),  # little on the way, but in 2 s
    ],
)
def test_a_point_is_steady_up_to_a_rate_of_1e_4(slope, rate, told):
    """A rate up to 1e-4 of nominal in 1 s is steady, and one that ends within 1 ms and 1 % of nominal."""
    text = linear([[slope]], [variable("x", "m", 2.0)], [2.0 * rate]).text().splitlines()[2]
    assert text == (f"not a steady state: x changes by {told} m per s" if told else "steady state")


def test_the_text_names_the_three_fastest_states_and_what_is_not_stable():
    """Rates count relative to nominal; values below 1e-12 of nominal are printed as 0."""
    sizes = {"a": 1.0, "b": 1e-3, "c": 1.0, "d": 10.0}
    states = [variable(n, "m", size) for n, size in sizes.items()]
    inputs = [variable(n, nominal=10.0) for n in ("u", "v")]
    model = linear(np.diag([0.5, 0.0, -1.0, -2.0]), states, (1, 1, 2, 3), (0.8e-11, 1.2e-11), inputs)
    assert model.text().splitlines()[1:4] == [
        "inputs: u = 0, v = 1.2e-11",
        "not a steady state: b changes by 1 m per s, c changes by 2 m per s, a changes by 1 m per s",
        "unstable: divergence of a; marginally stable: integrator of b",
    ]
    moving = replace(model, moving=("b",)).text().splitlines()[2]  # a speed that was asked for
    changes = "c changes by 2 m per s, a changes by 1 m per s, d changes by 3 m per s"
    assert moving == f"not a steady state: {changes}; b moves at 1 m per s"
