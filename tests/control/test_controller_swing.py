"""The swing of the stretched arm under control: damped, in the linear model and in time."""

import numpy as np
import pytest

from orchestrator import linearize, run

SPEED = "manipulator.swing_speed"
SLEW = {"engaged": 1.0, "swing_velocity": 0.4}  # rad/s; what a full stick asks for


@pytest.fixture(scope="module")
def slewing(fmu_dir):
    """Full tip swing at full reach from rest, 8 s."""
    system = fmu_dir / "harvester_control.ssp"
    return run(system, parameters=["reach"], set=SLEW, stop=8, record=[SPEED], record_step=0.01).trace


def test_the_closed_loop_of_the_stretched_arm_is_damped(fmu_dir):
    """Its mode below 1 Hz dies away in two periods; where the swinging passes for a load it hardly does."""
    system, point = fmu_dir / "harvester_control.ssp", {"parameters": ["reach"], "time": 4.0}
    before = {"controller.swing_load_time": 0.4, "controller.swing_damping_rate": 15.0}
    now, then = (slowest(linearize(system, set=SLEW | more, **point)) for more in ({}, before))
    assert 0.6 < now.frequency < 1.0  # Hz: position gain and inertia
    assert now.damping > 0.2  # measured: 0.23
    assert then.damping < 0.05  # the figure of docs/control.md: 0.034


def slowest(linear):
    """The swing's mode of least damping."""
    swings = [m for m in linear.modes if m.name.startswith("swing swings") and m.frequency]
    return min(swings, key=lambda m: m.damping)


def test_the_stretched_arm_swings_evenly_after_a_start(slewing):
    """From 5 s on the speed is the wanted one within 1 %; it rang by 0.1 rad/s before."""
    speed = slewing[SPEED][slewing.time > 5]
    np.testing.assert_allclose(speed, SLEW["swing_velocity"], rtol=0.01)
