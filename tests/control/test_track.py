"""The tip on its path: what is measured, what it is measured with, and what the command tells."""

from __future__ import annotations

import json

import numpy as np
import pytest

from fmus.contract import quantities, symbolic
from fmus.controller.paths import start_angles
from fmus.manipulator import MANIPULATOR
from fmus.parameters import values
from orchestrator.__main__ import main
from orchestrator.data.trace import Trace
from orchestrator.studies.path_following import PathRun, points
from orchestrator.studies.path_study import rows

DETAILED = [
    "--swap", "swing=detailed", "--swap", "boom_stick=detailed",
    "--swap", "manipulator=pendulum_friction", "--swap", "supply=engine_pump",
]  # fmt: skip


def made(offset: float, feedback: bool) -> PathRun:
    """A run `offset` [m] away from a straight path of 2 m, and 3 `offset` at the end."""
    time = np.linspace(0, 4, 5)
    commanded = np.column_stack([np.full(5, 3.0), 0.5 * time, np.ones(5)])
    away = np.array([1, 1, 1, 1, 3])[:, None] * np.array([0.6, 0.0, 0.8]) * offset
    return PathRun("made", "thing", feedback, time, commanded, commanded + away)


def test_error_is_the_distance_in_space_at_the_same_instant():
    """Largest, RMS, last error and speed of a ride beside a straight path are those of the triangle 3-4-5."""
    ride = made(0.01, True)
    assert ride.largest == pytest.approx(0.03, rel=1e-12, abs=0)  # exact but for rounding
    assert ride.rms == pytest.approx(0.01 * np.sqrt(13 / 5), rel=1e-12, abs=0)
    assert (ride.time_of_largest, ride.speed) == (4.0, 0.5)


def test_parts_of_the_error_are_seen_from_the_column():
    """Outwards, to the left and upwards are the parts of the distance, whatever the swing angle."""
    angle, away = np.linspace(-3, 3, 7), np.array([0.02, -0.01, 0.03])
    out, left = ((np.cos(angle), np.sin(angle)), (-np.sin(angle), np.cos(angle)))
    commanded = np.column_stack([4 * out[0], 4 * out[1], np.ones(7)])
    tip = commanded + np.column_stack(
        [away[0] * out[i] + away[1] * left[i] for i in (0, 1)] + [np.full(7, away[2])]
    )
    parts = PathRun("", "", True, np.arange(7.0), commanded, tip).components
    assert parts == pytest.approx(np.tile(away, (7, 1)), abs=1e-12)  # rounding of turns there and back


def test_a_tip_that_is_late_has_an_error():
    """A tip that is late on its line has the error speed times time, not that to the nearest point."""
    time = np.linspace(0, 4, 401)
    at = [np.column_stack([np.full(401, 3.0), 0.5 * (time - late), np.ones(401)]) for late in (0.0, 0.1)]
    assert PathRun("", "", True, time, *at).largest == pytest.approx(0.05, rel=1e-12, abs=0)


def test_places_are_those_of_the_manipulator():
    """Radius, height and swing angle give the place that the manipulator tells in x, y and z."""
    model, v = symbolic(MANIPULATOR), values(MANIPULATOR)
    angles = np.random.default_rng(1).uniform([-3, -0.4, -2.1], [3, 1.0, -0.7], (20, 3))
    for swing, boom, stick in angles:
        x = [swing, boom, stick, 0, 0, 0, 0, 0]
        y = model.function()(x, list(v.u.values()), list(v.p.values()))[1].full()[:, 0]
        told = dict(zip(quantities(MANIPULATOR.outputs), y, strict=True))
        trace = Trace(
            np.zeros(1), {n: np.array([told[n]]) for n in ("tip_radius", "tip_height", "swing_angle")}
        )
        found = points(trace, ("tip_radius", "tip_height", "swing_angle"), "")[0]
        assert found == pytest.approx(
            [told[n] for n in ("tip_x", "tip_y", "tip_height")], abs=1e-12
        )  # rounding


def test_table_tells_how_many_times_as_large_without_feedback():
    """The last cell of the row without feedback is its largest error over that of the ride with feedback."""
    assert [row[-1] for row in rows([made(0.01, True), made(0.07, False)])] == ["", "7.0"]


def test_start_puts_the_tip_to_the_path():
    """With the start angles of a path the manipulator has its tip at the path's first point."""
    v, model = values(MANIPULATOR), symbolic(MANIPULATOR)
    p = {**v.p, **{n.partition(".")[2]: a for n, a in start_angles("path", (4.2, 0.7, 0.3), {}).items()}}
    x = model.initial()(list(v.x.values()), list(v.u.values()), list(p.values()))
    y = model.function()(x, list(v.u.values()), list(p.values()))[1].full()[:, 0]
    told = dict(zip(quantities(MANIPULATOR.outputs), y, strict=True))
    found = told["tip_radius"], told["tip_height"], told["swing_angle"]
    assert found == pytest.approx((4.2, 0.7, 0.3), abs=1e-12)  # both closed forms


def test_a_longer_stick_starts_on_the_path_too(fmu_dir, tmp_path):
    """Where machine and controller have another length, the ride begins at its path and stays near it."""
    longer = [f"--set={part}.stick_length=3.3" for part in ("manipulator", "controller")]
    given = ["--path", "square", "--no-compare", "--swap", "swing=lumped", *longer, "--limit", "30"]
    assert main(["track", str(fmu_dir / "harvester_control.ssp"), *given, "--out", str(tmp_path)]) == 0


