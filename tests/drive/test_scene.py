"""The machine in space: where the page draws it is where the mechanics say it is."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from kit import shards
from kit.equations import Part
from kit.mistakes import problem
from matplotlib import colormaps
from matplotlib.colors import to_hex
from view.standin import DESCRIPTION

from fmus.contract import quantities
from fmus.crane.description import read
from fmus.crane.machine import crane_machine
from fmus.crane.manipulator import manipulator
from fmus.crane.view import document
from fmus.manipulator import MANIPULATOR, VARIANTS
from fmus.parameters import values
from orchestrator.base import toml
from orchestrator.drive.drawing import MARKED, SCALE, STEPS, mark
from orchestrator.drive.scene import data, parameters, sizes, start
from orchestrator.drive.view_description import ViewDescription
from orchestrator.ssp.load import load
from orchestrator.ssp.system import System
from orchestrator.view.choice import MachineChoice, plan

CRANES = Path(__file__).parents[2] / "examples" / "cranes"
PENDULUM = VARIANTS["pendulum"]
OWN = values(PENDULUM).p
SCENE = DESCRIPTION.scene
# exact identities: only rounding of numbers of some metres
ROUNDING = 1e-12
# swing, boom and stick in the work space of the mechanics; head in the plane of the arm, and out of it [rad]
LOW, HIGH = (-math.pi, -0.45, -2.15, -1.0, -1.0), (math.pi, 1.0, -0.6, 1.0, 1.0)
ANGLES = ("swing_angle", "boom_angle", "stick_angle", "head_angle", "head_side_angle")
POSES = """a.values.map((q) => m.pose(q, a.machine)).map((p) => (
  { tip: p.tip, bodies: Object.fromEntries([...p.bodies].map(([n, at]) => [n, at.elements])) }))"""


@pytest.fixture(scope="module")
def found(script: Any) -> list[tuple[dict[str, float], Any]]:
    """Outputs of the mechanics by their own equations at random angles of the work space, and the pose that
    the browser computes."""
    angles = np.random.default_rng(1).uniform(LOW, HIGH, (60, 5))
    part = Part(PENDULUM)
    shown = [part(part.start(**dict(zip(ANGLES, row, strict=True))))[1] for row in angles.tolist()]
    given = {"machine": data(SCENE, OWN), "values": angles.tolist()}
    return list(zip(shown, script("rig", POSES, given), strict=True))


def drawn(pose: Any, body: str, point: tuple[float, float, float]) -> np.ndarray:
    """A point of a body in space, by the matrix of the browser, which is stored by columns."""
    matrix = np.reshape(pose["bodies"][body], (4, 4)).T
    return np.asarray((matrix @ [*point, 1.0])[:3])


@shards.browser
def test_tip_head_and_cylinders(found: Any) -> None:
    """Tip and head are where the mechanics say, cylinders as long as they say and between their pins."""
    for y, pose in found:
        tip = (y["tip_x"], y["tip_y"], y["tip_height"])
        assert pose["tip"] == pytest.approx(tip, abs=ROUNDING)
        assert drawn(pose, "stick", (OWN["stick_length"], 0, 0)) == pytest.approx(tip, abs=ROUNDING)
        middle = drawn(pose, "head", (0.0, 0.0, -OWN["head_length"]))
        assert middle == pytest.approx((y["head_x"], y["head_y"], y["head_height"]), abs=ROUNDING)
        for name in SCENE.cylinders:
            barrel, rod = (drawn(pose, f"{name}_{part}", (0.0, 0.0, 0.0)) for part in ("barrel", "rod"))
            apart, closed = math.dist(rod, barrel), OWN[f"{name}_closed_length"]
            assert apart == pytest.approx(closed + y[f"{name}_position"], abs=ROUNDING)
            end = drawn(pose, f"{name}_barrel", (apart, 0.0, 0.0))
            assert end == pytest.approx(rod, abs=ROUNDING), "the barrel points to the rod"
            pin = (OWN[f"{name}_pin_x"], 0.0, OWN[f"{name}_pin_z"])
            assert drawn(pose, name, pin) == pytest.approx(rod, abs=ROUNDING)


def test_geometry_of_a_system(fmu_dir: Path, system: System) -> None:
    """Sizes are those that the FMU declares; of a head that does not swing the length is a usual one."""
    names = {*SCENE.parameters, "head_length"}

    def used(given: Any) -> dict[str, float]:
        return {name: size for name, size in sizes(SCENE, given).items() if name in names}

    rigid = used(parameters(SCENE, system))
    own = values(MANIPULATOR).p
    assert rigid == {name: own.get(name, 1.0) for name in names}
    whole = load(fmu_dir / "harvester.fmu")
    assert used(parameters(SCENE, whole)) == rigid, "the whole machine as one FMU has the same"
    swung = plan(MachineChoice(fmu_dir / "harvester.ssp", "reach", {"manipulator": "pendulum"})).parameters
    assert used(swung) == used(OWN)
    assert start(SCENE, swung) == [0.0, 0.05, -0.65, 0.0, 0.0]  # of fmus.machine.poses


def test_no_arm(system: System) -> None:
    """A system without an arm is refused in one line that names what was looked for."""
    rest = {name: c for name, c in system.components.items() if name != "manipulator"}
    told = "boom_pivot_x to stick_stroke, found none in supply, boom_stick"
    problem(lambda: parameters(SCENE, System("no arm", rest)), told)


def test_shapes_hang_on_bodies() -> None:
    """Each shape has a size, the outlines are no knots, and what a pressure colours is all there."""
    everything = data(SCENE, OWN)["shapes"]
    rods = {f"{name}_{part}" for name in SCENE.cylinders for part in ("barrel", "rod")}
    assert {shape["body"] for shape in everything} == {"ground", *SCENE.joints, *rods}
    for shape in everything:
        assert min(shape["size"]) > 0
        assert shape["kind"] in ("box", "round") or len(shape["path"]) >= 3
    assert {shape["channel"] for shape in everything} - {""} == set(SCENE.pressures)


def test_colours_grow_lighter() -> None:
    """A higher pressure never has a darker colour, so the scale is read without a sense of hue.

    The colours are those of matplotlib, whose import they replace.
    """
    plasma = colormaps["plasma"](np.linspace(0.04, 0.92, STEPS))
    assert tuple(map(to_hex, plasma)) == SCALE
    assert sorted(map(lightness, SCALE)) == list(map(lightness, SCALE))


def lightness(code: str) -> float:
    """Relative luminance, WCAG 2.2."""
    parts = [int(code[k : k + 2], 16) / 255 for k in (1, 3, 5)]
    linear = [p / 12.92 if p <= 0.04045 else ((p + 0.055) / 1.055) ** 2.4 for p in parts]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


@shards.browser
def test_a_crane_is_drawn_where_its_mechanics_are(script: Any) -> None:
    """Tip, rod of the boom and the pin of the four-bar linkage of the loader, at random coordinates."""
    crane = read(CRANES / "loader.toml")
    scene, own = _view(crane).scene, Part(manipulator(crane))
    assert scene is not None
    low, high = ([-math.pi, -0.5, -2.9, 0.0, -1.0, -1.0], [math.pi, 1.1, -0.3, 1.8, 1.0, 1.0])
    free = [j.coordinate for j in crane.joints if not j.follows]
    rows = np.random.default_rng(2).uniform(low, high, (40, 6)).tolist()
    shown = [own(own.start(**dict(zip(free, row, strict=True))))[1] for row in rows]
    given = {"machine": data(scene, own.p), "values": [[y[s] for s in scene.signals] for y in shown]}
    for y, pose in zip(shown, script("rig", POSES, given), strict=True):
        assert pose["tip"] == pytest.approx([y["tip_x"], y["tip_y"], y["tip_height"]], abs=ROUNDING)
        for name in ("boom", "jib"):  # as far apart as the piston says
            barrel, rod = (drawn(pose, f"{name}_{part}", (0.0, 0.0, 0.0)) for part in ("barrel", "rod"))
            apart = own.p[f"{name}_closed_length"] + y[f"{name}_position"]
            assert math.dist(barrel, rod) == pytest.approx(apart, abs=ROUNDING)
        coupler = drawn(pose, "jib_coupler", (own.p["jib_coupler"], 0.0, 0.0))
        pin = drawn(pose, "jib", (own.p["jib_link_x"], 0.0, own.p["jib_link_z"]))
        assert coupler == pytest.approx(pin, abs=ROUNDING)


@pytest.mark.parametrize("name", ["loader", "feric", "patu"])
def test_the_page_of_a_crane_shows_its_signals(name: str) -> None:
    """Each signal, formula and input of the page is one of the crane; its pins and levers are named."""
    crane = read(CRANES / f"{name}.toml")
    view, machine = _view(crane), crane_machine(crane)
    assert view.scene is not None
    outputs = {n for sub in machine.components.values() for n in quantities(sub.outputs)}
    parts = [*machine.components.values(), *filter(None, [machine.controller])]
    inputs = {n for sub in parts for n in quantities(sub.inputs)}
    of_tip = {"radial_velocity", "vertical_velocity", "swing_velocity"} if machine.controller else set()
    levers = {f"{j.name}_lever" for j in crane.driven if machine.controller}
    named = {f"{j.name}_command" for j in crane.driven} | levers | of_tip
    relieved = {f"{j.name}_relief_flow" for j in crane.driven}  # of drives with more detail
    assert set(view.shown) - relieved <= outputs | inputs
    assert {n for axis in view.axes for n in axis.name} - {"engaged"} == named <= inputs
    assert data(view.scene, values(manipulator(crane)).p)["shapes"]
    mode = view.modes["levers"]
    assert set(mode.full) == {j.name for j in crane.driven}
    tip = view.modes["tip"].full.values() if machine.controller else ()
    assert {n for full in tip for n in full} == of_tip
    if "boom" in mode.full:
        assert mode.full["boom"]["boom_command"] > 0
        assert view.functions["boom"] == ("boom up", "boom down")


def _view(crane: Any) -> ViewDescription:
    return toml.read_dataclass(ViewDescription, toml.read(Path("view.toml"), document(crane)))


FAULTS = {
    "boom_head_leak": {"boom_head"},
    "swing_leak_a": {"swing_a"},
    "stick_seal_leakage": {"stick_head", "stick_rod"},
    "stick_rod_pressure_sensor": {"stick_rod"},
    "boom_gain_up": {"boom_head", "boom_rod"},
    "pump_pressure": set(),
    "oil_air": set(),
}


@pytest.mark.parametrize(("fault", "channels"), FAULTS.items())
def test_a_fault_is_marked_where_its_pressures_are(fault: str, channels: set[str]) -> None:
    """Hose and chamber of one side, else both sides of the function; nothing for what is not drawn."""
    plain, marked = (data(SCENE, OWN)["shapes"] for _ in range(2))
    mark(marked, SCENE, [fault])
    expected = [MARKED if one["channel"] in channels else one["colour"] for one in plain]
    assert [one["colour"] for one in marked] == expected
    assert not {one["channel"] for one in marked} & channels, "no pressure colours it any more"


def test_a_sensor_of_an_angle_is_marked_on_the_body_that_it_measures() -> None:
    """The column turns with the swing."""
    shapes = data(SCENE, OWN)["shapes"]
    mark(shapes, SCENE, ["swing_angle_sensor"])
    assert {one["body"] for one in shapes if one["colour"] == MARKED} == {"column"}
