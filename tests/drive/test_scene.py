"""The machine in space: where the page draws it is where the mechanics say it is."""

import functools
import math
from dataclasses import asdict
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from kit import shards

from fmus.contract import quantities, symbolic
from fmus.manipulator import MANIPULATOR, VARIANTS
from fmus.parameters import values
from orchestrator.base.errors import Problem
from orchestrator.drive import bodies
from orchestrator.drive.drawing import SCALE
from orchestrator.drive.geometry import NODES, Geometry, geometry
from orchestrator.ssp.load import load
from orchestrator.ssp.system import System
from orchestrator.view.choice import MachineChoice, plan

PENDULUM = VARIANTS["pendulum"]
OWN = values(PENDULUM).p
SIZES = Geometry(**{name: OWN[name] for name in Geometry.__dataclass_fields__})
# exact identities: only rounding of numbers of some metres
ROUNDING = 1e-12
# swing, boom and stick in the work space of the mechanics; head in the plane of the arm, and out of it [rad]
LOW, HIGH = (-math.pi, -0.45, -2.15, -1.0, -1.0), (math.pi, 1.0, -0.6, 1.0, 1.0)


class Angles(NamedTuple):
    """Angles of the joints [rad]."""

    swing: float
    boom: float
    stick: float
    head: float
    side: float


@functools.cache
def equations(name: str) -> Any:
    """The model as a function, made once."""
    return symbolic(VARIANTS[name]).function()


def told(q: Angles) -> dict[str, float]:
    """Outputs of the mechanics at these angles, by its own equations."""
    state = {"swing_angle": q.swing, "boom_angle": q.boom, "stick_angle": q.stick}
    state |= {"head_angle": q.head, "head_side_angle": q.side}
    x = [state.get(name, 0.0) for name in quantities(PENDULUM.states)]
    own = values(PENDULUM)
    outputs = equations("pendulum")(x, list(own.u.values()), list(own.p.values()))[1].full()[:, 0]
    return dict(zip(quantities(PENDULUM.outputs), map(float, outputs), strict=True))


@pytest.fixture(scope="module")
def found(script: Any) -> list[tuple[Angles, dict[str, Any]]]:
    """Poses as the browser computes them, at random angles of the work space: angles -> tip, and nodes."""
    rng = np.random.default_rng(1)
    angles = [Angles(*row) for row in rng.uniform(LOW, HIGH, (60, 5)).tolist()]
    poses = script("rig", "a.map(([q, g]) => m.pose(q, g))", [[list(q), asdict(SIZES)] for q in angles])
    return list(zip(angles, poses, strict=True))


def drawn(pose: Any, node: str, point: tuple[float, float, float]) -> np.ndarray:
    """A point of a node in space, by rotation matrices: turned as the browser does it."""
    x, z, angle, side = pose["nodes"][node]
    cos, sin = math.cos(side), math.sin(side)
    roll = np.array([[1, 0, 0], [0, cos, -sin], [0, sin, cos]])
    cos, sin = math.cos(-angle), math.sin(-angle)
    pitch = np.array([[cos, 0, sin], [0, 1, 0], [-sin, 0, cos]])
    cos, sin = math.cos(pose["swing"]), math.sin(pose["swing"])
    swing = np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]])
    return np.asarray(swing @ (np.array([x, 0.0, z]) + pitch @ roll @ np.array(point)))


@shards.browser
def test_tip_and_cylinders(found: Any) -> None:
    """Tip and elbow are those of the mechanics, each cylinder is as long as closed length and position."""
    for q, pose in found:
        y = told(q)
        tip = (y["tip_x"], y["tip_y"], y["tip_height"])
        assert pose["tip"] == pytest.approx(tip, abs=ROUNDING)
        assert drawn(pose, "stick", (SIZES.stick_length, 0, 0)) == pytest.approx(tip, abs=ROUNDING)
        for name, closed in (("boom", SIZES.boom_closed_length), ("stick", SIZES.stick_closed_length)):
            barrel, rod = (np.array(pose["nodes"][f"{name}_{part}"]) for part in ("barrel", "rod"))
            apart = math.hypot(*(rod - barrel)[:2])
            assert apart == pytest.approx(closed + y[f"{name}_position"], abs=ROUNDING)
            end = barrel[:2] + apart * np.array([math.cos(barrel[2]), math.sin(barrel[2])])
            assert end == pytest.approx(rod[:2], abs=ROUNDING), "the barrel points to the rod"


@shards.browser
def test_head_and_rod_pins(found: Any) -> None:
    """The head hangs where the mechanics say; rods end at the pins of boom and stick in any pose."""
    for q, pose in found:
        y = told(q)
        middle = drawn(pose, "head", (0.0, 0.0, -SIZES.head_length))
        assert middle == pytest.approx((y["head_x"], y["head_y"], y["head_height"]), abs=ROUNDING)
    pins = (("boom", SIZES.boom_pin_x, SIZES.boom_pin_z), ("stick", SIZES.stick_pin_x, SIZES.stick_pin_z))
    for _, pose in found:
        for link, *pin in pins:
            rod = drawn(pose, f"{link}_rod", (0.0, 0.0, 0.0))
            assert drawn(pose, link, (pin[0], 0.0, pin[1])) == pytest.approx(rod, abs=ROUNDING)


def test_geometry_of_a_system(fmu_dir: Path, system: System) -> None:
    """Sizes are those that the FMU declares; of a head that does not swing the length is a usual one."""
    rigid = geometry(system)
    own = values(MANIPULATOR).p
    for name in Geometry.__dataclass_fields__:
        assert getattr(rigid, name) == own.get(name, 1.0)
    assert geometry(load(fmu_dir / "harvester.fmu")) == rigid, "the whole machine as one FMU has the same"
    swung = plan(MachineChoice(fmu_dir / "harvester.ssp", "reach", {"manipulator": "pendulum"}))
    assert swung.geometry == SIZES
    assert (swung.start.boom, swung.start.stick) == (0.05, -0.65)  # of fmus.machine.poses


def test_no_arm(system: System) -> None:
    """A system without an arm is refused in one line that names what was looked for."""
    rest = {name: c for name, c in system.components.items() if name != "manipulator"}
    with pytest.raises(Problem, match="boom_pivot_x to stick_stroke, found none in supply, boom_stick"):
        geometry(System("no arm", rest))


def test_bodies_hang_on_nodes() -> None:
    """Each body has a node, a kind and a size that the browser knows, and the outlines are no knots."""
    everything = [*bodies.site_parts(), *bodies.crane_parts(SIZES), *bodies.head_parts(SIZES)]
    assert {b.node for b in everything} == {"site", "column", *NODES}
    for body in everything:
        assert body.kind in ("box", "plate", "round", "tube")
        assert min(body.size) > 0
        assert body.kind in ("box", "round") or len(body.path) >= 3
    coloured = {body.channel for body in everything} - {""}
    cylinders = {f"{joint}_{side}" for joint in ("boom", "stick") for side in ("head", "rod")}
    assert coloured == cylinders | {"swing_a", "swing_b"}


def test_colours_grow_lighter() -> None:
    """A higher pressure never has a darker colour, so the scale is read without a sense of hue."""
    assert sorted(map(lightness, SCALE)) == list(map(lightness, SCALE))


def lightness(code: str) -> float:
    """Relative luminance, WCAG 2.2."""
    parts = [int(code[k : k + 2], 16) / 255 for k in (1, 3, 5)]
    linear = [p / 12.92 if p <= 0.04045 else ((p + 0.055) / 1.055) ** 2.4 for p in parts]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]
