"""The machine with identified numbers."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from identification.procedures.bench import changed
from kit.mistakes import problem
from kit.work_cycle import REFERENCE

from fmus.identification.machine import COMMANDS
from fmus.identification.report import prediction
from fmus.identification.report.attribution import candidate_effects
from fmus.identification.report.prediction import Excitation, excitation, predict, simplify
from fmus.machine.poses import NOMINAL, POSES
from fmus.operator_input.work_cycle import Move
from orchestrator.data.recording import Recording, Sensor

POSE = {joint: getattr(POSES[NOMINAL], joint) for joint in ("swing", "boom", "stick")}
STOP = 4.0  # s
SIGNALS = ("manipulator.boom_angle", "swing.swing_pressure_a", "boom_stick.stick_rod_pressure")


def test_default_parameters_give_the_reference_trace():
    """Without estimates the prediction is the trace of the machine, which a separate simulation wrote."""
    reference = {name: column[REFERENCE["time"] <= STOP] for name, column in REFERENCE.items()}
    commands = {name: reference[signal] for name, signal in COMMANDS.items()}
    outputs = predict(Excitation(reference["time"], commands, POSE), {})
    for name in SIGNALS:
        expected = reference[name]
        # integrator error: the trace was made at 1e-11, the prediction at 1e-8 per step
        np.testing.assert_allclose(outputs[name], expected, atol=1e-5 * np.ptp(expected))


T = np.arange(0.0, 2.0, 0.005)  # s


def standing(command: np.ndarray, **more: np.ndarray) -> Recording:
    """Two seconds in the usual pose with one command on all levers; `more`: signals of the swing."""
    signals = {f"manipulator.{j}_angle": np.full(T.size, a) for j, a in POSE.items()}
    signals |= dict.fromkeys(COMMANDS.values(), command) | {f"swing.{n}": x for n, x in more.items()}
    return Recording(T, signals, {}, Path("x.csv"), procedure="machine", use="test")


def boom_motion(stop: float = 1.5) -> Excitation:
    time = np.arange(0.0, stop, 0.01)
    move = Move("boom", 0.2, 3.0, 0.2, 0.5, 0.2).sample(time)
    still = np.zeros_like(time)
    return Excitation(time, {"swing_command": still, "boom_command": move, "stick_command": still}, POSE)


def test_a_variant_does_not_need_all_parameters():
    """Parameters of the default part that its variant does not have are left out."""
    found = predict(boom_motion(), {"boom_stick.boom_hose_inertance": 1e7}, {"boom_stick": "detailed"})
    assert np.isfinite(found["manipulator.boom_angle"]).all()


def test_a_recording_gives_the_excitation():
    """Commands, pose and supply pressure come from the recording, and their noise is averaged."""
    rng = np.random.default_rng(0)
    angles = {f"manipulator.{j}_angle": a + 1e-4 * rng.standard_normal(T.size) for j, a in POSE.items()}
    supply = 2e7 + 1e4 * rng.standard_normal(T.size)
    recording = changed(standing(np.where(T > 1.0, 2.0, 0.0), supply_pressure=supply), angles)
    found = excitation(recording)
    # measurement noise: mean of 100 samples, five standard deviations
    assert found.pose == pytest.approx(POSE, abs=5e-5)
    # the lines through the smoothed pressure may be 0.5 bar off
    np.testing.assert_allclose(found.lines["supply_pressure"], 2e7, atol=6e4)
    loud = changed(recording, {"swing.supply_pressure": rng.normal(2e7, 2e6, T.size)})
    left = excitation(loud).lines["supply_pressure"].std() / 2e6
    # cubic over 11 samples: 89/429 of the variance [Savitzky and Golay, table I]; 400 samples, 40 independent
    assert left == pytest.approx(np.sqrt(89 / 429), rel=0.15)


@pytest.mark.parametrize(("volts", "pressure"), [(0.8e-4, 4e4), (1.2e-4, 6e4)])
def test_small_corners_of_inputs_are_left_out(volts, pressure):
    """A tenth of a millivolt and half a bar: a bump that is less is a straight line, a larger one is not."""
    bump = np.interp(T, [0.5, 0.9, 1.1, 1.5], [0.0, 1.0, 1.0, 0.0])
    found = excitation(standing(volts * bump, supply_pressure=pressure * bump))
    kept = volts > 1e-4
    assert found.commands["boom_command"].any() == kept
    assert (np.ptp(found.lines["supply_pressure"]) > 0.5 * pressure) == kept


def test_gaps_of_a_command_are_filled_or_refused():
    """Ten missing samples have no effect, half a second of them is refused, as is a pose without samples."""
    ramp = np.interp(T, [0.5, 1.5], [0.0, 4.0])
    short, long = (np.where((T >= 1) & (end > T), np.nan, ramp) for end in (1.05, 1.5))
    recording = standing(short)
    # straight lines through the samples may be off by this
    room = prediction.COMMAND_TOLERANCE
    np.testing.assert_allclose(excitation(recording).commands["boom_command"], ramp, atol=room)
    for name, values, message in (
        (COMMANDS["boom_command"], long, r"boom_command: expected gaps of .* got one from 1 s to 1\.495 s"),
        ("manipulator.swing_angle", np.where(T < 1, np.nan, 0.0), "swing_angle: expected a sample in the"),
    ):
        read = changed(recording, {name: values})
        problem(lambda read=read: excitation(read), message)


def test_a_measured_supply_pressure_drives_the_machine():
    """A weak supply moves the boom more slowly; pump and engine are then not among the effects."""
    weak = replace(boom_motion(), lines={"supply_pressure": np.full(boom_motion().time.size, 8e6)})
    found, usual = (np.ptp(predict(e, {})["manipulator.boom_angle"]) for e in (weak, boom_motion()))
    assert found < 0.8 * usual
    assert set(candidate_effects(boom_motion())) - set(candidate_effects(weak)) == {"pump and engine"}


@given(st.lists(st.floats(-10, 10), min_size=2, max_size=40), st.floats(0, 1))
def test_straight_lines_stay_within_the_tolerance(values, tolerance):
    """No sample changes by more than the tolerance, and the ends do not change."""
    samples = np.array(values)[:, None]
    time = np.arange(len(values)) * 0.005
    found = simplify(time, samples, tolerance)
    # exact identity: rounding only
    assert np.abs(found - samples).max() <= tolerance + 1e-12
    np.testing.assert_array_equal(found[[0, -1]], samples[[0, -1]])


def driven(*commands: float, ramp: int = 0, sd: float = 0.0) -> Recording:
    """Commands [V] that are held for 100 samples each, with ramps between them."""
    corners = np.cumsum([0, *(n for _ in commands for n in (99, 1 + ramp))])[:-1]
    volts = np.interp(np.arange(corners[-1] + 1), corners, np.repeat(commands, 2))
    volts += sd * np.random.default_rng(0).standard_normal(volts.size)
    time, units, sensors = np.arange(volts.size) / 100, {"command": "V"}, {"command": Sensor(noise=sd)}
    return Recording(time, {"command": volts}, units, Path("a.csv"), sensors=sensors)


@pytest.mark.parametrize(
    ("training", "predicted", "told"),
    [
        (driven(0, 3, 5, -3), driven(0, 4, -3, ramp=2), []),  # in between, after a fast ramp from zero
        (driven(0, 3, 5, -3), driven(0, 1, 4), ["command is 1 V, in training 3 to 5 V"]),
        (driven(0, 3, 5), driven(0, -4), ["command is -4 V, in training no value of this sign"]),
        (driven(0, 5, -5, -2), driven(0, 5, -6), ["command is -6 V, in training -5 to -2 V"]),
        (driven(0, 5, ramp=90), driven(0, 1, 4, 0.2), []),  # a slow ramp shows all values
        (driven(0, 5), driven(0, 5.03), []),  # 1 % farther
        (driven(0, 5), driven(0, 5.07), ["command is 5.07 V, in training 5 to 5 V"]),
        (driven(0, 3, 5), driven(0, *12 * [4], 1), ["command is 1 V, in training 3 to 5 V"]),  # for 8 %
        (driven(5, 5, sd=0.1), driven(5, 5, 5, 5, sd=0.1), []),  # noise is no range
    ],
)
def test_inputs_outside_their_range_in_training_are_told(training, predicted, told):
    """Farther from zero than ever, or nearer for long; each sign by itself; other signals do not count."""
    found = prediction.extrapolations(predicted, {"command": training["command"]}, ["command", "missing"])
    assert [str(extrapolation) for extrapolation in found] == told


def test_rounding_makes_no_corners():
    """A ramp that was written with six digits becomes one straight line."""
    time = np.arange(0.0, 4.0, 0.005)
    move = Move("boom", 0.5, 3.3, 0.7, 1.1, 0.6).sample(time)
    found = simplify(time, np.round(move, 5)[:, None])[:, 0]
    corners = np.abs(np.diff(found, 2)) > 1e-9
    assert corners.sum() <= 8  # four corners, each between two samples at most
    assert np.abs(found - move).max() < prediction.COMMAND_TOLERANCE
