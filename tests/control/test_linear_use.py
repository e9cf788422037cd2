"""Linear models as a user meets them: names, notes, the loop of a controller, mistakes."""

import re

import numpy as np
from kit import mistakes
from kit.any_fmu.edit import edited
from kit.steering import IDEAL

from orchestrator import linearize


def test_modes_are_named_by_their_states(fmu_dir):
    """Joints on their oil, a swing that stays where it is; unique names; the text tells what stays."""
    linear = linearize(fmu_dir / "harvester.ssp", parameters=["reach"], steady=True)
    named = {m.name: m for m in linear.modes}
    assert len(named) == len(linear.modes)
    assert named["integrator of swing"].value == 0.0
    assert named["position decay of boom"].main_states == ("boom_angle",)
    assert named["hydraulic oscillation of swing"].main_states[0] == "swing_speed"
    assert "marginally stable: integrator of swing" in linear.text()
    told = "at this operating point no state depends on swing_command (possible causes: dead band, command "
    assert any(note.startswith(told) for note in linear.notes)


def test_a_steady_state_holds_the_joints_whatever_the_inputs_are(fmu_dir):
    """With the supply pressure alone as input the commands are found all the same, as with all inputs."""
    system = fmu_dir / "harvester.ssp"
    one = linearize(system, parameters=["reach"], inputs=["supply_pressure"], steady=True)
    every = linearize(system, parameters=["reach"], steady=True)
    assert [i.name for i in one.inputs] == ["supply_pressure"]
    assert one.b.shape == (len(one.states), 1)
    assert one.d.shape == (len(one.outputs), 1)
    assert f"boom_command = {every.u0[1]:.6g} V" in " ".join(one.notes)
    np.testing.assert_array_equal(one.a, every.a)


def test_a_loop_that_is_open_at_the_point_is_told(fmu_dir):
    """A swing at rest is in its dead band, which opens its loop; with all joints moving all are closed."""
    system = fmu_dir / "harvester_control.ssp"
    rest = linearize(system, parameters=["reach"], set={"engaged": 1.0} | IDEAL, time=3.0)
    moving = IDEAL | {"engaged": 1.0, "radial_velocity": -0.3, "swing_velocity": 0.3}
    moves = linearize(system, parameters=["reach"], set=moving, time=2.0)
    told = "at this operating point loops are open at valve_actuation.swing_valve_command"
    assert any(told in note for note in rest.notes)
    assert not any("loops are open" in note for note in moves.notes)


def test_a_scenario_drives_inputs_that_are_no_inputs_of_the_model(fmu_dir):
    """The boom is at rest in the scenario and moves in the work cycle: its valve is closed in the model."""
    system, held = fmu_dir / "harvester.ssp", {"time": [0.0, 2.5], "swing_command": [2.0, 2.0]}
    still = {"boom_command": [0.0, 0.0], "stick_command": [0.0, 0.0]}
    point = {"scenario": held | still, "time": 1.5, "outputs": ["swing.*", "boom_stick.*"]}
    one = linearize(system, inputs=["swing_command"], **point)
    every = linearize(system, inputs=["swing_command", "boom_command", "stick_command"], **point)
    assert [s.name for s in one.states] == [s.name for s in every.states]
    np.testing.assert_array_equal(one.a, every.a)
    np.testing.assert_array_equal(one.y0, every.y0)


def test_a_loop_that_is_cut_and_closed_again_is_the_closed_loop(fmu_dir):
    """Tip moving inwards: cut at the command of the boom, then u = y, A is that of the whole."""
    system = fmu_dir / "harvester_control.ssp"
    point = {"parameters": ["reach"], "set": {"engaged": 1.0, "radial_velocity": -0.3}, "time": 1.0}
    whole = linearize(system, inputs=["radial_velocity"], **point)
    ends = {"inputs": ["valve_actuation.boom_command"], "outputs": ["controller.boom_command"]}
    cut = linearize(system, **ends, **point)
    assert cut.states == whole.states
    assert cut.b.any()
    assert whole.b.any()
    assert not np.array_equal(cut.a, whole.a)
    closed = cut.a + cut.b @ cut.c
    assert np.abs(closed - whole.a).max() <= 1e-15 * np.abs(whole.a).max()  # one sum more or less: rounding


@mistakes.table(__file__, "mistakes", "options, message")
def test_mistakes_are_told_in_one_line(fmu_dir, options, message):
    """Each mistake names the thing and what was expected."""
    told = mistakes.problem(lambda: linearize(fmu_dir / "harvester.ssp", **options))
    assert re.search(message, told), told


def test_what_other_systems_lack_is_told(fmu_dir, tmp_path):
    """Lever and velocity of a controller have a joint's name; without model exchange no state is chosen."""
    told = r"--steady: .*swing_velocity, swing_lever: use a time of a run instead, with --time"
    mistakes.problem(lambda: linearize(fmu_dir / "harvester_control.ssp", steady=True), told)
    fmu = edited(fmu_dir / "swing.fmu", tmp_path / "swing.fmu", ("<ModelExchange.*?</ModelExchange>", ""))
    told = "expected an FMU for model exchange, got one for co-simulation only"
    mistakes.problem(lambda: linearize(fmu), told)