def test_command_keeps_the_bars(fmu_dir, tmp_path, capsys):
    """Line and square at 0.5 m/s: within 30 mm and 10 mm RMS, and five times as far off without feedback."""
    assert main(["track", str(fmu_dir / "harvester_control.ssp"), "--swap", "swing=lumped", "--limit", "30",
                 "--out", str(tmp_path)]) == 0  # fmt: skip
    told = json.loads((tmp_path / "tracking.json").read_text())
    by = {(r["path"], r["feedback"]): r for r in told}
    for path in ("line", "square"):
        near, far = by[path, True], by[path, False]
        assert near["highest speed asked for [m/s]"] == pytest.approx(0.5, rel=1e-3)  # sampled at 200 Hz
        assert near["RMS error [m]"] < 0.010  # the bar; 1.7 mm and 2.6 mm are usual
        assert far["largest error [m]"] > 5 * near["largest error [m]"]
    assert "times as large" in capsys.readouterr().out
    assert (tmp_path / "tracking.png").stat().st_size > 20_000  # a picture, not an empty one


def test_command_keeps_the_bar_of_the_detailed_machine(fmu_dir, tmp_path):
    """With hoses, spools, friction, a swinging head and a real supply the tip stays within 60 mm."""
    system = str(fmu_dir / "harvester_control.ssp")
    assert main(["track", system, *DETAILED, "--no-compare", "--limit", "60", "--out", str(tmp_path)]) == 0


def test_a_missed_limit_is_reported(fmu_dir, tmp_path, capsys):
    """A limit that cannot be met gives status 1 and a line with path, limit and error."""
    through = [a for point in ("4,0,1", "4,0.5,1") for a in ("--through", point)]
    system = str(fmu_dir / "harvester_control.ssp")
    assert main(["track", system, *through, "--no-compare", "--swap", "swing=lumped", "--limit", "0.01",
                 "--out", str(tmp_path)]) == 1  # fmt: skip
    assert "expected at most 0.01 mm, got " in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["--through", "3,0,1"], "expected two points or more, got one"),
        (["--through", "3,0", "--through", "3,1,1"], "--through 3,0: expected x,y,z in metres"),
        (["--through", "3,0,1", "--through", "-3,0,1"], "from the swing axis, expected at least 0.1 m"),
        (["--through", "0,0,3", "--through", "3,0,1"], "path: 0 m from the swing axis, expected at"),
        (["--swap", "swing=lumped", "--set", "manipulator.initial_boom_angle=1.4"],
         "machine swing=lumped, path line"),
        (["--through", "3,0"], "--through 3,0: expected x,y,z in metres"),
        (["--through", "3,0,0", "--through", "9,0,0"], "--through 9,0,0: tip at radius 9 m, height"),
        (["--through", "3,0,1", "--through", "4,0,1", "--set", "swing.valve_dead_ban=1"],
         "harvester: unknown variable 'swing.valve_dead_ban'; did you mean swing.valve_dead_band"),
        (["--set", "swing.valve_dead_band=0.5"], "the detailed machine has no such variable, only the"),
        (["--set", "swing.valve_dead_band=0.5"], "alone: --swap swing=lumped, for example"),
        (["--set", "swing.spool_damping=1"], "alone: --swap swing=detailed, for example"),
        (["--through", "9,0,1", "--through", "3,1,1"], "is 9.18 m from the boom pivot, expected"),
        (["--through", "3,0,1", "--through", "3,0,1"], "expected different ones"),
        (["--path", "line", "--through", "3,0,1"], "--path and --through: expected one of them"),
        (["--path", "no.csv"], "no.csv"),
        (["--path", "circle"], "--path circle: expected line, square or a file"),
        (["--through", "3,0,1", "--through", "4,0,1", "--speed", "0"], "--speed 0: expected more than 0 m/s"),
    ],
)  # fmt: skip
def test_mistakes_are_told_in_one_line(fmu_dir, tmp_path, capsys, arguments, told):
    """A mistake on the command line ends with status 2 and one line that names it."""
    assert main(["track", str(fmu_dir / "harvester_control.ssp"), *arguments, "--out", str(tmp_path)]) == 2
    error = capsys.readouterr().err
    assert told in error
    assert error.count("\n") == 1


def test_a_scenario_without_a_path_is_told(fmu_dir, tmp_path, capsys):
    """A scenario with other columns is named, with what was expected."""
    other = tmp_path / "other.csv"
    other.write_text("time,boom_command\n0,0\n1,1\n")
    assert main(["track", str(fmu_dir / "harvester_control.ssp"), "--path", str(other)]) == 2
    assert "other.csv: expected path_radius, path_height, path_angle" in capsys.readouterr().err


def test_a_machine_without_a_controller_is_told(fmu_dir, tmp_path, capsys):
    """The usual machine has levers: the message names a system that can be tracked."""
    assert main(["track", str(fmu_dir / "harvester.ssp"), "--out", str(tmp_path)]) == 2
    assert (
        "expected a machine with the controller, such as build/harvester_control.ssp, got"
        in capsys.readouterr().err
    )


def test_a_plain_table_of_places_is_a_path(fmu_dir, tmp_path):
    """Time and places alone: the controller is engaged and follows; corners in it cost some centimetres."""
    path = tmp_path / "mine.csv"
    path.write_text("time,path_radius,path_height,path_angle\n0,4,1,0\n2,4,1,0\n4,4,1.5,0.1\n6,4,1.5,0.1\n")
    given = ["--path", str(path), "--no-compare", "--swap", "swing=lumped", "--limit", "40"]
    assert main(["track", str(fmu_dir / "harvester_control.ssp"), *given, "--out", str(tmp_path)]) == 0
