"""The tip on its path: what is measured, what it is measured with, and what the command prints."""

import json

import numpy as np
import pytest
from kit import shards
from kit.equations import Part
from kit.mistakes import refused, table

from fmus.machine import path_following
from fmus.machine.parts import MACHINES
from fmus.machine.path_following import PathRun, differences, points, text, unwrapped
from fmus.manipulator import MANIPULATOR
from orchestrator import Trace, load
from orchestrator.__main__ import main

DETAILED = [f"--swap={part}={variant}" for part, variant in MACHINES["detailed"].items()]
ALONE = ["--no-compare", "--swap=swing=lumped"]
NAMES = path_following.HARVESTER
TIME = np.linspace(0, 4, 5)
TIP = ("tip_radius", "tip_height", "swing_angle")


def made(offset: float, feedback: bool = True, shape=(0, 0, 1, 1, 0.5), **uses: float) -> PathRun:
    """A run `offset` [m] times `shape` away from a straight path of 2 m; limits are used from 2 s on."""
    commanded = np.column_stack([np.full(5, 3.0), 0.5 * TIME, np.ones(5)])
    away = np.array(shape)[:, None] * np.array([0.6, 0.0, 0.8]) * offset
    limits = {f"controller.{name}_use": np.array([0, 0, 1, 1, 0.5]) * most for name, most in uses.items()}
    tip, more = commanded + away, {"uses": limits, "limits": path_following.LIMITS}
    return PathRun("made", "thing", feedback, TIME, commanded, tip, **more)


def through(*given: str) -> list[str]:
    """Options for points x,y,z."""
    return [f"--through={point}" for point in given]


def test_error_is_the_distance_in_space_at_the_same_instant():
    """Largest, RMS, last error and speed of a ride beside a straight path are those of the triangle 3-4-5.

    Outwards, left and upwards are the parts of the distance; a late tip has the error speed times time.
    """
    ride = made(0.01, shape=(1, 1, 1, 1, 3))
    assert ride.largest == pytest.approx(0.03, rel=1e-12, abs=0)  # exact but for rounding
    assert ride.rms == pytest.approx(0.01 * np.sqrt(13 / 5), rel=1e-12, abs=0)
    assert (ride.time_of_largest, ride.speed) == (4.0, 0.5)
    angle, away = np.linspace(-3, 3, 7), np.array([0.02, -0.01, 0.03])
    out, left = ((np.cos(angle), np.sin(angle)), (-np.sin(angle), np.cos(angle)))
    commanded = np.column_stack([4 * out[0], 4 * out[1], np.ones(7)])
    tip = commanded + np.column_stack([np.array([out, left]).T @ away[:2], np.full(7, away[2])])
    parts = PathRun("", "", True, np.arange(7.0), commanded, tip).components
    assert parts == pytest.approx(np.tile(away, (7, 1)), abs=1e-12)  # rounding of turns there and back
    time = np.linspace(0, 4, 401)
    at = [np.column_stack([np.full(401, 3.0), 0.5 * (time - late), np.ones(401)]) for late in (0.0, 0.1)]
    assert PathRun("", "", True, time, *at).largest == pytest.approx(0.05, rel=1e-12, abs=0)


def test_places_are_those_of_the_manipulator():
    """Radius, height and swing angle give the place that the manipulator tells in x, y and z."""
    arm, rng = Part(MANIPULATOR), np.random.default_rng(1)
    for swing, boom, stick in rng.uniform([-3, -0.4, -2.1], [3, 1.0, -0.7], (20, 3)):
        y = arm(np.array([swing, boom, stick, 0, 0, 0, 0, 0]))[1]
        found = points(Trace(np.zeros(1), {n: np.array([y[n]]) for n in TIP}), TIP, "")[0]
        place = [y[n] for n in ("tip_x", "tip_y", "tip_height")]
        assert found == pytest.approx(place, abs=1e-12)  # rounding


# ---- the command


@pytest.fixture
def track(fmu_dir, tmp_path):
    """track(*arguments): the status of `harvester track`, and what it writes about its runs."""

    def tracked(*arguments: str) -> tuple[int, list[dict]]:
        status = main(["track", str(fmu_dir / "harvester_control.ssp"), *arguments, "--out", str(tmp_path)])
        return status, json.loads((tmp_path / "tracking.json").read_text())["runs"]

    return tracked


def test_command_keeps_the_bars(track, tmp_path, capsys):
    """Line and square at 0.5 m/s: within 30 mm and 10 mm RMS, and five times as far off without feedback."""
    status, told = track("--swap", "swing=lumped", "--limit", "30")
    assert status == 0
    by = {(r["path"], r["feedback"]): r for r in told}
    for path in ("line", "square"):
        near, far = by[path, True], by[path, False]
        assert near["highest speed asked for [m/s]"] == pytest.approx(0.5, rel=1e-3)  # sampled at 200 Hz
        assert near["RMS error [m]"] < 0.010  # the bar; 1.7 mm and 2.6 mm are usual
        for kind in ("largest error [m]", "RMS error [m]"):
            assert far[kind] > 5 * near[kind]
    assert "times as large" in capsys.readouterr().out
    assert (tmp_path / "tracking.png").stat().st_size > 20_000  # a picture, not an empty one


@shards.machine
def test_command_keeps_the_bar_of_the_detailed_machine(track):
    """With hoses, spools, friction, a swinging head and a real supply the tip stays within 60 mm."""
    assert track(*DETAILED, "--no-compare", "--limit", "60")[0] == 0


