"""The equations of the blind bench against closed forms, and one of its machines through the command."""

import math

import numpy as np
import pytest
from kit import shards
from kit.equations import Part

from benchmarks import blind
from benchmarks.blind import BAR
from fmus.manipulator import MANIPULATOR


def test_a_notch_opens_a_half_circle_and_then_a_slot():
    """Of a unit circle; a depth of half the radius leaves a segment of 120 degrees."""
    areas = blind.segment(np.array([-1.0, 0.5, 1.0, 3.0]), 1.0)
    expected = [0, math.pi / 3 - math.sqrt(3) / 4, math.pi / 2, math.pi / 2 + 4]
    assert areas == pytest.approx(expected, abs=1e-12)  # exact identities, rounding only


def test_an_edge_passes_the_flow_of_two_turbulent_resistances_in_series():
    """Its own and the throttle's; leakage and laminar flow are small there."""
    square, supply, throttle = 1e-12, 200 * BAR, 3e11
    flow, drop = blind.edge_flow(np.array([square]), supply, throttle)
    # leakage is 3e-7 m3/s of 4e-3, laminar flow counts 1e-6/4e-3/2
    assert flow == pytest.approx(math.sqrt(supply / (1 / square + throttle)), rel=2e-4)
    assert drop == pytest.approx(supply - throttle * flow**2, rel=1e-12)


def test_a_hose_oscillates_at_the_frequency_of_its_inertance_and_capacitance():
    """Behind a step of the inlet pressure, with a throttle that is almost closed; flow is laminar."""
    step, i, c = 2e-4, blind.INERTANCE, blind.CAPACITANCE
    inlet = np.full(2000, 101 * BAR)
    inlet[0] = 100 * BAR
    outlet = blind.hose_line(inlet, step, 0.0, i, c, 1e18, 0.0)[:, 1] - 101 * BAR
    rising = np.flatnonzero((outlet[:-1] < 0) & (outlet[1:] >= 0))
    period = step * np.diff(rising).sum() / (rising.size - 1)
    # a crossing is known to one step of 2e-4 s in about 20 periods of 20 ms
    assert period == pytest.approx(2 * math.pi * math.sqrt(i * c), rel=1e-3)


def test_the_swing_comes_to_the_speed_at_which_friction_balances_the_torque():
    """w (1 - exp(-t/T)) for a constant pressure difference; the damping includes that by the lines."""
    inertia, damping, step = 5e3, 2e3, 0.01
    nodes = blind.LINE * (2 / blind.INNER + 1 / blind.OUTER) + 1
    total = damping + 2 * blind.DISPLACEMENT**2 * blind.LINE / nodes
    drop, lines = np.full(500, 10 * BAR), (blind.INNER, blind.OUTER)
    speed = blind.swing_motion(drop, step, inertia, damping, 0.0, lines)
    time = step * np.arange(500)
    expected = blind.DISPLACEMENT * 10 * BAR / nodes / total * (1 - np.exp(-time * total / inertia))
    # error of RK4: (step/T)^4/120 with T = 2.5 s, of 0.7 rad/s
    assert speed[:, 1] == pytest.approx(expected, abs=1e-9)


def test_the_inertia_about_the_column_is_that_of_the_manipulator():
    """Another derivation: the project's comes from its energies; 1 N.m then accelerates by 1/J."""
    arm = Part(MANIPULATOR)
    rest = arm.start(boom_angle=0.2, stick_angle=-1.4)
    rest[[arm.at(name) for name in arm.states if name.endswith("_speed")]] = 0.0
    by_torque = arm(rest, swing_torque=1.0)[0] - arm(rest, swing_torque=0.0)[0]
    # same mechanics, rounding only
    assert 1 / by_torque[arm.at("swing_speed")] == pytest.approx(blind.yaw_inertia(0.2, -1.4), rel=1e-9)


def test_readings_have_the_declared_noise_zero_and_range():
    """Over 40 000 samples; a meter that correlates its samples has means as scattered as white noise."""
    sensor = blind.Sensor("L/min", 0.5, zero=0.2, top=300.0, correlation=0.2)
    readings = sensor.read(np.full(40_000, 100 * blind.LITRES), np.random.default_rng(1))
    blocks = readings.reshape(400, 100).mean(axis=1)
    # standard errors: 0.5/200 of the mean, 1/28 of the scatter of 400 means; four of them
    assert readings.mean() == pytest.approx(100.2, abs=0.01)
    assert blocks.std() * 10 == pytest.approx(0.5, rel=0.15)
    assert sensor.read(np.full(9, 1.0), np.random.default_rng(1)) == pytest.approx(300.0)


@shards.search
def test_a_clean_machine_is_identified_and_its_intervals_hold_the_truth(tmp_path):
    """All of its benches, through the files and the command."""
    machine = blind.build((), [1, 3], tmp_path)
    verdict = blind.judge(machine, tmp_path)
    assert verdict.status[0] in "013"
    assert {name for name in machine.truth if "[" not in name} <= set(verdict.found)
    # 95 % intervals, correlated along a curve: seven of ten at least
    assert np.mean(verdict.parameters + verdict.points) > 0.7
