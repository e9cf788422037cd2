"""Spool dynamics: second order for small motions, limits of speed and stroke, overlaps of the four edges."""

import math

import casadi as ca
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from kit.equations import OIL, VALVE, lines, number

from fmus.components import spool_valve
from fmus.components.spool_valve import Spool, SpoolState

W, Z, V_MAX = 2 * math.pi * 30.0, 0.707, 20.0


def moving(w, z, speed, overlaps=(0.06,) * 4) -> Spool:
    """A spool of angular frequency w."""
    names = ("overlap_pa", "overlap_at", "overlap_pb", "overlap_bt")
    edges = dict(zip(names, overlaps, strict=True))
    return Spool(frequency=w / (2 * math.pi), damping=z, speed=speed, **edges)


SPOOL = moving(W, Z, V_MAX)
UNEQUAL = moving(W, Z, V_MAX, (0.06, 0.1, 0.2, 0.3))
STEP = 2e-4  # s
ROUNDING = 0.04  # of the foot, as share of the stroke
anything = st.floats(-1.0, 1.0)
frequencies, dampings, fastest = st.floats(10.0, 1000.0), st.floats(0.2, 1.5), st.floats(1.0, 100.0)
_x, _v, _u, _w, _z, _m = (ca.SX.sym(n) for n in ("x", "v", "u", "w", "z", "m"))
_RATES = spool_valve.spool_rates(moving(_w, _z, _m), SpoolState(_x, _v), _u)
FIELD = ca.Function("field", [_x, _v, _u, _w, _z, _m], [_RATES.position, _RATES.speed])


def follow(command: float, count: int) -> np.ndarray:
    """Positions and speeds (count, 2) after each STEP from the centre on, with a command that holds."""
    ode = {"x": ca.vertcat(_x, _v), "ode": ca.vertcat(*FIELD(_x, _v, command, W, Z, V_MAX))}
    options = {"reltol": 1e-10, "abstol": 1e-10}
    solver = ca.integrator("spool", "cvodes", ode, 0.0, STEP * np.arange(1, count + 1), options)
    return solver(x0=[0.0, 0.0])["xf"].full().T


def test_small_step_is_the_closed_form_of_second_order():
    """A step of 5 % of the stroke: x = u (1 - e^(-z w t) (cos(w_d t) + z w/w_d sin(w_d t)))."""
    count, u = 400, 0.05
    time = np.arange(1, count + 1) * STEP
    damped = W * math.sqrt(1 - Z**2)
    ring = np.cos(damped * time) + Z * W / damped * np.sin(damped * time)
    expected = u * (1 - np.exp(-Z * W * time) * ring)
    found = follow(u, count)[:, 0]
    # the integrator's 1e-10 in each of some hundred steps
    assert found == pytest.approx(expected, abs=1e-7 * u)
    assert found.max() > 1.04 * u  # it overshoots, as a damping of 0.707 does


def test_full_step_takes_the_rate_limit():
    """From the centre to the full stroke: at v_max on the way, so 90 % after 0.9/v_max and the approach."""
    found = follow(1.0, 1000)
    assert found[:, 1].max() == pytest.approx(V_MAX, rel=1e-3)  # creeps up to the limit with 1/(2 z w)
    late = (np.argmax(found[:, 0] > 0.9) + 1) * STEP
    assert 0.9 / V_MAX < late < 0.9 / V_MAX + 4 / (Z * W)
    assert found[-1, 0] == pytest.approx(1.0, abs=1e-6)  # 0.2 s are 27 time constants of the approach


@given(anything, anything, frequencies, dampings, fastest, st.booleans())
def test_the_largest_speed_is_never_exceeded(x, u, w, z, v_max, up):
    """At |v| = v_max the speed does not grow, for any position, command and parameters of the spool."""
    v = v_max if up else -v_max
    _, rate = (float(r) for r in FIELD(x, v, u, w, z, v_max))
    assert math.copysign(1, v) * rate <= 1e-12 * w * v_max  # rounding


@given(anything, anything, frequencies, dampings, fastest, st.sampled_from([1, -1]))
def test_the_stroke_is_never_exceeded(x, u, w, z, v_max, end):
    """If the speed is z w times the distance to an end, it falls at least as fast: it is not reached."""
    v = z * w * (end - x)
    speed, rate = (float(r) for r in FIELD(x, v, u, w, z, v_max))
    assert end * (rate + z * w * speed) <= 1e-10 * w * w  # d/dt (v - z w (end - x)); rounding


@given(anything)
def test_each_edge_opens_from_its_own_overlap_on(x):
    """Oil from and to a port: only leakage up to the overlap, more beyond, edge by edge."""
    a, b = spool_valve.spool_ports(VALVE, UNEQUAL, x, (0.0, 0.0), lines(1.0), OIL)
    for port, x_s, s, x_t, t in (
        (a, x, UNEQUAL.overlap_pa, -x, UNEQUAL.overlap_at),
        (b, -x, UNEQUAL.overlap_pb, x, UNEQUAL.overlap_bt),
    ):
        # without line flow both conductances show in the port pressure: P (G_s + G_t) = G_s P_s
        share = number(port.pressure)
        if x_s <= s and x_t <= t:
            assert share == pytest.approx(0.5, rel=1e-12)
        elif x_s > s + 1e-3:  # the foot is cubic: 1e-3 into it 1e-6 of the leakage
            assert share > (0.99 if x_s > s + ROUNDING else 0.5)
        elif x_t > t + 1e-3:
            assert share < (0.01 if x_t > t + ROUNDING else 0.5)


@given(st.floats(-1.0, 1.0), st.floats(-2e-3, 2e-3))
def test_equal_overlaps_make_the_valve_of_lumped(x, flow):
    """With the dead band as overlap of all edges and the spool at its command: the ports of lumped."""
    usual = spool_valve.ports_from_flow(VALVE, 10.0 * x, (flow, -flow), lines(), OIL)
    found = spool_valve.spool_ports(VALVE, SPOOL, x, (flow, -flow), lines(), OIL)
    for mine, theirs in zip(found, usual, strict=True):
        # exact identity; volts and shares differ by rounding, which the foot of the opening multiplies
        assert number(mine.pressure) == pytest.approx(number(theirs.pressure), rel=1e-6, abs=1.0)
