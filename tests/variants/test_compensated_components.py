"""Compensator: bounds and monotony; counterbalance valve: its data sheet.

Brake: test_balances.py, equations: test_circuits_transcription.py.
"""

from dataclasses import replace
from functools import cache

import casadi as ca
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from kit.equations import OIL, lines

from fmus.components import counterbalance_valve
from fmus.components import pressure_compensator as compensator
from fmus.components.counterbalance_valve import Restriction
from fmus.components.hose import ShortLine
from fmus.components.orifice import Edge
from fmus.drives.compensated import motor_section
from fmus.machine.parts import FAMILIES
from fmus.parameters import parameters

SWING = parameters(FAMILIES["swing"]["compensated"])
SECTION = motor_section(SWING.swing, SWING)
COMPENSATOR = SECTION.compensator
VALVE = parameters(FAMILIES["boom_stick"]["compensated"]).counterbalance
EDGE = Edge(discharge_coefficient=0.62, transition_reynolds=10.0)
ALONE = Restriction(EDGE, ShortLine(0.0, 0.0), OIL)  # without hose
PRESSURE = st.floats(0, 4e7)
COMMAND = st.floats(-10, 10)


@cache
def supplied():
    """Flow from the supply into port A of a section at (command, port, supply, sensing), and its gradient."""
    given_ = ca.SX.sym("given", 4)
    command, port, supply, sensing = ca.vertsplit(given_)
    a, _ = compensator.section_ports(SECTION, command, (port, 0.0), lines(supply, 0.0, sensing))
    return ca.Function("f", [given_], [a.edges.supply, ca.gradient(a.edges.supply, given_)])


@given(COMMAND, PRESSURE, PRESSURE, PRESSURE)
def test_a_section_never_flows_back_and_follows_its_pressures(command, port, supply, sensing):
    """Q >= 0, 0 without a drop from the supply; it rises with command and supply, falls with P and P_LS."""
    flow, slope = (v.full().ravel() for v in supplied()([command, port, supply, sensing]))
    assert flow[0] >= 0
    if supply <= port:
        assert flow[0] == 0
    # 1e-9: rounding of terms that cancel
    assert (slope * (1, -1, 1, -1) >= -1e-9 * np.abs(slope).max()).all()


def test_the_parameters_that_the_law_excludes_are_refused():
    """Requirements are positive for the numbers here, one is negative where sections would not share."""
    good = compensator.requirements(SECTION.valve, COMPENSATOR)
    assert min(map(float, good.values())) > 0
    bad = replace(COMPENSATOR, sharing=0.95, open_drop=2e5)
    assert min(map(float, compensator.requirements(SECTION.valve, bad).values())) < 0


# ---- counterbalance valve: what its data sheet says, in numbers of its own

BAR, LITRES_PER_MINUTE, TANK = 1e5, 1 / 6e4, 4e5


def cracking(ratio, pilot, line, share):
    """Chamber pressure [Pa] at which the valve begins to open, by bisection."""
    valve = replace(VALVE, back_pressure_share=share)
    low, high = 0.0, 2e8
    for _ in range(60):
        middle = (low + high) / 2
        opened = float(counterbalance_valve.balance(valve, ratio, middle, pilot, line, TANK)) > 0
        low, high = (low, middle) if opened else (middle, high)
    return high


@pytest.mark.parametrize("ratio", [1.5, 4.5])
def test_pilot_and_back_pressure_shift_the_setting_as_the_data_sheet_says(ratio):
    """Pilot pressure lowers the setting by the ratio times itself; back pressure adds 1 + ratio times itself.

    215 bar above the tank; a vented valve does not feel back pressure. 1 Pa: the foot of the smooth ramp.
    """
    usual = cracking(ratio, TANK, TANK, 1.0)
    assert usual - TANK == pytest.approx(215 * BAR, abs=2e3)
    assert usual - cracking(ratio, TANK + 20 * BAR, TANK, 1.0) == pytest.approx(ratio * 20 * BAR, abs=1.0)
    raised = cracking(ratio, TANK, TANK + 10 * BAR, 1.0) - usual
    assert raised == pytest.approx((1 + ratio) * 10 * BAR, abs=1.0)
    assert cracking(ratio, TANK, TANK + 10 * BAR, 0.0) == pytest.approx(usual, abs=1.0)


def test_it_is_open_20_percent_above_its_setting():
    """Half open half a band, 40 bar, above the setting; fully open where the rounding of the end is left."""
    for d, expected in ((-1, 0.0), (22, 0.5), (44, 1.0)):
        at = counterbalance_valve.balance(VALVE, 3.0, TANK + (215 + d) * BAR, TANK, TANK, TANK)
        assert float(at) == pytest.approx(expected, abs=1e-12)  # exact: both ramps are straight there


def test_rated_flows_are_those_of_the_cartridge():
    """240 L/min at 14 bar through the open poppet, at 10 bar through the check valve, else nothing."""
    cases = [(1.0, -14 * BAR, -240), (0.0, 10 * BAR, 240), (0.0, 0.3 * BAR, 0.0), (0.0, -200 * BAR, 0.0)]
    for opening, drop, rated in cases:
        flow = float(counterbalance_valve.flow(VALVE, opening, ALONE, drop))
        # 5 %: the areas are rounded to two digits; a closed one leaks 0.4 mL/min
        assert flow == pytest.approx(rated * LITRES_PER_MINUTE, rel=0.05, abs=1e-8)
