"""The guard of equal steps on the machine: poses, programs, variants where voids close, pressures jump."""

import numpy as np
import pytest
from kit import shards

from orchestrator import Coupling, RunFailed, Trace, run
from orchestrator.ssp.swap import with_swaps

SPEEDS = [f"manipulator.{joint}_speed" for joint in ("swing", "boom", "stick")]
GUARDED = ("hermite", "interface-jacobian")


def off(found: Trace, truth: Trace, name: str) -> float:
    """Root mean square difference over the range; a joint that stands still counts as if it moved by 1e-3."""
    return float(np.sqrt(np.mean((found[name] - truth[name]) ** 2)) / max(np.ptp(truth[name]), 1e-3))


# the first is lost without a guard, the last one has the largest errors
LATER = (pytest.param(name, marks=shards.machine) for name in ("reach", "close", "raised"))


@pytest.mark.parametrize("chosen", ["folded", *LATER, "boom_up"])
def test_every_pose_and_program_runs_at_large_steps(system, chosen):
    """Voids open and close in all of them, which no linear model of a step predicts."""
    options = {"parameters": [chosen], "record_step": 0.02}
    truth = run(system, master="hermite", step=1e-3, **options).trace
    for master in GUARDED:
        for step, bar in ((5e-3, 5e-3), (20e-3, 4e-2)):  # measured 1.8e-3 and 3.6e-2 at most, in boom_up
            found = run(system, master=master, step=step, **options).trace
            assert max(off(found, truth, name) for name in SPEEDS) < bar


def test_without_it_a_pose_is_lost(system):
    """The guard is for steps in which a void closes."""
    bare = Coupling("interface-jacobian", guard=0)
    with pytest.raises(RunFailed):
        run(system, parameters=["folded"], master=bare, step=5e-3)


def test_a_slope_at_the_start_that_dies_at_once_is_not_followed(system):
    """The pump's pressure falls for microseconds only; a cubic with that slope would dip by 12 bar."""
    pumped = with_swaps(system, {"supply": "engine_pump"})
    options = {"stop": 2.0, "record_step": 0.005, "record": ["supply.supply_pressure"]}
    truth = run(pumped, master="hermite", step=5e-4, **options).trace
    found = run(pumped, master="hermite", step=5e-3, **options).trace
    # measured 4e-5 of the range over 12 s; without the guard 0.1
    assert off(found, truth, "supply.supply_pressure") < 1e-3


def test_a_command_that_jumps_inside_a_step_is_met(system):
    """Its corners are communication points, so 5 ms are as good as 1 ms of a master without a guard."""
    time = np.array([0.0, 1.0023, 1.0033, 3.0])
    jump = Trace(time, {"boom_command": np.array([0.0, 0.0, 4.0, 4.0])})
    options = {"stop": 3.0, "record_step": 0.02}
    truth = run(system, jump, master="hermite", step=2e-4, **options).trace
    for master in GUARDED:
        found = run(system, jump, master=master, step=5e-3, **options).trace
        assert off(found, truth, "manipulator.boom_speed") < 2e-3  # gauss-seidel at 5 ms: 3e-2
