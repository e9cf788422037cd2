"""Inverse of valve and oil, from speed to command, against the equations of valve and oil."""

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from kit.equations import OIL, lines, number
from scipy.optimize import brentq

from fmus.components import pressure_compensator, spool_valve
from fmus.components.spool_valve import Valve
from fmus.controller import valve
from fmus.controller.harvester import ARM
from fmus.controller.model import CONTROLLER
from fmus.controller.valve import Actuator
from fmus.drives.compensated import cylinder_section, motor_section
from fmus.machine.parts import FAMILIES
from fmus.parameters import parameters

P = parameters(CONTROLLER)
FOOT = P.foot_share
SUPPLY, TANK = 20e6, 0.2e6
VALVES = st.builds(
    Valve,
    area=st.just(4e-5),
    discharge_coefficient=st.just(0.62),
    dead_band=st.floats(0.2, 1.5),
    full_command=st.floats(5.0, 12.0),
    command_rounding=st.floats(0.05, 0.5),
    leakage=st.just(0.0),
    transition_reynolds=st.just(10.0),
)


def drives() -> dict[str, Actuator]:
    """All three, pistons in the middle."""
    return ARM.actuators((0, P.boom.stroke / 2, P.stick.stroke / 2), P)


@given(VALVES, st.floats(40 * FOOT, 1.0), st.sampled_from([-1, 1]))
def test_command_opens_the_valve_as_asked(v, share, sign):
    """The curve of the valve returns the opening, and the other edges stay closed, above the rounded foot."""
    command = number(valve.command(v, sign * share, FOOT))
    shape = (v.dead_band, v.full_command, v.command_rounding)
    # opening / size is short of 1 by (foot / opening)^2 / 2, 1/3200 at most: 0.5 mV of a dead band of 1.5 V,
    # 0.7 % of the smallest share here of 3.5 V, and more where the curve is rounded
    assert number(spool_valve.opening(sign * command, *shape)) == pytest.approx(share, rel=0.03)
    assert number(spool_valve.opening(-sign * command, *shape)) == 0


def test_command_is_odd_and_increasing():
    """Also in the dead band, so that no loop can hang at an edge."""
    v = drives()["boom"].valve
    share = np.concatenate([-np.geomspace(1, 1e-7, 200), [0], np.geomspace(1e-7, 1, 200)])
    x = ca.SX.sym("x")
    command = ca.Function("c", [x], [valve.command(v, x, FOOT)]).map(share.size)(share[None]).full()[0]
    assert (np.diff(command) > 0).all()
    np.testing.assert_allclose(command, -command[::-1], rtol=1e-12)
    assert command[-1] == pytest.approx(v.full_command, rel=1e-5)  # the foot's rounding at full opening


def settled(a: Actuator, share: float, load: float) -> float:
    """Speed at which both chambers are at rest, by the valve's own port equation with the hose in series."""
    forward, backward = max(share, 0.0), max(-share, 0.0)

    def pressure(q: float, *openings: float) -> float:  # of a port with the flow q into the line
        node = spool_valve.edge_flows_from_flow(a.valve, q, *openings, lines(SUPPLY, TANK), OIL)
        return number(node.pressure - a.hose.turbulent * q * abs(q))

    def excess(speed: float) -> float:
        head = pressure(a.head_area * speed, forward, backward)
        return a.head_area * head - a.rod_area * pressure(-a.rod_area * speed, backward, forward) - load

    return brentq(excess, -3.0, 3.0)  # the force that is left falls with the speed


@pytest.mark.parametrize("share", [-0.8, -0.2, -0.03, 0.03, 0.2, 0.8])
@pytest.mark.parametrize("name", ["swing", "boom", "stick"])
def test_opening_gives_the_speed_when_pressures_have_settled(name, share):
    """The steady state of the valve equations at the opening for a speed is this speed, for any load."""
    a = drives()[name]
    for part in (-0.3, 0.0, 0.3):
        load = part * SUPPLY * a.rod_area
        speed = settled(a, share, load)
        # all pressures, and so the force, less that of the tank
        above_tank = load - (a.head_area - a.rod_area) * TANK
        full = valve.nominal_full_speeds(a, above_tank, SUPPLY - TANK)
        found = number(valve.opening_for(a, speed, full))
        # leakage, and laminar flow, which the controller leaves out
        assert found == pytest.approx(share, rel=0.02 if abs(share) > 0.1 else 0.06)


@pytest.mark.parametrize("share", [-0.8, -0.03, 0.03, 0.8])
@pytest.mark.parametrize("name", ["swing", "boom", "stick"])
def test_a_compensated_section_gets_the_command_for_its_flow(name, share):
    """Without droop, at 10 and 150 bar, a section passes the flow of a speed at the command for it."""
    part = "swing" if name == "swing" else "boom_stick"
    p = parameters(FAMILIES[part]["compensated"])
    p = replace(p, compensator=replace(p.compensator, droop=0.0))
    section = (motor_section if name == "swing" else cylinder_section)(getattr(p, name), p)
    a = replace(drives()[name], section_flows=section.flows)
    fed, area = (0, a.head_area) if share > 0 else (1, a.rod_area)
    full = valve.section_speeds(a)
    speed = share * full[fed]
    assert abs(speed) == pytest.approx(abs(share) * section.flows[fed] / area, rel=1e-12)  # rounding
    command = number(valve.command(a.valve, valve.opening_for(a, speed, full), FOOT))
    for load in (1e6, 15e6):
        ports = pressure_compensator.section_ports(section, command, (load, load), lines(SUPPLY, TANK, load))
        flow = number(ports[fed].edges.supply) - a.valve.leakage * (SUPPLY - load)
        # rounding of the curve where the valve opens
        assert flow == pytest.approx(abs(speed) * area, rel=1e-2 if abs(share) < 0.1 else 1e-3)
