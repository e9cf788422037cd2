"""The load-sensing supply: margin, cut-off, power limit and times against closed forms."""

import casadi as ca
import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from kit.mistakes import table
from kit.properties import examples
from kit.supply_bench import L_MIN, Bench, Load
from scipy.optimize import brentq

from fmus import smooth

BENCH = Bench("load_sensing")
P = BENCH.p
FULL = P["main_pump_displacement"] * P["engine_rated_speed"]  # m3/s at rated speed
LIMIT = P["pressure_cut_off"] - P["load_sensing_relief_difference"]
SETTLED = 1e-5  # integrator, and what is left of the transient
ROWS = st.lists(st.tuples(st.integers(0, 600), st.floats(0.0, 2.5e7)), min_size=3, max_size=6)


def drop(flow: float) -> float:
    """Over the check valve with its line: r(z) = R q, r as it is written in the equations."""

    def short(z):
        s = min(z / P["check_opening"], 1.0)
        ramp = P["check_opening"] * (s**3 - s**4 / 2) + max(z - P["check_opening"], 0.0)
        return ramp - P["main_pump_check_resistance"] * flow

    return brentq(short, 0.0, 5e6, xtol=1e-6)


def stroke(y) -> float:
    """Stroke that covers the flow and the leakage of the pump."""
    lost = P["main_pump_leakage"] * y["pump_pressure"]
    return (y["pump_flow"] + lost) / (P["main_pump_displacement"] * y["engine_speed"])


def line(setting: float, band: float, s: float) -> float:
    """Outlet pressure of a regulator at a stroke, with the rounded foot of its line."""
    return setting - band * (s - P["main_pump_rounding"] ** 2 / (4 * s))


def speed(load) -> float:
    """Speed [rad/s] at which the governor gives the torque of the pump [N.m]."""

    def short(w):
        bend = ((w - P["engine_peak_speed"]) / (P["engine_rated_speed"] - P["engine_peak_speed"])) ** 2
        net = P["engine_rated_torque"] * (1 + P["engine_torque_rise"] * (1 - bend))
        span = P["engine_no_load_speed"] - P["engine_rated_speed"]
        return net * (P["engine_no_load_speed"] - w) / span - load(w)

    return brentq(short, P["engine_rated_speed"], P["engine_no_load_speed"])


def regulated(flow: float, setting: float, band: float) -> float:
    """Supply pressure [Pa] at a flow, from the parameters alone: regulator, check valve, governor."""
    d, leakage = P["main_pump_displacement"], P["main_pump_leakage"]

    def rail(p):
        return brentq(lambda rail: rail + drop(flow + P["rail_leakage"] * rail) - p, 0.0, p, xtol=1e-6)

    def short(p):
        drawn = flow + P["rail_leakage"] * rail(p) + leakage * p
        friction = P["main_pump_pressure_friction"] * d * p
        w = speed(lambda w: drawn / w * p + friction + P["main_pump_viscous_friction"] * w)
        return line(setting, band, drawn / (d * w)) - p

    return rail(brentq(short, setting - 1.1 * band, setting + 0.1 * band, xtol=1e-3))


def wide(flow: float, load: float) -> Load:
    """A valve that takes a flow at the margin less half its band."""
    return Load(flow / np.sqrt(P["margin"] - P["margin_band"] / 2), load)


