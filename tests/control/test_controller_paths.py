"""Paths: from waypoints to inputs over time, their starts, and the files that hold them."""

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from kit.equations import Part

from fmus.controller import paths
from fmus.controller.paths import COLUMNS, PATHS, Route
from fmus.machine.build import data
from fmus.machine.poses import controlled_poses, pose_set
from fmus.manipulator import MANIPULATOR

ROUTES = st.builds(
    Route,
    points=st.just(((0.0, 0.0, 0.0), (1.0, 0.0, 0.0))),
    speed=st.floats(0.05, 2.0),
    acceleration=st.floats(0.1, 3.0),
    rise=st.floats(0.05, 1.0),
)


@given(ROUTES, st.floats(0.01, 10.0))
def test_a_segment_ends_at_rest_at_its_end(route, length):
    """From the jerks alone: the length is met, neither speed nor acceleration is above its limit."""
    duration, *_ = paths.segment_profile(length, route)
    time = np.linspace(0, duration, 4001)
    way, speed = paths.segment_motion(time, length, route)
    assert way[0] == speed[0] == 0
    # what is left before the last step, at the full jerk: j h^3/6 and j h^2/2
    jerk, last = route.acceleration / route.rise, time[1]
    assert 0 <= length - way[-2] <= jerk * last**3 / 6 * (1 + 1e-6) + 1e-9
    assert speed[-2] <= jerk * last**2 / 2 * (1 + 1e-6) + 1e-9
    assert (np.diff(way) >= -1e-12).all()
    assert speed.max() <= route.speed * (1 + 1e-9)
    assert np.abs(np.diff(speed)[:-1] / last).max() <= route.acceleration * (1 + 1e-6)
    # speed is the slope of the way: midpoint rule, error from the jerk over a step
    middle = (speed[1:-1] + speed[:-2]) / 2
    np.testing.assert_allclose(np.diff(way)[:-1] / last, middle, atol=jerk * last**2)


@pytest.mark.parametrize("name", PATHS)
def test_velocities_are_the_slopes_of_the_path(name):
    """In cylinder coordinates, by central differences at 200 Hz, whose error is jerk times step squared."""
    time, points, velocities = paths.sample(PATHS[name])
    table = dict(zip(COLUMNS, paths.controller_inputs(points, velocities).T, strict=True))
    for place, velocity in (("radius", "radial"), ("height", "vertical"), ("angle", "swing")):
        slope = np.gradient(table[f"path_{place}"], time)
        np.testing.assert_allclose(slope[1:-1], table[f"{velocity}_velocity"][1:-1], atol=1e-4)
    assert np.hypot(*velocities.T[:2]).max() <= 0.5 + 1e-9
    assert (table["engaged"] == 1).all()
    assert (table["follow"] == 1).all()


def test_line_and_square_are_what_they_are_called():
    """4 m at constant height and radius free; four sides of 1 m, right angles, closed, upright."""
    _, line, _ = paths.sample(PATHS["line"])
    assert np.ptp(line, axis=0) == pytest.approx([0, 4, 0], abs=1e-12)
    corners = np.array(PATHS["square"].points)
    sides = np.diff(corners, axis=0)
    assert np.linalg.norm(sides, axis=1) == pytest.approx(np.ones(4))
    assert [a @ b for a, b in pairwise(sides)] == pytest.approx([0, 0, 0], abs=1e-12)
    assert (corners[0] == corners[-1]).all()


@pytest.mark.parametrize("name", PATHS)
def test_the_start_of_a_path_is_a_pose_with_the_tip_there(name):
    """The run starts at rest on the path: to a micrometre."""
    pose = controlled_poses()[name]
    arm = Part(MANIPULATOR, **{n.partition(".")[2]: value for n, value in pose_set(pose).items()})
    y = arm(arm.start())[1]
    assert [y["tip_x"], y["tip_y"], y["tip_height"]] == pytest.approx(PATHS[name].points[0], abs=1e-6)


@pytest.mark.parametrize("name", PATHS)
def test_the_files_are_those_of_the_paths(name, tmp_path):
    """data/scenarios holds what `python -m fmus.controller.paths` writes."""
    paths.write(tmp_path)
    assert (tmp_path / f"{name}.csv").read_bytes() == data(f"scenarios/{name}.csv").read_bytes()


def test_a_short_side_is_passed_more_slowly():
    """1 cm: the speed that the acceleration and its rise allow, from 2 v sqrt(v/j) = length."""
    route = PATHS["line"]
    _, speed = paths.segment_motion(np.linspace(0, 5, 5001), 0.01, route)
    allowed = (0.005 * math.sqrt(route.acceleration / route.rise)) ** (2 / 3)
    assert speed.max() == pytest.approx(allowed, rel=1e-4)
