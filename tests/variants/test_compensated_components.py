"""Compensator and counterbalance valve: bounds, monotony, smoothness; brake: test_balances.py."""

from __future__ import annotations

from functools import cache

import casadi as ca
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fmus.components import counterbalance_valve
from fmus.components import pressure_compensator as compensator
from fmus.components.counterbalance_valve import Counterbalance, Restriction
from fmus.components.pressure_compensator import Compensator
from fmus.components.smooth import lower
from fmus.machine.parts import FAMILIES
from fmus.parameters import values
from fmus.swing import compensated as swing

NUMBERS = values(FAMILIES["boom_stick"]["compensated"]).p
SWING = swing.CompensatedSwingParameters(**values(FAMILIES["swing"]["compensated"]).p)
SECTION = swing.section(SWING)
COMPENSATOR = SECTION.compensator
VALVE = Counterbalance(**{n: NUMBERS[f"counterbalance_{n}"] for n in Counterbalance.__dataclass_fields__})
AROUND = Restriction(0.62, 970.0, 2.4e10, 1e-5)
PRESSURE = st.floats(0, 4e7)
COMMAND = st.floats(-10, 10)


def compiled(expression, *symbols):
    """A function and its gradient."""
    column = ca.vertcat(*symbols)
    return ca.Function("f", [column], [expression, ca.gradient(expression, column)])


@cache
def supplied():
    """Flow from the supply into port A of a section at (command, port, supply, sensing), and its gradient."""
    command, port, supply, sensing = (ca.SX.sym(n) for n in ("u", "p", "s", "ls"))
    a, _ = compensator.section_ports(SECTION, command, (port, 0.0), supply, sensing, 0.0)
    return compiled(a.edges.supply, command, port, supply, sensing)


@given(COMMAND, PRESSURE, PRESSURE, PRESSURE)
def test_a_section_never_flows_back_and_follows_its_pressures(command, port, supply, sensing):
    """Q >= 0, 0 without a drop from the supply; it rises with command and supply, falls with P and P_LS."""
    flow, slope = (v.full().ravel() for v in supplied()([command, port, supply, sensing]))
    assert flow[0] >= 0
    if supply <= port:
        assert flow[0] == 0
    by_command, by_port, by_supply, by_sensing = slope
    least = 1e-9 * np.abs(slope).max()  # rounding of terms that cancel
    assert by_command >= -least
    assert by_port <= least
    assert by_supply >= -least
    assert by_sensing <= least


# where one law takes over from another: check valve, saturation of the supply, setting, full opening
SEAMS = [
    (5.0, 1e7, 1e7, 0.5e7),
    (5.0, 1e7, 1e7 + compensator.CHECK_ROUNDING, 0.5e7),
    (5.0, 1e7, 2e7, 2e7),
    (5.0, 1e7, 2e7, 2e7 - 1.6e6),
    (9.0, 1e7, 1e7 + 1.3e6, 0.5e7),
    (10.0, 1e7, 2e7, 1e7),
    (0.6, 1e7, 2e7, 1e7),
    (1.0, 1e7, 2e7, 1e7),
]


@pytest.mark.parametrize("seam", SEAMS)
def test_the_flow_of_a_section_has_no_kink(seam):
    """Derivatives on both sides of every seam agree (but full command, where the spool is at its end)."""
    nudge = np.array([1e-6, 1.0, 1.0, 1.0])
    _, before = supplied()(np.array(seam) - nudge * [1, -1, 1, 1])
    _, behind = supplied()(np.array(seam) + nudge * [1, -1, 1, 1])
    _, at = supplied()(seam)
    scale = np.abs(supplied()([5.0, 1e7, 1.2e7, 1.1e7])[1].full().ravel())
    scale[1] = scale[2]  # far from saturation the load has no effect but the droop
    first = 1 if seam[0] == 10.0 else 0
    for side in (before, behind):
        # a kink changes a derivative by a part of itself, 1 Pa of the 10 kPa of the check valve by 1e-3
        assert np.all(np.abs((side - at).full().ravel())[first:] < 1e-2 * scale[first:])


@given(st.floats(0, 1e8), st.floats(0, 1e8))
def test_the_smooth_minimum_is_exact_apart_and_never_far_below(a, b):
    """The minimum for numbers that differ by 10 %, but for rounding, else 1 % below at most."""
    found, least, rounding = float(lower(a, b)), min(a, b), 1e-15 * max(a, b) + 1e-9
    assert found <= least + rounding
    assert found >= 0.99 * least - rounding
    if max(a, b) > 1.11 * least:
        assert found == pytest.approx(least, rel=0, abs=rounding)
    if a < 0.9 * b and b > 1e-6:
        assert found == a


@cache
def counterbalanced():
    """Flow at (opening, line, chamber), and its gradient."""
    y, line, chamber = (ca.SX.sym(n) for n in ("y", "v", "c"))
    return compiled(counterbalance_valve.flow(VALVE, y, line, chamber, AROUND), y, line, chamber)


@given(st.floats(0, 1), PRESSURE, PRESSURE)
def test_a_counterbalance_valve_flows_along_its_pressure_difference(opening, line, chamber):
    """Down the pressure difference, increasing with it; closed it passes its leakage alone outwards."""
    flow, slope = (v.full().ravel() for v in counterbalanced()([opening, line, chamber]))
    assert flow[0] * (line - chamber) >= 0
    assert slope[1] >= 0 >= slope[2]
    if opening == 0 and line <= chamber:
        assert flow[0] == pytest.approx(VALVE.leakage * (line - chamber), rel=1e-12)


@pytest.mark.parametrize(
    ("share", "pilot", "opening"),
    [
        # vented, 5 bar in the tank: 120 + 4 x 38.75 - 5 x 5 = 250 bar is the setting, to the bar
        *((0.0, 38.75, 0.0), (0.0, 30.0, 0.0)),
        # 280 - 25 is 5 bar above it, an eighth of the band, and half of the rounding of 0.1 less
        *((0.0, 40.0, 0.075), (0.0, 44.0, 0.475)),
        # 328 - 25 is 53 bar above it, and the band has 40
        (0.0, 52.0, 1.0),
        # three ports: the line has 12 bar, of which five times as much counts: 280 - 60, 328 - 60 bar
        *((1.0, 40.0, 0.0), (1.0, 52.0, 0.4)),
        # half of the back pressure: 8.5 bar, 304 - 42.5 bar
        (0.5, 46.0, 0.2375),
    ],
)
def test_a_counterbalance_valve_opens_by_load_and_pilot_less_back_pressure(share, pilot, opening):
    """At a load of 120 bar, pilot ratio 4, setting 250 bar, band 40 bar: openings worked out by hand."""
    own = {"pressure": 25e6, "pilot_ratio": 4.0, "band": 4e6, "back_pressure_share": share}
    valve = Counterbalance(**{**vars(VALVE), **own})
    found = float(counterbalance_valve.balance(valve, 12e6, pilot * 1e5, 12e5, 5e5))
    # exact identity, rounding only
    assert found == pytest.approx(opening, rel=1e-12, abs=1e-12)


def test_the_parameters_that_the_law_excludes_are_refused():
    """Requirements are positive for the numbers here, one is negative where sections would not share."""
    good = compensator.requirements(SECTION.valve, COMPENSATOR)
    assert min(map(float, good.values())) > 0
    bad = Compensator(**{**vars(COMPENSATOR), "sharing": 0.95, "open_drop": 2e5})
    assert min(map(float, compensator.requirements(SECTION.valve, bad).values())) < 0
