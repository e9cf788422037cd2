"""The payload of the head: pick-up, drop, program of the operator, work cycle with stems.

Its weight and inertia: tests/equations/test_rigid_body.py and test_transcription.py.
"""

import casadi as ca
import numpy as np
import pytest
from kit import shards
from kit.equations import Part, machine, played, work_cycle

from fmus.manipulator import VARIANTS
from fmus.operator_input.work_cycle import STEMS, WITH_STEMS, payload
from orchestrator import run


@pytest.mark.parametrize("name", VARIANTS)
def test_force_of_the_pick_up_is_flow_times_velocity(name):
    """The force -m' v at the payload, seen as power: the accelerations change by M^-1 of it, P = -m' v^2."""
    arm, rng = Part(VARIANTS[name]), np.random.default_rng(9)
    x, speeds = arm.model.x, [i for i, n in enumerate(arm.states) if n.endswith("_speed")]
    kinetic = arm.expressions["y"]["kinetic_energy"]
    mass_matrix = arm.of(ca.hessian(kinetic, x)[0][speeds, speeds], ca.jacobian(kinetic, x))
    for _ in range(20):
        x = arm.start({"payload_mass": 100.0})
        x[speeds] = rng.uniform(-1.0, 1.0, len(speeds))
        still, without = arm(x)
        x[arm.at("payload_flow")] = 800.0
        moving, taking = arm(x)
        matrix, slope = mass_matrix(x)
        square = 2 * slope[0, arm.at("held_mass")]  # v^2, for T holds m v^2 / 2
        power = x[speeds] @ matrix @ (moving - still)[speeds]
        # exact identity, rounding only
        assert power == pytest.approx(-800.0 * square, rel=1e-9)
        heat = without["dissipated_power"] + 400.0 * square
        assert taking["dissipated_power"] == pytest.approx(heat, rel=1e-9)


# the first stem is taken up at 9.4 s and dropped at 19 s
@pytest.mark.parametrize("stop", [10.4, pytest.param(21.0, marks=shards.machine)])
def test_work_cycle_with_stems_is_that_of_the_monolith(fmu_dir, stop):
    """The FMUs with the program `work_cycle_stems`: angles, pressures and the held mass of the reference."""
    trace = run(fmu_dir / "harvester.ssp", parameters=[WITH_STEMS], stop=stop).trace
    time, levers = work_cycle(stop)
    rows = np.unique([*time, *(t - 1e-6 for s in STEMS for t in (s.start, s.start + s.hold) if t < stop)])
    inputs = {name: np.interp(rows, time, samples) for name, samples in levers.items()}
    true = played(machine(), rows, inputs | {"payload_mass": payload(STEMS, rows + 1e-9)})
    # The default master makes a ramp of 1 ms of each step of the payload: half a millisecond ahead, at up to
    # 1.1e3 kg/s 0.6 kg, measured 2.4e-4 of range. Beside it, speeds are exact to 2e-5 (docs/convergence.md).
    for name, bar in (
        ("manipulator.boom_angle", 1e-4),
        ("manipulator.swing_speed", 1e-3),
        ("manipulator.held_mass", 5e-4),
        ("boom_stick.boom_head_pressure", 2e-3),
    ):
        error = np.interp(rows, trace.time, trace[name]) - true[name]
        size = np.sqrt(np.mean(error**2)) / np.ptp(true[name])
        assert size < bar, f"{name}: {size:.2g}"
