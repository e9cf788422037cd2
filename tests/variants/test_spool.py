"""Spool dynamics: second order for small motions, limits of speed and stroke, overlaps of the four edges."""

import math

import casadi as ca
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from kit.equations import OIL, VALVE, lines, number
from kit.properties import examples

from fmus.components import spool_valve
from fmus.components.spool_valve import Spool, SpoolState

W, Z, V_MAX = 2 * math.pi * 30.0, 0.707, 20.0


def moving(w, z, speed, overlaps=(0.06,) * 4) -> Spool:
    """A spool of angular frequency w."""
    names = ("overlap_pa", "overlap_at", "overlap_pb", "overlap_bt")
    edges = dict(zip(names, overlaps, strict=True))
    return Spool(frequency=w / (2 * math.pi), damping=z, speed=speed, **edges)


SPOOL = moving(W, Z, V_MAX)
STEP = 2e-4  # s

_x, _v, _u, _w, _z, _m = (ca.SX.sym(n) for n in ("x", "v", "u", "w", "z", "m"))
_RATES = spool_valve.spool_rates(moving(_w, _z, _m), SpoolState(_x, _v), _u)
FIELD = ca.Function("field", [_x, _v, _u, _w, _z, _m], [_RATES.position, _RATES.speed])


def follow(commands: np.ndarray, start: float = 0.0, step: float = STEP) -> np.ndarray:
    """Positions and speeds (n + 1, 2) for commands that each hold for a step; Runge-Kutta of order 4."""
    state = ca.vertcat(_x, _v)
    f = ca.Function("f", [state, _u], [ca.vertcat(*FIELD(_x, _v, _u, W, Z, V_MAX))])
    k1 = f(state, _u)
    k2 = f(state + step / 2 * k1, _u)
    k3 = f(state + step / 2 * k2, _u)
    k4 = f(state + step * k3, _u)
    one = ca.Function("one", [state, _u], [state + step / 6 * (k1 + 2 * k2 + 2 * k3 + k4)])
    found = one.mapaccum(commands.size)([start, 0.0], commands[None, :]).full().T
    return np.vstack([[start, 0.0], found])


def test_small_step_is_the_closed_form_of_second_order():
    """A step of 5 % of the stroke: x = u (1 - e^(-z w t) (cos(w_d t) + z w/w_d sin(w_d t)))."""
    count, u = 400, 0.05
    time = np.arange(count + 1) * STEP
    damped = W * math.sqrt(1 - Z**2)
    ring = np.cos(damped * time) + Z * W / damped * np.sin(damped * time)
    expected = u * (1 - np.exp(-Z * W * time) * ring)
    found = follow(np.full(count, u))[:, 0]
    # Runge-Kutta with w h = 0.04: (w h)^4 / 120 = 2e-8 of the step
    assert found == pytest.approx(expected, abs=1e-7 * u)
    assert found.max() > 1.04 * u  # it overshoots, as a damping of 0.707 does


def test_full_step_takes_the_rate_limit():
    """From the centre to the full stroke: at v_max on the way, so 90 % after 0.9/v_max and the approach."""
    found = follow(np.full(1000, 1.0))
    assert found[:, 1].max() == pytest.approx(V_MAX, rel=1e-3)  # creeps up to the limit with 1/(2 z w)
    late = np.argmax(found[:, 0] > 0.9) * STEP
    assert 0.9 / V_MAX < late < 0.9 / V_MAX + 4 / (Z * W)
    assert found[-1, 0] == pytest.approx(1.0, abs=1e-6)  # 0.2 s are 27 time constants of the approach


@examples(40)
@given(st.lists(st.floats(-5.0, 5.0), min_size=5, max_size=40), st.floats(-1.0, 1.0))
def test_no_command_drives_the_spool_too_fast_or_out_of_its_stroke(levels, start):
    """For any commands, also beyond full: |v| <= v_max and |x| <= 1."""
    wanted = [float(spool_valve.commanded_position(level * 10.0, 10.0)) for level in levels]
    found = follow(np.repeat(wanted, 50), start)
    # invariants of the equations; Runge-Kutta may leave them by its error of 1e-6
    assert np.abs(found[:, 1]).max() <= V_MAX * (1 + 1e-6)
    assert np.abs(found[:, 0]).max() <= 1 + 1e-6


anything = st.floats(-1.0, 1.0)
frequencies, dampings, fastest = st.floats(10.0, 1000.0), st.floats(0.2, 1.5), st.floats(1.0, 100.0)


@given(anything, anything, frequencies, dampings, fastest, st.booleans())
def test_the_largest_speed_is_never_exceeded(x, u, w, z, v_max, up):
    """At |v| = v_max the speed does not grow, for any position, command and parameters of the spool."""
    v = v_max if up else -v_max
    _, rate = (float(r) for r in FIELD(x, v, u, w, z, v_max))
    assert math.copysign(1, v) * rate <= 1e-12 * w * v_max  # rounding


@given(anything, anything, frequencies, dampings, fastest)
def test_the_stroke_is_never_exceeded(x, u, w, z, v_max):
    """If the speed is z w times the distance left, it falls at least as fast: the end is not reached."""
    v = z * w * (1 - x)
    speed, rate = (float(r) for r in FIELD(x, v, u, w, z, v_max))
    assert rate + z * w * speed <= 1e-10 * w * w  # d/dt (v - z w (1 - x)); rounding


ROUNDING = 0.04  # of the foot, as share of the stroke
UNEQUAL = moving(W, Z, V_MAX, (0.06, 0.1, 0.2, 0.3))


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