def test_a_longer_stick_and_a_plain_table_start_on_the_path(track, tmp_path):
    """Another length in machine and controller; time and places alone, whose corners cost centimetres."""
    longer = [f"--set={part}.stick_length=3.3" for part in ("manipulator", "controller")]
    assert track("--path", "square", *ALONE, *longer, "--limit", "30")[0] == 0
    path = tmp_path / "mine.csv"
    path.write_text("time,path_radius,path_height,path_angle\n0,4,1,0\n2,4,1,0\n4,4,1.5,0.1\n6,4,1.5,0.1\n")
    assert track("--path", str(path), *ALONE, "--limit", "40")[0] == 0


def test_an_angle_that_jumps_by_a_turn_is_the_same_path():
    """Of arctan2, or of 0 to 360 degrees; a turn that takes a second or more is a turn."""
    time = np.arange(0, 8, 0.02)
    angle = np.pi + 0.9 * np.sin(time)
    for wrapped in (np.angle(np.exp(1j * angle)), 2 * angle % (2 * np.pi)):
        found = unwrapped(Trace(time, {"a": wrapped}), "a")["a"]
        scale = 2 if wrapped.min() >= 0 else 1
        np.testing.assert_allclose(np.diff(found), scale * np.diff(angle), atol=1e-12)  # rounding
    for duration, turned in ((0.99, 0.0), (1.01, 2 * np.pi)):
        turn = Trace(np.array([0.0, duration]), {"a": np.array([0.0, 2 * np.pi])})
        assert unwrapped(turn, "a")["a"][1] == turned


def test_a_missed_limit_a_speed_not_reached_and_a_load_not_carried_are_told(track, capsys):
    """A limit that cannot be met gives status 1 and a line with path, limit and error.

    On 1 m from rest to rest at 0.5 m/s2 no 20 m/s are reached; a pump that senses loads is at standby.
    """
    status, told = track(*through("4,0,1", "4,1,1"), *ALONE, "--speed", "20", "--limit", "0.01")
    assert status == 1
    asked, printed = told[0]["highest speed asked for [m/s]"], capsys.readouterr().out
    assert "expected at most 0.01 mm, got " in printed
    assert f"note: --speed 20: the path is too short for more than {asked:.2g} m/s" in printed
    slow = ("--no-compare", "--swap=supply=load_sensing", "--speed", "0.3")
    assert track(*through("4,0,1", "4,0,2"), *slow)[0] == 0
    printed = capsys.readouterr().out
    assert ": the supply pressure does not carry the load, from" in printed
    assert "--speed" not in printed  # it is reached


@table(__file__, "mistakes", "arguments, message")
def test_mistakes_are_told_in_one_line(fmu_dir, tmp_path, capsys, arguments, message):
    """A mistake on the command line ends with status 2 and one line that names it."""
    command = ["track", fmu_dir / "harvester_control.ssp", *arguments, "--out", tmp_path]
    assert message in refused(capsys, command)


def test_a_scenario_without_a_path_and_a_machine_without_a_controller_are_told(fmu_dir, tmp_path, capsys):
    """A scenario with other columns is named; a machine with levers alone, and one that can be tracked."""
    other = tmp_path / "other.csv"
    other.write_text("time,boom_command\n0,0\n1,1\n")
    told = refused(capsys, ["track", fmu_dir / "harvester_control.ssp", "--path", other])
    assert "other.csv: expected path_radius, path_height, path_angle" in told
    told = refused(capsys, ["track", fmu_dir / "harvester.ssp", "--out", tmp_path])
    assert "expected a machine with the controller, such as build/harvester_control.ssp, got" in told


# ---- large errors, other machines


@table(__file__, "causes", "uses, cause")
def test_the_cause_is_the_limit_that_is_exceeded_most(uses, cause):
    """Strokes and speed act above 1, the wait above a half; the sentence tells the largest and when."""
    told = text([made(0.3, **uses)])
    assert f"made, thing: the tip is up to 0.30 m away, 0.15 m at the end: {cause}" in told


def test_compensated_drives_are_the_controllers(track, capsys):
    """The command gives the controller the section flows of the drives; another value has a note."""
    swaps = [f"--swap={part}=compensated" for part in ("swing", "boom_stick")]
    line = [*through("4,0,1", "4,0.1,1"), "--no-compare", *swaps]
    assert track(*line, "--limit", "30")[0] == 0
    assert "the controller assumes another machine" not in capsys.readouterr().out
    track(*line, "--set=boom_stick.boom_section_flow=0.002")
    assert "note: controller.boom_section_flow is 0.0027 m3/s, boom_stick" in capsys.readouterr().out


def test_a_tip_near_its_path_needs_no_cause():
    """A tip 3 cm away has no line of its own; without numbers of the controller none has a cause."""
    assert "the tip is" not in text([made(0.03, stroke=400)])
    assert text([made(0.3)]).endswith("0.15 m at the end")


def test_a_machine_that_differs_from_the_controllers_is_noted(fmu_dir):
    """As built nothing differs; each other value has a note, a value of 0 with its meaning."""
    system = load(fmu_dir / "harvester_control.ssp")
    assert differences(system, NAMES) == []
    longer = system.with_start({"manipulator.stick_length": 3.2, "swing.valve_area": 3e-5})
    told, of = differences(longer, NAMES), ": the controller assumes another machine"
    assert told == [
        f"controller.stick_length is 2.9 m, manipulator.stick_length is 3.2 m{of}",
        f"controller.swing_valve_area is 4e-05 m2, swing.valve_area is 3e-05 m2{of}",
    ]
    line = system.with_start({"controller.line_capacitance": 1e-12, "swing.line_capacitance": 0.0})
    (note,) = differences(line, NAMES)
    assert "swing.line_capacitance is 0 m3/Pa (Capacitance C" in note
    both = longer.with_start({"controller.stick_length": 3.2, "controller.swing_valve_area": 3e-5})
    assert differences(both, NAMES) == []
