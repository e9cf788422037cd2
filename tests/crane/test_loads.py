"""Loads by radius: the largest one of all poses with that reach, against other calculations."""

import re
from pathlib import Path

import numpy as np
import pytest
from kit import shards
from kit.mistakes import entry
from kit.planar_cranes import GRAVITY, described, draw, largest

from fmus.crane.axes import capacity
from fmus.crane.check import check, table
from fmus.crane.description import read

# two joints, three, two and a telescope, four
QUICK = {11: 0.3, 12: 0.9, 6: 0.999, 4: 0.6}
SHARES = (0.02, 0.3, 0.6, 0.9, 0.999)  # of the way from the least to the largest reach


def compare(seed, shares):
    """Of one drawn crane; 2 %: of a search by two grids."""
    booms = draw(seed)
    crane = described(booms)
    loads = capacity(crane, check(crane))
    least, most = (x for _, x in loads.ends)
    for share in shares:
        reach = least + share * (most - least)
        assert loads.at(reach) == pytest.approx(largest(booms, reach), rel=0.02, abs=1.0), (seed, share)


@pytest.mark.parametrize(("seed", "share"), QUICK.items())
def test_the_load_at_a_radius_is_that_of_a_fine_grid(seed, share):
    """Of a random crane; there the first angle follows from the radius, and the moments are by hand."""
    compare(seed, [share])


@shards.search
@pytest.mark.parametrize("seed", range(50))
def test_the_load_at_any_radius_is_that_of_a_fine_grid(seed):
    """Near both ends of the reach, and between them."""
    compare(seed, SHARES)


def test_ranges_end_at_the_ends_of_the_strokes():
    """Of drawn cranes, whose strokes were computed from the ranges: not one step of a search beyond."""
    for seed in (4, 6, 11):
        booms = draw(seed)
        for boom, axis in zip(booms, check(described(booms)), strict=True):
            # the length changes little with the angle where a lever is small: 1e-12 m is 1e-9 rad there
            assert (axis.low, axis.high) == pytest.approx(boom.ends, abs=1e-8)


STEPS = entry(__file__, "steps")


@pytest.mark.parametrize("reach", [2.2, 5.03, 9.0])
def test_a_telescope_whose_stages_go_in_step(reach):
    """Its extension follows from angle and radius; the boom's moment and the force along the slide limit."""
    crane = read(Path("steps.toml"), STEPS.encode())
    loads = capacity(crane, check(crane))
    angle = np.linspace(-1.2, 1.2, 400_001)
    pin = 0.6 * np.exp(1j * angle) - (0.4 - 1.1j)
    length, out = np.abs(pin), (reach / np.cos(angle) - 2) / 2.5
    some = (length >= 0.95) & (length <= 1.4) & (out >= 0) & (out <= 3)
    lever = (0.6 * np.exp(-1j * angle) * pin).imag / length
    area, own = 2.4e7 * np.pi / 4, 40 * 0.9 + 30 * (2 + out) + 20 * (2 + 2.5 * out)
    by_boom = (area * 0.16**2 * lever / GRAVITY - own * np.cos(angle)) / reach
    sine = np.sin(angle)
    square = np.where(sine > 0, 0.09**2, 0.09**2 - 0.06**2)
    along = (area * square / GRAVITY / np.maximum(np.abs(sine), 1e-9) - 80) / 2.5
    expected = np.minimum(by_boom, along)[some].max()
    # 0.2 %: 400 000 angles, and the gravity of the file of the paper
    assert loads.at(reach) == pytest.approx(expected, rel=2e-3)


def test_a_radius_without_a_pose_has_no_load():
    """Nearer than the tip comes, and beyond the largest reach; the lines say so, not 0 kg."""
    text = STEPS.replace("at = [0, 0, 1.2]", "at = [1.5, 0, 1.2]")
    text += '[datasheet]\nreach = 11\nloads = [["1 m", 900], ["12 m", 90], ["5 m", 900]]\n'
    crane = read(Path("steps.toml"), text.encode())
    loads = capacity(crane, found := check(crane))
    (pose, least), (_, most) = loads.ends
    assert loads.at(least) == pytest.approx(loads.held(pose)[2], rel=1e-3)
    assert most == pytest.approx(1.5 + 2 + 2.5 * 3, abs=1e-3)  # stretched and level
    assert [loads.at(x) for x in (0.99 * least, 1.01 * most)] == [None, None]
    told = table(crane, found, loads, {})
    assert re.findall(r"load at (\d+) m \[kg\] +\d+ +no pose", told) == ["1", "12"]


SLEWED = entry(__file__, "slewed")


