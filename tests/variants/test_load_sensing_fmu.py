"""Closed forms of the load-sensing supply through its FMU: margin, cut-off, power limit.

The steady state is computed here from the parameters alone: three regulators, check valve, governor.
"""

from __future__ import annotations

import pytest
from kit.fmu import driving
from scipy.optimize import brentq

from fmus.export.build import build
from fmus.machine.parts import FAMILIES
from fmus.parameters import values

SUPPLY = FAMILIES["supply"]["load_sensing"]
P = values(SUPPLY).p
L_MIN = 1e-3 / 60  # m3/s
SHUTTLE = 3 / 32 * 5e4  # Pa: what a shuttle valve adds to two equal pressures
STEP = 1e-3  # s
BAR = 5e-3  # relative; found are 1e-5, what the foot of the governor's line is rounded by
D, LEAK, FOOT = (P[f"main_pump_{n}"] for n in ("displacement", "leakage", "rounding"))


@pytest.fixture(scope="module")
def fmu(tmp_path_factory):
    """The FMU of the supply."""
    return build(SUPPLY, tmp_path_factory.mktemp("supply"))


def held(fmu, flow, load, *names):
    """Outputs after 3 s: the swing takes a flow, led up over 1 s, against a load pressure."""
    with driving(fmu, swing_load_pressure=load) as supply:
        for k in range(3000):
            now = min(1.0, k * STEP) * flow
            supply.set(supply_flow_swing=now, return_flow_swing=now)
            supply.step(STEP)
        return supply.get(*names)


def drop(flow):
    """Over the check valve, r(z) = R q of docs/equations.md, section 5.3."""
    width = P["check_opening"]

    def short(z):
        s = min(z / width, 1.0)
        return width * (s**3 - s**4 / 2) + max(z - width, 0.0) - P["main_pump_check_resistance"] * flow

    return brentq(short, 0.0, 5e6, xtol=1e-6)


def speed(load):
    """Speed [rad/s] at which the governor gives the torque of the pump [N.m]."""

    def short(w):
        bend = ((w - P["engine_peak_speed"]) / (P["engine_rated_speed"] - P["engine_peak_speed"])) ** 2
        net = P["engine_rated_torque"] * (1 + P["engine_torque_rise"] * (1 - bend))
        span = P["engine_no_load_speed"] - P["engine_rated_speed"]
        return net * (P["engine_no_load_speed"] - w) / span - load(w)

    return brentq(short, P["engine_rated_speed"], P["engine_no_load_speed"])


def regulated(flow, setting, band):
    """Supply pressure [Pa] at a flow with the regulator p = setting - band (s - e^2/4s); tank at 0."""

    def rail(p):
        return brentq(lambda rail: rail + drop(flow + P["rail_leakage"] * rail) - p, 0.0, p, xtol=1e-6)

    def short(p):
        drawn = flow + P["rail_leakage"] * rail(p) + LEAK * p
        shaft = P["main_pump_pressure_friction"] * D * p
        w = speed(lambda w: drawn / w * p + shaft + P["main_pump_viscous_friction"] * w)
        s = drawn / (D * w)
        return setting - band * (s - FOOT**2 / (4 * s)) - p

    return rail(brentq(short, setting - 1.1 * band, setting + 0.1 * band, xtol=1e-3))


def test_margin_at_standstill(fmu):
    """All valves closed: the margin less what the regulator needs for the leakage of pump and valve block."""
    margin, sensed = held(fmu, 0.0, 0.0, "pressure_margin", "load_sensing_pressure")
    assert sensed == pytest.approx(SHUTTLE, rel=1e-6)
    expected = regulated(0.0, SHUTTLE + P["margin"], P["margin_band"]) - SHUTTLE
    assert margin == pytest.approx(expected, rel=1e-4)  # the bar is 5e-3
    assert margin == pytest.approx(P["margin"], rel=BAR)


@pytest.mark.parametrize(("flow", "load"), [(30, 2e6), (100, 1e7), (200, 1.6e7), (300, 6e6)])
def test_margin_in_motion(fmu, flow, load):
    """A load that moves with a flow: the margin falls along the band by the stroke, and by the valve."""
    (margin,) = held(fmu, flow * L_MIN, load, "pressure_margin")
    expected = regulated(flow * L_MIN, load + P["margin"], P["margin_band"]) - load
    assert margin == pytest.approx(expected, rel=1e-4)  # the bar is 5e-3


def test_a_stalled_stroke_is_held_at_the_cut_off(fmu):
    """No flow and a load beyond all limits: the supply has the cut-off pressure for the leakage alone."""
    (pressure,) = held(fmu, 0.0, 3e7, "supply_pressure")
    # the line's relief valve leaves the margin regulator above the cut-off; it traps some 10 kPa on the way
    assert pressure == pytest.approx(regulated(0.0, P["pressure_cut_off"], P["cut_off_band"]), rel=1e-3)
    assert pressure == pytest.approx(P["pressure_cut_off"], rel=BAR)
