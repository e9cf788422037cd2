"""The machine's motion: views, frames of the animation, strobe picture."""

from typing import Any

import numpy as np
import pytest
from kit.mistakes import problem

from orchestrator.results.motion import MachineMotion, frames, strobe

TIME = np.linspace(0.0, 4.0, 4001)
ORIGIN = np.zeros((len(TIME), 3))


def arm(radius: float = 5.0) -> MachineMotion:
    """A pillar 2 m high on the axis and an arm that slews a quarter turn in 4 s."""
    angle = TIME * np.pi / 8
    still = np.zeros_like(TIME)
    tip = np.column_stack((radius * np.cos(angle), radius * np.sin(angle), still + 1.0))
    top = np.column_stack((still, still, still + 2.0))
    return MachineMotion(TIME, {"foot": ORIGIN, "top": top, "tip": tip})


def test_side_view_turns_with_the_arm() -> None:
    """In its plane a slewing arm keeps its length; without turning there is no view from above."""
    motion = arm()
    # exact identity, rounding only
    np.testing.assert_allclose(motion.side("tip"), np.tile([5.0, 1.0], (len(TIME), 1)), rtol=1e-12)
    np.testing.assert_allclose(motion.top("tip")[-1], [0.0, 5.0], atol=1e-12)
    motion = arm()
    planar = MachineMotion(motion.time, motion.points, turning=False)
    np.testing.assert_array_equal(planar.side("tip"), planar.points["tip"][:, [0, 2]])
    assert list(frames(planar)["views"]) == ["side"]
    assert len(strobe(planar).axes) == 2  # one view and the colour bar


def test_frames_are_25_per_second_and_small() -> None:
    """4 s give 101 frames, each with x and y of every point, to the millimetre."""
    data = frames(arm())
    assert len(data["views"]["side"][0]) == len(data["views"]["top"][0]) == 101
    assert data["step"] == pytest.approx(0.04)  # rounding only
    assert data["views"]["side"][0][50] == [0.0, 0.0, 0.0, 2.0, 5.0, 1.0]
    assert data["lines"] == [[0, 1, 2]]
    assert data["tip"] == 2
    assert data["deviation"] is None


def test_ghost_distance_of_the_tips_and_bounds() -> None:
    """The reference's machine and how far the tips are apart [mm]; nothing leaves the picture."""
    data = frames(arm(5.0), arm(5.002))
    assert len(data["views"]["side"]) == 2
    assert set(data["deviation"]) == {2.0}
    left, right, low, high = frames(arm())["bounds"]["top"]
    assert left < 0 < 5 < right
    assert low < 0 < 5 < high


def test_strobe_picture_shows_both_views() -> None:
    """Nine poses and the path of the tip in each; a machine at rest is drawn, not divided by zero."""
    figure = strobe(arm(), poses=9, title="Slew")
    side, top = figure.axes[:2]
    assert [axes.get_title("left") for axes in (side, top)] == ["Side view", "From above"]
    assert len(top.lines) == 9 + 1 + 1  # poses, path, axis mark
    rest = MachineMotion(TIME, {"foot": ORIGIN, "tip": ORIGIN + 1.0})
    assert strobe(rest, poses=3).axes


def test_mistakes_are_named() -> None:
    """Wrong shapes, positions that are no numbers and unknown labels are refused."""

    def line(tips: np.ndarray = ORIGIN, **more: Any) -> str:
        return problem(lambda: MachineMotion(TIME, {"tip": tips}, **more))

    assert line(np.zeros((3, 3))).startswith("motion: 'tip': expected shape (4001, 3), got (3, 3)")
    assert line(np.full((len(TIME), 3), np.nan)).startswith("motion: 'tip': expected finite positions")
    assert line(lines=(("tip", "hand"),)) == line(tip="hand") == "motion: expected points hand, got tip"
