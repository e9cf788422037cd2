"""The published benchmark of a hydraulic manipulator: component, equations, coupled run."""

from __future__ import annotations

import sys
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fmus.components import orifice
from fmus.contract import quantities, symbolic, unstack
from fmus.monolith import join, simulate
from fmus.parameters import values
from orchestrator.validation import read_reference

ROOT = Path(__file__).parents[1]
EXAMPLE = ROOT / "examples" / "hydraulic_manipulator"
sys.path.insert(0, str(EXAMPLE))  # the example is a script, not an installed package

from arm import ARM  # noqa: E402
from hydraulics import HYDRAULICS, model  # noqa: E402
from machine import HOLDING, INPUTS, RATES, SIGNALS, SUBSYSTEMS  # noqa: E402

# ------------------------------------------------------------------ orifice

pressure_differences = st.floats(-4e7, 4e7)
transitions = st.floats(1.0, 1e5)


def flow(dp: float, transition: float) -> float:
    return float(orifice.flow(1e-4, dp, 850.0, 0.67, transition))


@given(pressure_differences, transitions)
def test_orifice_is_odd(dp, transition):
    """Exchanging both sides of an orifice turns the flow around, exactly."""
    assert flow(-dp, transition) == -flow(dp, transition)


@given(pressure_differences, pressure_differences, transitions)
def test_orifice_is_increasing(a, b, transition):
    """A larger pressure difference gives no smaller flow."""
    assert flow(min(a, b), transition) <= flow(max(a, b), transition)


@given(pressure_differences, transitions)
def test_orifice_never_creates_power(dp, transition):
    """Both forms of the orifice only turn pressure into heat."""
    one_way = float(orifice.one_way_flow(1e-4, dp, 850.0, 0.67, transition))
    assert orifice.loss(flow(dp, transition), dp) >= 0
    assert orifice.loss(one_way, dp) >= 0


@given(pressure_differences, transitions)
def test_one_way_orifice_is_closed_backwards(dp, transition):
    """The check valve passes the flow of the plain orifice forwards and exactly nothing backwards."""
    one_way = float(orifice.one_way_flow(1e-4, dp, 850.0, 0.67, transition))
    assert one_way == (flow(dp, transition) if dp > 0 else 0)


@given(st.floats(1.0, 1e6), transitions)
def test_orifice_strays_from_the_square_root_as_stated(ratio, transition):
    """The regular root lies below the square root by the share (dp_t / dp)^2 / 4 at most."""
    dp = ratio * transition
    share = 1 - float(orifice.regular_root(dp, transition)) / np.sqrt(dp)
    # rounding of the two roots: a few 1e-16
    assert -1e-15 <= share <= 1 / (4 * ratio**2) + 1e-15


def test_orifice_strays_one_percent_at_five_transition_pressures():
    """The number in the docstring: 1 % at 5 dp_t."""
    assert 1 - float(orifice.regular_root(5e3, 1e3)) / np.sqrt(5e3) == pytest.approx(0.01, rel=0.03)


def test_orifice_slope_at_zero_is_finite():
    """The derivative at zero is dp_t^(-1/2), where the square root's is infinite."""
    dp = ca.SX.sym("dp")
    slope = ca.Function("slope", [dp], [ca.gradient(orifice.regular_root(dp, 1e3), dp)])
    assert float(slope(0)) == pytest.approx(1e3**-0.5, rel=1e-14)  # exact but for rounding


# ---------------------------------------------------------------- equations


def parameters():
    return HYDRAULICS.parameters(**values(HYDRAULICS).p)


def at(seed):
    """A random state, input and the numbers of the hydraulics."""
    rng = np.random.default_rng(seed)
    p = parameters()
    x = HYDRAULICS.states(*rng.uniform(0.2e6, 7.5e6, 2))
    u = HYDRAULICS.inputs(rng.uniform(0, 1), rng.uniform(0.35, 0.65), rng.uniform(-0.3, 0.3), 0.0, 8829.0)
    return x, u, p