@given(
    st.floats(1e6, 3e6),
    st.floats(0.2, 0.9),
    st.floats(1e-12, 2e-11),
    st.floats(1e-14, 1e-11),
    st.floats(0, 3e5),
    st.floats(80.0, 600.0),
    st.floats(1.0, 1000.0),
)
def test_standby_stays_at_rest(margin, band, leakage, bleed, tank, engine, limit):
    """Whatever the settings, the state at the start does not move while all valves are closed."""
    p = BENCH.constants(
        margin=margin,
        margin_band=band * margin,
        load_sensing_relief_difference=0.8 * margin,
        main_pump_leakage=leakage,
        rail_leakage=bleed,
        reservoir_pressure=tank,
        engine_rated_torque=engine,
        torque_limit=limit,
    )
    violated = BENCH.violated(p)
    assert all("torque_limit" in v for v in violated)
    assume(not violated)  # a power limit that acts in standby, a few N.m
    closed = tank + P["return_preload"]
    u = BENCH.row(swing_load_pressure=closed, boom_stick_load_pressure=closed)
    dx = BENCH.rates(BENCH.rest(p), u, p)
    assert abs(dx["pump_stroke"]) < 1e-11  # rounding leaves 3e-13 of 20 000 settings
    assert max(abs(dx[f"{n}_pressure"]) for n in ("supply", "pump", "load_sensing", "tank")) < 1.0  # Pa/s
    assert abs(dx["engine_speed"]) < 1e-8
    assert abs(dx["engine_fuel_torque"]) < 1e-6


@pytest.mark.parametrize(("flow", "load"), [(10, 2e6), (60, 1.6e7), (100, 1e7), (200, 1.6e7), (300, 6e6)])
def test_margin_in_motion_droops_along_the_band(flow, load):
    """P - P_LS = margin - band s - drop over the check valve, with the stroke s of flow and leakage."""
    y = BENCH.settled(wide(flow * L_MIN, load))
    assert y["load_sensing_pressure"] == pytest.approx(load, rel=1e-6)  # integrator
    at_stroke = line(P["margin"], P["margin_band"], stroke(y)) - drop(y["pump_flow"])
    assert y["pressure_margin"] == pytest.approx(at_stroke, rel=SETTLED)
    # the roundings at the feet of governor and stroke: 1e-5
    alone = regulated(y["supply_flow"], load + P["margin"], P["margin_band"]) - load
    assert y["pressure_margin"] == pytest.approx(alone, rel=1e-4)
    assert P["margin"] - P["margin_band"] - drop(FULL) < y["pressure_margin"] < P["margin"]


@pytest.mark.parametrize("load", [1.7e7, 1.8e7])
def test_power_limit_holds_the_torque(load):
    """Valve too wide: pressure times flow of the swash plate = torque limit times speed, at any load."""
    y = BENCH.settled(wide(2 * FULL, load))
    flow = y["pump_flow"] + P["main_pump_leakage"] * y["pump_pressure"]
    power = P["torque_limit"] * y["engine_speed"]
    assert 0.8 < y["pump_stroke"] < 0.96
    # rounding of the lowest stroke, (0.01)^2 / (4 * 0.9), and the integrator
    assert y["pump_pressure"] * flow == pytest.approx(power, rel=1e-3)
    assert y["engine_load"] < P["engine_rated_torque"]
    assert y["engine_speed"] > P["engine_rated_speed"]  # the engine is not lugged down
    assert y["pressure_margin"] < P["margin"] - P["margin_band"]  # saturated: the margin is lost


@given(st.floats(1e-60, 3.0), st.floats(0.01, 1.0))
def test_inverse_of_the_ramp(y, width):
    """ramp(ramp_inverse(y)) = y."""
    back = float(smooth.ramp(smooth.ramp_inverse(ca.DM(y), width), width))
    assert back == pytest.approx(y, rel=1e-9, abs=1e-300)  # rounding of a cube root


@examples(10)
@given(ROWS, st.floats(0.1, 0.6))
def test_limits_hold_for_any_row_of_loads(rows, hold):
    """The load-sensing line stays below its relief valve, no stall, no run-away."""
    _, y = BENCH.through([wide(q * L_MIN, load) for q, load in rows], BENCH.constants(), hold, 20)
    # tolerance of the integrator
    assert y["load_sensing_pressure"].max() <= LIMIT * (1 + 1e-9)
    assert y["engine_speed"].min() > 0.9 * P["engine_rated_speed"]
    assert y["engine_speed"].max() < 1.05 * P["engine_no_load_speed"]


@table(__file__, "settings", "changes, fails")
def test_settings_out_of_order_are_told_in_words(changes, fails):
    """Each requirement has its sentence."""
    found = BENCH.violated(BENCH.constants(**changes))
    assert found == (fails.split(", ") if fails else [])
