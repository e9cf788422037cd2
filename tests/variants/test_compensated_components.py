"""Compensator: bounds and monotony; brake: test_balances.py, equations: test_circuits_transcription.py."""

from functools import cache

import casadi as ca
import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from fmus.components import pressure_compensator as compensator
from fmus.components.counterbalance_valve import Counterbalance, Restriction
from fmus.components.pressure_compensator import Compensator
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


def test_the_parameters_that_the_law_excludes_are_refused():
    """Requirements are positive for the numbers here, one is negative where sections would not share."""
    good = compensator.requirements(SECTION.valve, COMPENSATOR)
    assert min(map(float, good.values())) > 0
    bad = Compensator(**{**vars(COMPENSATOR), "sharing": 0.95, "open_drop": 2e5})
    assert min(map(float, compensator.requirements(SECTION.valve, bad).values())) < 0
