"""Messages of `harvester track` about large errors and other machines, and its figure."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from orchestrator.__main__ import main
from orchestrator.ssp.load import load
from orchestrator.studies.path_figure import draw, side_view, top_view
from orchestrator.studies.path_following import PathRun
from orchestrator.studies.path_study import differences, text

TIME = np.linspace(0, 4, 5)
STROKE = "controller.stroke_use"


def made(offset: float, **uses: float) -> PathRun:
    """A run up to `offset` [m] away from a straight path of 2 m; limits are reached from 2 s on."""
    commanded = np.column_stack([np.full(5, 3.0), 0.5 * TIME, np.ones(5)])
    away = np.array([0, 0, 1, 1, 0.5])[:, None] * np.array([0.6, 0.0, 0.8]) * offset
    limits = {f"controller.{name}_use": np.array([0, 0, 1, 1, 0.5]) * most for name, most in uses.items()}
    return PathRun("made", "thing", True, TIME, commanded, commanded + away, uses=limits)


@pytest.mark.parametrize(
    ("uses", "cause"),
    [
        ({"stroke": 400, "speed": 1.2, "wait": 0.1}, "the path leads beyond the end of a stroke, from 2.0"),
        ({"stroke": 0.9, "speed": 1.2, "wait": 0.4}, "the path requires more speed than an actuator has"),
        ({"stroke": 0.2, "speed": 1.2, "wait": 0.9}, "the machine does not follow, from 2.0 s on"),
        ({"stroke": 0.9, "speed": 0.9, "wait": 0.4}, "no limit of the controller acts"),
    ],
)  # fmt: skip
def test_the_cause_is_the_limit_that_is_exceeded_most(uses, cause):
    """Strokes and speed act above 1, the wait above a half; the sentence tells the largest and when."""
    assert f"made, thing: the tip is up to 0.30 m away, 0.15 m at the end: {cause}" in text(
        [made(0.3, **uses)]
    )


def test_a_tip_near_its_path_needs_no_cause():
    """A tip 3 cm away has no line of its own; without numbers of the controller none has a cause."""
    assert "the tip is" not in text([made(0.03, stroke=400)])
    assert text([made(0.3)]).endswith("0.15 m at the end")


def test_a_path_beyond_a_stroke_is_told(fmu_dir, tmp_path, capsys):
    """Within the links' reach but beyond the stroke: the sentence names it, the numbers tell its use."""
    points = ["--through", "3,0,0", "--through", "6.1,0,0", "--no-compare", "--swap", "swing=lumped"]
    assert main(["track", str(fmu_dir / "harvester_control.ssp"), *points, "--out", str(tmp_path)]) == 0
    assert "the path leads beyond the end of a stroke, from" in capsys.readouterr().out
    assert json.loads((tmp_path / "tracking.json").read_text())[0]["largest uses of limits"][STROKE] > 1


def test_a_speed_that_is_not_reached_is_told(fmu_dir, tmp_path, capsys):
    """On 1 m from rest to rest at 0.5 m/s2 no 20 m/s are reached: the note tells what the numbers have."""
    points = ["--through", "4,0,1", "--through", "4,1,1", "--no-compare", "--swap", "swing=lumped"]
    given = [str(fmu_dir / "harvester_control.ssp"), *points, "--out", str(tmp_path)]
    assert main(["track", *given, "--speed", "20"]) == 0
    asked = json.loads((tmp_path / "tracking.json").read_text())[0]["highest speed asked for [m/s]"]
    assert f"note: --speed 20: the path is too short for more than {asked:.2g} m/s" in capsys.readouterr().out
    assert main(["track", *given, "--speed", "0.3"]) == 0
    assert "--speed" not in capsys.readouterr().out


def test_a_machine_that_differs_from_the_controllers_is_noted(fmu_dir):
    """As built nothing differs; each other value has a note, a value of 0 with its meaning."""
    system = load(fmu_dir / "harvester_control.ssp")
    assert differences(system) == []
    longer = system.with_start({"manipulator.stick_length": 3.2, "swing.valve_area": 3e-5})
    assert differences(longer) == [
        "controller.stick_length is 2.9 m, manipulator.stick_length is 3.2 m: the controller assumes another"
        " machine",
        "controller.swing_valve_area is 4e-05 m2, swing.valve_area is 3e-05 m2:"
        " the controller assumes another machine",
    ]  # fmt: skip
    line = system.with_start({"controller.line_capacitance": 1e-12, "swing.line_capacitance": 0.0})
    (note,) = differences(line)
    assert "swing.line_capacitance is 0 m3/Pa (Capacitance C" in note
    both = longer.with_start({"controller.stick_length": 3.2, "controller.swing_valve_area": 3e-5})
    assert differences(both) == []


def test_numbers_in_other_units_are_not_compared(fmu_dir):
    """A stick length without a unit may be in inches: no note."""
    system = load(fmu_dir / "harvester_control.ssp").with_start({"manipulator.stick_length": 3.2})
    part = system.components["manipulator"]
    bare = {**part.interface.variables}
    bare["stick_length"] = replace(bare["stick_length"], unit=None)
    other = replace(part, interface=replace(part.interface, variables=bare))
    assert differences(replace(system, components={**system.components, "manipulator": other})) == []


def test_notes_stand_before_the_table(fmu_dir, tmp_path, capsys):
    """The command prints the note of a difference once, for both machines, above the head of the table."""
    points = ["--through", "4,0,1", "--through", "4,0.1,1", "--no-compare"]
    system = str(fmu_dir / "harvester_control.ssp")
    given = ["--set", "manipulator.stick_length=3.0", "--out", str(tmp_path)]
    assert main(["track", system, *points, *given]) == 0
    told = capsys.readouterr().out
    assert told.count("note: controller.stick_length is 2.9 m") == 1
    assert told.index("note: ") < told.index("largest [mm]")


SQUARE = np.array([[3, 0, 0], [4, 1, 0], [4, 1, 1], [3, 0, 1.0]])
BENT = np.array([[3, 1, 2], [3, -1, 2], [5, 0, -1.0]])


def test_views_keep_lengths():
    """From above right and forward; an upright square has its sides, whatever its direction."""
    assert top_view(BENT) == pytest.approx(np.array([[-1, 1, 0], [3, 3, 5]]))
    view, name = side_view(SQUARE)
    assert name == "along the ground [m]"
    assert np.ptp(view(SQUARE), axis=1) == pytest.approx([np.sqrt(2), 1.0])  # rounding


@pytest.mark.parametrize("path", [BENT, SQUARE[:2], SQUARE[1:3]], ids=["bent", "level", "upright"])
def test_other_paths_are_seen_in_the_plane_of_the_arm(path):
    """What bends on the ground, is level or straight up has radius and height as its side view."""
    view, name = side_view(path)
    assert name == "radius from the swing axis [m]"
    assert view(path) == pytest.approx(np.stack([np.hypot(*path.T[:2]), path[:, 2]]))  # rounding


def test_the_picture_has_equal_axes_and_plain_numbers():
    """Both views have one scale, the error's ticks are numbers without exponents."""
    figure = draw([made(0.3)])
    figure.canvas.draw()
    views, errors = figure.axes[:2], figure.axes[2]
    assert [axes.get_aspect() for axes in views] == [1.0, 1.0]
    ticks = [*errors.get_yticklabels(which="minor"), *errors.get_yticklabels()]
    words = [label.get_text() for label in ticks if label.get_text()]
    assert "50" in words
    assert not [w for w in words if "e" in w]
