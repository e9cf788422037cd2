"""Speeds at full command: those of a steady run, by its equations, by hand, and of the built crane."""

from math import pi

import numpy as np
import pytest
from kit import shards
from kit.cranes import changed, crane
from kit.equations import hose_drop
from scipy.optimize import brentq

from fmus.crane.check import check
from fmus.crane.description import NEW, read
from fmus.crane.machine import crane_build
from fmus.crane.manipulator import manipulator
from fmus.crane.speeds import full_speeds
from fmus.machine.poses import outputs_at_start
from orchestrator import run

STROKE = 'stroke = "610 mm"'
SWAPS = {"lumped": {}, "compensated": {"drives": "compensated", "supply": "load_sensing"}}


DRY = (("[boom]", '[boom]\nfriction = "2 kN.m"'), (STROKE, f'{STROKE}, friction = "9 kN"'))
NARROW = ('valve = "40 mm2", hose = "3 m"', 'valve = "40 mm2", OWN, hose = "3 m"')
OWN = 'rod_valve = "25 mm2", head_return = "12 mm2", rod_return = "55 mm2"'


@pytest.mark.parametrize("changes", [(), DRY, (tuple(x.replace("OWN", OWN) for x in NARROW),)])
def test_speeds_are_in_balance_with_edges_hoses_friction_and_weight(tmp_path, changes):
    """Of boom and telescope of the loader with spool valves, by bisection; also with dry friction.

    And with edges of their own, of which one is wider than `valve`.
    """
    loader, dry = read(changed(tmp_path, *changes)), changes == DRY

    def excess(v, joint, gains, filled, emptied, load, friction, rubbing):
        hose = {"density": 870.0, "viscosity": 0.02} | {
            f"own_{n}": joint[n] for n in ("hose_length", "hose_bore")
        }
        sides = zip((filled, emptied), gains, strict=True)
        lost = (a * ((a * v / gain) ** 2 + hose_drop(hose, "own", a * v)) for a, gain in sides)
        return filled * 215e5 - sum(lost) - load - friction * v - rubbing

    pose, axes = outputs_at_start(manipulator(loader)), check(loader)[1::2]
    for axis, speeds in zip(axes, full_speeds(loader, axes, ["lumped"]).values(), strict=True):
        joint, lever = axis.joint, abs(axis.lever)
        head, rod = (pi / 4 * d for d in (joint["bore"] ** 2, joint["bore"] ** 2 - joint["rod"] ** 2))
        edges = np.full((2, 2), joint["valve_area"])  # in and out, of both directions
        if changes and not dry and joint.name == "boom":
            edges = np.array([[40e-6, 55e-6], [25e-6, 12e-6]])
        gains = 0.62 * edges * np.sqrt(2 / 870.0)
        weight = pose[f"{joint.name}_holding_force"]
        friction = joint["piston_damping"] + joint["damping"] / lever**2
        rubbing = 2e3 / lever + 9e3 if dry and joint.name == "boom" else 0.0
        sides = ((head, rod, weight), (rod, head, -weight))
        for own, (filled, emptied, load), speed in zip(gains, sides, speeds["lumped"][:2], strict=True):
            numbers = joint, own, filled, emptied, load, friction, rubbing
            # 0.5 %: leakage of the valve, the laminar part of its flow, rounding of the hose's friction
            assert speed * lever == pytest.approx(brentq(excess, 1e-9, 5, numbers), rel=5e-3)


def rated():
    """The crane of `harvester crane new` with valves by their rated flow."""
    text = NEW.read_text(encoding="utf-8")
    for valve in ("25 mm2", "40 mm2"):
        text = text.replace(f'valve = "{valve}"', 'flow = "30 L/min", drop = "12 bar"')
    return text.encode()


def test_a_compensated_section_moves_an_axis_by_its_rated_flow(tmp_path):
    """And a spool valve by what the whole supply drives through its edges: far more."""
    own = read(tmp_path / "rated.toml", rated())
    for axis, speeds in zip(axes := check(own)[1:2], full_speeds(own, axes).values(), strict=True):
        joint = axis.joint
        areas = joint["bore"] ** 2, joint["bore"] ** 2 - joint["rod"] ** 2
        per_radian = [pi / 4 * x * abs(axis.lever) for x in areas]
        for volume, fast, slow in zip(per_radian, speeds["lumped"], speeds["compensated"], strict=False):
            # 15 %: the droop of the compensator, whose flow is stated at 100 bar over the section
            assert slow == pytest.approx(30 / 6e4 / volume, rel=0.15)
            assert fast > 1.7 * slow


@pytest.fixture(scope="module")
def rated_folder(tmp_path_factory):
    """Where the crane with rated valves is built."""
    folder = tmp_path_factory.mktemp("rated")
    (folder / "rated.toml").write_bytes(rated())
    crane_build(read(folder / "rated.toml")).write(folder)
    return folder


RUNS = [
    *(("loader", d, axis) for d in SWAPS for axis in ("slew", "jib")),
    *(("loader", "lumped", axis) for axis in ("boom", "extension")),
    *(("rated", d, axis) for d in SWAPS for axis in ("slew", "boom", "stick")),
]
LEAD = {"lumped": 0.4, "compensated": 0.8}  # s before the start pose, in which an axis gets to its speed


@shards.machine
@pytest.mark.parametrize(("name", "drives", "axis"), RUNS)
@pytest.mark.parametrize("sign", [1, -1])
def test_a_run_passes_the_start_pose_at_that_speed(loader_folder, rated_folder, name, drives, axis, sign):
    """The built crane at full command, from a pose before it; a motor after 7 s. Within 5 %."""
    folder = {"loader": loader_folder, "rated": rated_folder}[name]
    own = crane() if name == "loader" else read(folder / "rated.toml")
    (found,) = (a for a in check(own) if a.joint.name == axis)
    speed = full_speeds(own, [found], [drives])[axis][drives][0 if sign > 0 else 1]
    forwards = sign * np.sign(found.lever)
    at, motor = found.joint.start.value, found.joint.drive == "motor"
    begin = at - (0 if motor else forwards * speed * LEAD[drives])
    assert found.low < begin < found.high
    levers = [a.name for a in own.driven]
    given = {f"operator_input.{n}_{k}_command": 0.0 for n in levers for k in (1, 2)}
    program = {"command": 10.0 * sign, "start": 0.02, "rise": 0.3, "hold": 20.0}
    given |= {f"operator_input.{axis}_1_{n}": x for n, x in program.items()}
    given[f"manipulator.initial_{found.joint.coordinate}"] = begin
    options = {"swap": SWAPS[drives], "set": given, "record_step": 5e-3}
    result = run(folder / f"{name}.ssp", stop=8.0 if motor else 2.0, **options)
    place = forwards * result[f"manipulator.{found.joint.coordinate}"]
    passing = len(place) - 201 if motor else int(np.argmax(place > forwards * at))
    few = 200 if motor else 20  # samples: 1 s, or 0.1 s to both sides
    moved = place[passing + few] - place[passing - few]
    assert moved / (2 * few * 5e-3) == pytest.approx(speed, rel=0.05)