def test_a_slewing_motor_on_a_slope_limits_the_load():
    """It holds m g r sin(roll) about its axis, beside the weight of the arm: 40 kg at 0.9 m, the stages."""
    text = SLEWED + STEPS + '[base]\nroll = "15 deg"\n[start]\none = 1\n'
    crane = read(Path("steps.toml"), text.encode())
    loads = capacity(crane, check(crane))
    torque, slope = 2.4e7 * 6e-5, GRAVITY * np.sin(np.radians(15))
    # level, where the weight of the arm is farthest out for its reach
    expected = (torque / slope - 40 * 0.9 - 30 * (2 + 2) - 20 * (2 + 2.5 * 2)) / 7
    level = loads.held(np.array([0.0, 2.0]))
    assert level[0] == pytest.approx(7, rel=1e-12)
    assert level[2] == pytest.approx(expected, rel=1e-4)  # gravity of the file of the paper


SLOPES = [('roll = "12 deg"', 0.0, 0), ('roll = "-7 deg"', 2.6, 50), ("pitch = 0.3", 1.1, 0)]


@pytest.mark.parametrize(("slope", "slew", "mass"), SLOPES)
def test_a_slewing_motor_holds_the_crane_on_a_slope(slope, slew, mass):
    """Moment of the weights about its axis, by hand: the arm is level, and the base leans to a side."""
    text = SLEWED.replace("6e-5", "2e-3") + STEPS.replace('on = "two"', f'on = "two"\nmass = {mass}')
    crane = read(Path("steps.toml"), f"{text}[base]\n{slope}\n[start]\none = 1\nslew = {slew}\n".encode())
    lean = crane.numbers["base"]["base_roll"].value + crane.numbers["base"]["base_pitch"].value
    across = np.cos(slew) if "roll" in slope else np.sin(slew)  # of the arm, to the way down
    moment = GRAVITY * (40 * 0.9 + 30 * (2 + 1) + (20 + mass) * (2 + 2.5 * 1))
    expected = abs(moment * np.sin(lean) * across) / 2e-3
    assert check(crane)[0].holding == pytest.approx(expected, rel=1e-4)  # gravity of the file of the paper


CLAWS = [  # axes of the hook, mass and centre of the claw below it, place of the load
    (["y"], 110.0, (0.55, 0.0, -0.65), (0.0, 0.0, -1.1)),
    (["y"], 300.0, (-0.8, 0.0, -0.3), (0.2, 0.0, -0.9)),
    (["y", "x"], 150.0, (0.3, -0.5, -0.6), (0.1, 0.0, -1.5)),
]


def _claw(axes, mass, centre, load):
    """Hanging at the end of the boom, by joints with one place."""
    text = STEPS[: STEPS.index("[one]")]
    for k, axis in enumerate(axes):
        text += f'[hook{k}]\naxis = "{axis}"\nat = [{0 if k else 2.5}, 0, 0]\n'
    text += f"mass = {mass}\ncentre = {[*centre]}\ninertia = [9, 9, 9]\n"
    text += f'[payload]\non = "hook{k}"\nat = {[*load]}\n[supply]\npressure = 2.4e7\n'
    return read(Path("claw.toml"), text.encode())


@pytest.mark.parametrize(("axes", "mass", "centre", "load"), CLAWS)
def test_a_load_hangs_where_it_hangs_with_itself(axes, mass, centre, load):
    """The moment of all that hangs is that of its weight at the pin, whatever its pose; the load is where
    the common centre of claw and load is below the pin."""
    crane = _claw(axes, mass, centre, load)
    loads = capacity(crane, check(crane))
    angle = loads.poses[0]
    lever = np.gradient(np.abs(0.6 * np.exp(1j * angle) - (0.4 - 1.1j)), angle)
    boom = 2.4e7 * np.pi / 4 * 0.16**2 * lever / GRAVITY - 40 * 0.9 * np.cos(angle)
    carried = boom / (2.5 * np.cos(angle)) - mass
    x, y, z = (mass * c + carried * t for c, t in zip(centre, load, strict=True))
    roll = np.arctan2(y, -z) if "x" in axes else 0.0 * z
    across = load[1] * np.cos(roll) - load[2] * np.sin(roll)
    up, down = load[1] * np.sin(roll) + load[2] * np.cos(roll), y * np.sin(roll) + z * np.cos(roll)
    pitch = np.arctan2(x, -down)
    reach = np.hypot(2.5 * np.cos(angle) + load[0] * np.cos(pitch) + up * np.sin(pitch), across)
    inner = slice(2, -2)  # differences at the ends are of first order
    # 1e-3: differences of the lever, of second order; the pose after two steps, 1e-4
    np.testing.assert_allclose(loads.values[2][inner], carried[inner], rtol=1e-3)
    np.testing.assert_allclose(loads.values[0][inner], reach[inner], atol=1e-3)
