"""Sharing of the flow and brake of the compensated drives, through their FMUs.

The formulas below are written out here, with the numbers of parameters.toml. Pistons move as a load does that
holds its pressure: the test bench gives the velocity that keeps a chamber at the wanted pressure.
"""

import math

import numpy as np
import pytest
from kit.equations import SUPPLY, piston_areas
from kit.every import native
from kit.fmu import driving

from fmus.machine.parts import FAMILIES
from fmus.parameters import values

P, S = (values(FAMILIES[part]["compensated"]).p for part in ("boom_stick", "swing"))
STEP, GAIN = 1e-3, 2e-11  # s, m3/(s.Pa) of the test bench
START = {"boom_holding_force": 5e4, "supply_pressure": SUPPLY}
HEAD = piston_areas(P, "boom")[0]


@pytest.fixture(scope="module")
def fmus(fmu_dir):
    """Both FMUs by part."""
    return {part: native(f"{part}_compensated", fmu_dir) for part in ("boom_stick", "swing")}


def opening(command):
    """Line with dead band of docs/equations.md, section 2, above the rounding at its foot."""
    band, width = P["valve_dead_band"], P["valve_command_rounding"]
    assert width < command - band
    return (command - band - width / 2) / (P["valve_full_command"] - band - width / 2)


def regulated(port, supply=SUPPLY):
    """Drop [Pa] over the metering edge with the supply's margin to spare; 5 kPa for the check valve."""
    return P["compensator_setting"] * (1 + P["compensator_droop"] * (supply - port - 5e3 - 1e7))


def step_under_load(fmu, load):
    """One step of the boom, whose head chamber the load keeps at a pressure, by a velocity in proportion."""
    pressure, flow = fmu.get("boom_head_pressure", "boom_head_flow")
    fmu.set(boom_velocity=(flow + GAIN * (pressure - load)) / HEAD)
    fmu.step(STEP)


def test_saturated_sections_of_both_drives_share_the_flow_in_the_ratio_of_their_openings(fmus):
    """A pump of 60 % of what is asked for: boom at 150 bar, swing at about 30 bar, in the ratio of q_0 y."""
    pump, asked = 2.0e-3, (P["boom_section_flow"] * opening(8.0), S["swing_section_flow"] * opening(7.0))
    assert pump < 0.7 * sum(asked)
    displacement = S["motor_displacement"] * S["gear_ratio"]
    with (
        driving(fmus["boom_stick"], boom_command=8.0, **START) as boom,
        driving(fmus["swing"], swing_command=7.0, supply_pressure=SUPPLY) as swing,
    ):
        supply, speed = SUPPLY, 0.0
        for _ in range(4000):
            sensed = max(boom["boom_stick_load_pressure"], swing["swing_load_pressure"])
            boom.set(supply_pressure=supply, load_sensing_pressure=sensed)
            swing.set(supply_pressure=supply, load_sensing_pressure=sensed, swing_speed=speed)
            step_under_load(boom, 150e5)
            swing.step(STEP)
            flow, pressure = swing.get("swing_flow_a", "swing_pressure_a")
            speed = (flow + GAIN * (pressure - 30e5)) / displacement
            taken = boom["supply_flow"] + swing["supply_flow"]
            supply += STEP * (pump - taken) / 1e-10  # a line of 160 L
        flows = np.array([boom["boom_meter_in_flow"], swing["swing_meter_in_flow"]])
        ports = (boom["boom_head_valve_pressure"], swing["swing_pressure_a"])
        drops = (boom["boom_metering_drop"], swing["swing_metering_drop"])
    margin = supply - max(ports)
    assert 0 < margin < P["compensator_setting"]  # saturated
    assert flows.sum() == pytest.approx(pump, rel=1e-3)  # the line has settled
    droop = [regulated(port, supply) / P["compensator_setting"] for port in ports]
    # the bar: openings and droop of the law; margin below zero is rounded over 0.2 bar, equal for both
    expected = asked[0] / asked[1] * math.sqrt(droop[0] / droop[1])
    assert flows[0] / flows[1] == pytest.approx(expected, rel=5e-3)
    assert flows[0] / flows[1] == pytest.approx(asked[0] / asked[1], rel=0.015)  # the droop alone
    shared = P["compensator_sharing"] * (margin + 1e8 / margin)  # m(z) of docs/equations.md, Symbols
    assert np.array(drops) / droop == pytest.approx(np.full(2, shared), rel=5e-3)


def test_the_brake_holds_and_does_not_creep(fmus):
    """95 % of its torque for half a minute: twisted by T/k, without drift, the oil's share leaked away.

    The column has an inertia of 2e4 kg m2, and as much viscous friction that it comes to rest. Without air,
    which at the pressure of the tank stretches the leakage of the oil to minutes.
    """
    inertia, damping, torque = 2e4, 4e4, 0.95 * S["brake_torque"]
    with driving(fmus["swing"], supply_pressure=0.0, air_share=0.0) as fmu:
        angle, speed, shown = 0.0, 0.0, []
        for k in range(30000):
            hydraulic = fmu["swing_torque"]
            speed += STEP * (min(1.0, k * STEP / 2) * torque + hydraulic - damping * speed) / inertia
            angle += STEP * speed
            fmu.set(swing_speed=speed)
            fmu.step(STEP)
            if k >= 20000:
                shown.append(angle)
        held = fmu["swing_brake_torque"]
    assert held == pytest.approx(torque, rel=5e-3)
    assert shown[-1] == pytest.approx(torque / S["brake_stiffness"], rel=5e-3)
    assert abs(shown[-1] - shown[0]) < 1e-9  # rad in 10 s; what the oil still leaks is gone after seconds
