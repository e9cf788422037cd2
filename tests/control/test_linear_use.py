"""Linear models as a user meets them: names, notes, the loop of a controller, mistakes."""

import numpy as np
import pytest

from orchestrator import Problem, linearize
from orchestrator.linear.command import text


def test_modes_are_named_by_their_states(fmu_dir):
    """Joints on their oil, a swing that stays where it is; unique names; the text tells what stays."""
    linear = linearize(fmu_dir / "harvester.ssp", ["reach"], steady=True)
    named = {m.name: m for m in linear.modes}
    assert len(named) == len(linear.modes)
    assert named["swing stays where it is"].value == 0.0
    assert named["boom returns to its place"].members == ("boom_angle",)
    assert named["swing on its oil"].members[0] == "swing_speed"
    assert "stable; on the limit: swing stays where it is" in text(linear)
    assert any("no state depends here on swing_command" in note for note in linear.notes)


def test_a_steady_state_holds_the_joints_whatever_the_inputs_are(fmu_dir):
    """With the supply pressure alone as input the commands are found all the same, as with all inputs."""
    system = fmu_dir / "harvester.ssp"
    one = linearize(system, ["reach"], ["supply_pressure"], steady=True)
    every = linearize(system, ["reach"], steady=True)
    assert [i.name for i in one.inputs] == ["supply_pressure"]
    assert one.b.shape == (len(one.states), 1)
    assert one.d.shape == (len(one.outputs), 1)
    assert f"boom_command = {every.u0[1]:.6g} V" in " ".join(one.notes)
    np.testing.assert_array_equal(one.a, every.a)


def test_a_loop_that_is_cut_and_closed_again_is_the_closed_loop(fmu_dir):
    """Tip moving inwards: cut at the command of the boom, then u = y, A is that of the whole."""
    system = fmu_dir / "harvester_control.ssp"
    point = {"parameters": ["reach"], "set": {"engaged": 1.0, "radial_velocity": -0.3}, "time": 1.0}
    whole = linearize(system, inputs=["radial_velocity"], **point)
    cut = linearize(system, inputs=["boom_command"], outputs=["controller.boom_command"], **point)
    assert cut.states == whole.states
    assert cut.b.any()
    assert whole.b.any()
    assert not np.array_equal(cut.a, whole.a)
    closed = cut.a + cut.b @ cut.c
    assert np.abs(closed - whole.a).max() <= 1e-15 * np.abs(whole.a).max()  # one sum more or less: rounding


ERRORS = {
    "parameter set 'reech' is unknown; did you mean reach": {"parameters": ["reech"]},
    "unknown variable 'boom_comand'; did you mean": {"inputs": ["boom_comand"]},
    "--input boom_command_rate: it only carries": {"inputs": ["boom_command_rate"]},
    "--output \\*angel: no output fits": {"outputs": ["*angel"]},
    "--speed head: no such joint, expected swing, boom, stick": {"steady": True, "speeds": {"head": 1.0}},
    "--speed: expected --steady": {"speeds": {"boom": 0.1}},
    "--time -1: expected a time from 0 s on": {"time": -1.0},
    "--speed boom=nan: expected a finite number": {"steady": True, "speeds": {"boom": float("nan")}},
    "--time 0.0015: expected a multiple of the communication step": {"time": 0.0015},
    "--set tank_pressure: fed by supply.tank_pressure .*; expected --input": {"set": {"tank_pressure": 1e5}},
    "--set boom_command: fed by levers.*; expected --scenario": {"set": {"boom_command": 3.0}, "time": 1.0},
    "no steady state found with .*boom_speed = 9": {"steady": True, "speeds": {"boom": 9.0}},
}


@pytest.mark.parametrize("message", ERRORS)
def test_mistakes_are_told_in_one_line(fmu_dir, message):
    """Each mistake names the thing and what was expected."""
    with pytest.raises(Problem, match=message) as told:
        linearize(fmu_dir / "harvester.ssp", **ERRORS[message])
    assert "\n" not in str(told.value)


def test_two_inputs_of_one_joint_are_told(fmu_dir):
    """Lever and velocity of a controller both have a joint's name: which one holds it has to be said."""
    with pytest.raises(Problem, match=r"--steady: .*swing_velocity, swing_lever: name one with --input"):
        linearize(fmu_dir / "harvester_control.ssp", steady=True)


def test_an_fmu_for_co_simulation_only_is_told(fmu_dir, tmp_path):
    """Without model exchange nobody can choose the states."""
    from any_fmu.edit import edited

    fmu = edited(fmu_dir / "swing.fmu", tmp_path / "swing.fmu", ("<ModelExchange.*?</ModelExchange>", ""))
    with pytest.raises(
        Problem, match="expected an FMU for model exchange as well, got one for co-simulation"
    ):
        linearize(fmu)
