"""Slow oscillations under control, of a stretched arm and a heavy load: damped, linearised and in time."""

from itertools import product

import numpy as np
import pytest
from kit import shards
from kit.steering import IDEAL

from orchestrator import Trace, linearize, run

SPEED = "manipulator.swing_speed"
# the pistons' gains, which the swing had once
OLD = {"position_gain": 5.0, "integral_gain": 10.0, "damping_rate": 15.0, "load_time": 0.4}
STRETCHED = ["reach"]


def slewed(machine, time, wanted, **more):
    """Swing speed and time from 0 to 20 s of the stretched arm, with swing velocities wanted over time."""
    signals = {"swing_velocity": np.array(wanted, float), "engaged": np.ones(len(time))}
    scenario = Trace(np.array(time, float), signals)
    trace = run(machine, scenario, parameters=STRETCHED, set=more, record=[SPEED], record_step=0.01).trace
    return trace.time, trace[SPEED]


def damping(machine, **gains):
    """Of the swing's least damped slow mode while it turns at 0.4 rad/s."""
    own = {f"controller.swing_{n}": v for n, v in gains.items()}
    given = {"engaged": 1.0, "swing_velocity": 0.4} | IDEAL | own
    modes = linearize(machine, parameters=STRETCHED, set=given, time=4.0).modes
    return min(m.damping for m in modes if m.name.startswith("oscillation of swing") and m.frequency < 2)


def test_the_closed_loop_of_the_stretched_arm_is_damped(machine):
    """Damped with its own gains; with those of the pistons it hardly was."""
    assert damping(machine) > 0.33  # measured: 0.343
    assert damping(machine, **OLD) < 0.12  # measured: 0.118


HEAVY = {
    "manipulator.payload_mass": 650.0,
    "boom_stick.boom_hose_capacitance": 4 * 5.4e-13,
    "boom_stick.stick_hose_capacitance": 4 * 7.2e-13,
}


def test_gains_fall_with_the_frequency_of_the_load(machine):
    """650 kg on soft hoses, raised: the boom is damped; with the gains of an empty one hardly."""

    def least(**more: float) -> float:
        given = {"engaged": 1.0, "vertical_velocity": 0.15} | {f"controller.{n}": v for n, v in more.items()}
        linear = linearize(machine, parameters=["nominal"], set=given | IDEAL | HEAVY, time=2.0)
        return min(m.damping for m in linear.modes if 0.5 < m.frequency < 2)

    assert least() > 0.3  # measured: 0.335
    assert least(frequency_share=100.0) < 0.15  # measured: 0.131


USUAL, TIGHT = 0.1, 0.03  # rad, the error up to which the reference waits
BEFORE_AFTER = [*product((0.4, 0.0, -0.4, -0.6), (0.4, 0.6), (USUAL, TIGHT))]
# the largest jump with both limits, the smallest, and one to each speed
QUICK = [(-0.6, 0.6, USUAL), (-0.6, 0.6, TIGHT), (0.4, 0.6, USUAL), (0.0, 0.4, TIGHT)]


@pytest.mark.parametrize(("before", "after", "limit"), shards.few(QUICK, BEFORE_AFTER, shards.machine))
def test_what_is_asked_at_once_is_reached(machine, before, after, limit):
    """However the speed wanted jumps and however soon the reference waits, the arm does not swing on."""
    given = IDEAL | {"controller.swing_error_limit": limit}
    time, speed = slewed(machine, [0, 6, 6.001, 20], [before, before, after, after], **given)
    last = speed[time > 16]  # a reference that waited for a machine ahead of it, too: -0.3 to 0.9 rad/s
    assert np.ptp(last) < 0.01  # rad/s
    assert last.mean() == pytest.approx(after, rel=0.02)  # at 0.6 the speed limit takes 1.8 %