@pytest.mark.parametrize("seed", range(5))
def test_hydraulic_power_balance(seed):
    """Power from the supply = to the tank + heat + on the piston + into compression."""
    x, u, p = at(seed)
    dx, y = model.dynamics(x, u, p), model.observe(x, u, p)
    chambers = zip(vars(x).values(), model.volumes(u.s1, p), vars(dx).values(), strict=True)
    compression = sum(pi * vi / model.bulk_modulus(pi, p) * rate for pi, vi, rate in chambers)
    received = p.supply_pressure * y.supply_flow - p.tank_pressure * y.return_flow
    used = y.dissipated_power + y.force * u.s1_dot + compression
    assert float(received) == pytest.approx(float(used), rel=1e-12)  # exact identity: rounding only


@pytest.mark.parametrize("pressure", [0.1e6, 3e6, 7.6e6, 50e6])
def test_bulk_modulus_belongs_to_the_density(pressure):
    """beta = rho dp/drho of the density 1 + a p + b p^2, by central differences."""
    p = parameters()
    step = 1e4
    above, below = (model.relative_density(pressure + d, p) for d in (step, -step))
    expected = model.relative_density(pressure, p) * 2 * step / (above - below)
    # the central difference of a parabola is exact, its rounding is 1e-16 / (slope step) = 2e-11
    assert model.bulk_modulus(pressure, p) == pytest.approx(expected, rel=1e-10)


def test_published_equilibrium():
    """Holding force, pressures and valve position at the start are the published numbers."""
    v, p = values(ARM), parameters()
    _, outputs = symbolic(ARM).function()(*(list(group.values()) for group in (v.x, v.u, v.p)))
    arm = unstack(ARM.outputs, outputs.full()[:, 0])
    u = HYDRAULICS.inputs(0.45, arm.s1, arm.s1_dot, 0.0, arm.holding_force)
    pressures = model.initial(u, p)
    kappa = float(model.observe(HYDRAULICS.states(**pressures), u, p).holding_kappa)
    found = [arm.s1, arm.holding_force, *pressures.values(), kappa]
    # printed with eight digits
    np.testing.assert_allclose(found, [0.5, 8829, 3170846.2, 4529153.8, 0.45434559], rtol=2e-8)


def test_the_cut_has_no_feed_through():
    """The force depends on the pressures alone, length and velocity on the arm's state alone."""
    for sub, names in ((HYDRAULICS, ["force"]), (ARM, ["s1", "s1_dot", "holding_force"])):
        written, outputs = symbolic(sub), list(quantities(sub.outputs))
        for name in names:
            assert not ca.depends_on(written.y[outputs.index(name)], written.u), name


# ------------------------------------------------------------------ M1 as one ODE


@pytest.fixture(scope="module")
def reference():
    return read_reference(ROOT / "data/reference/hydraulic_manipulator/m1_reference.csv")


def test_monolith_follows_the_reference(reference):
    """The equations joined into one ODE give the authors' monolithic solution of M1."""
    manoeuvre = np.genfromtxt(EXAMPLE / "m1.csv", delimiter=",", names=True)
    time = np.unique(np.concatenate([reference.time, manoeuvre["time"]]))
    kappa = np.interp(time, manoeuvre["time"], manoeuvre["kappa"])[:, None]
    joined = join(SUBSYSTEMS, (*SIGNALS, *RATES, *HOLDING), INPUTS)
    _, outputs = simulate(joined, time, kappa)
    sampled = outputs[np.searchsorted(time, reference.time)]

    def error(name):
        found = sampled[:, joined.output_names.index(name)]
        return np.max(np.abs(found - reference.signals[name].values))

    # an independent Radau solution differs by 1.7e-6 m and 150 Pa: what the authors' step of 0.05 ms leaves
    assert error("arm.s1") < 2e-6
    assert error("hydraulics.p_1") < 150
    assert error("hydraulics.p_2") < 150
    # velocity and force: of the same size relative to their range, 0.08 m/s and 6 kN
    assert error("arm.s1_dot") < 1e-4
    assert error("arm.f_h") < 12
