"""The experiments on the whole machine: what moves, and that nothing happens that the lumped model lacks."""

from operator import attrgetter

import numpy as np
import pytest
from kit import shards
from kit.work_cycle import JOINTS, REFERENCE

from fmus.machine.poses import NOMINAL, POSES
from fmus.operator_input.work_cycle import WORK_CYCLE, WORK_CYCLE_STOP
from fmus.rig.experiments import INSTRUMENTS, MACHINE_EXPERIMENTS, TRAINING, experiment, simulate_machine

LITRES = 60e3  # L/min in 1 m3/s
QUICK = ("damping_swing_1", "damping_stick_2")  # those of the lumped machine are alike, and nothing is shared
EACH = [
    pytest.param(name, machine, marks=() if machine == "lumped" and name in QUICK else shards.machine)
    for machine in ("lumped", "detailed")
    for name in MACHINE_EXPERIMENTS
]


@pytest.mark.parametrize(("name", "machine"), EACH)
def test_oil_does_not_tear_and_no_cylinder_hits_its_end(name, machine):
    """There is no cavitation, no contact with an end stop, no signal out of range, and rest at first."""
    e = experiment(name, machine)
    voids = [v.max() for n, v in e.unrecorded.items() if n.endswith("void_volume")]
    stops = [np.abs(v).max() for n, v in e.unrecorded.items() if n.endswith("stop_force")]
    assert len(voids) == 3
    assert len(stops) == 2
    assert max(voids) < 1e-7  # m3, from there on the models warn
    assert max(stops) == 0  # exact: the stops' force is zero inside the stroke
    rest = e.time < 1.0
    for signal, values in e.signals.items():
        if "command" in signal:
            assert not values[rest].any()
        if "angle" in signal:
            # settling and leakage: 0.02 degrees, four counts of the encoder
            assert np.ptp(values[rest]) < np.radians(0.02), signal
        if "flow" in signal:
            assert np.abs(values).max() * LITRES < 299
        if "pressure" in signal:
            assert values.max() < 399e5
            # recordings to be fitted stay five standard deviations of noise off the end of the range
            floor = -0.5e5 if "tank" in signal or name == "machine_test" else 0.5e5
            assert values.min() > floor


@pytest.mark.parametrize(("name", "machine"), [p for p in EACH if str(p.values[0]).startswith("damping")])
def test_only_one_joint_moves(name, machine):
    """The joint moves in both directions, far and at several speeds; the other joints do not move."""
    e = experiment(name, machine)
    moving = e.conditions["joint"]
    for joint in JOINTS:
        angle, speed = e.signals[f"manipulator.{joint}_angle"], e.unrecorded[f"manipulator.{joint}_speed"]
        if joint == moving:
            assert np.ptp(angle) > np.radians(10)
            assert speed.max() > 0.1  # rad/s
            assert speed.min() < -0.1
        else:
            assert np.ptp(angle) < np.radians(1)  # the oil springs under the moving arm
    assert 15 < e.time[-1] < 25


def test_the_held_out_cycle_is_not_trained():
    """No stroke of the test is part of the training."""
    shape = attrgetter("axis", "command", "rise", "hold", "fall")
    trained = {shape(m) for moves, _ in TRAINING for m in moves}
    assert not trained & {*map(shape, WORK_CYCLE)}


@pytest.mark.parametrize("stop", [3.0, pytest.param(WORK_CYCLE_STOP, marks=shards.machine)])
def test_the_lumped_test_is_the_reference_trace(stop):
    """The rig's true signals are those of data/reference, which an independent program confirms."""
    _, signals = simulate_machine("lumped", WORK_CYCLE, stop, POSES[NOMINAL])
    for name in REFERENCE.keys() & set(INSTRUMENTS):
        wanted = REFERENCE[name]
        # two solutions by CVODES with 1e-10 and 1e-11; nine digits in the file
        found = signals[name][::4]
        assert np.abs(found - wanted[: found.size]).max() < 1e-6 * np.ptp(wanted), name
