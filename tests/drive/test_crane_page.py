"""The page of a crane with six functions, of which two are on thumb wheels, and with a mesh."""

import itertools
import json
import math
import struct
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from kit import shards
from kit.driven_page import PAD
from kit.equations import Part
from kit.mistakes import entry, problem, table
from kit.wait import LONG, until
from view.standin import Server, serving

from fmus.crane.description import CraneDescription, read
from fmus.crane.manipulator import manipulator
from fmus.crane.view import page_files
from fmus.parameters import values
from orchestrator.base.files import Location
from orchestrator.data import gltf
from orchestrator.drive import drawing
from orchestrator.drive.page import page_data
from orchestrator.drive.sticks import StickAxes, functions
from orchestrator.drive.view_description import ViewDescription, view_description
from orchestrator.ssp.load import load
from orchestrator.ssp.write import write_ssp

LOADER = Path(__file__).parents[2] / "examples" / "cranes" / "loader.toml"
# a rotator and a jaw in place of the passive swing of the grapple
MORE = Path(__file__).with_name("rotator_and_jaw.toml")
LOW, HIGH = (-0.2, -0.9, -0.15), (0.3, -0.1, 0.25)  # corners of the mesh, in the frame of the file: y upwards
# both sticks and both wheels at their stops, as keys, and what they command [V]
HELD = {"a": ("slew", 4), "w": ("jib", -6), "ArrowDown": ("boom", 6), "ArrowLeft": ("rotator", 4)}
HELD |= {"e": ("extension", 6), "u": ("grapple", -6)}
SIDES = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))  # of a box


def box(low: Sequence[float], high: Sequence[float], top: Any = None, **node: Any) -> bytes:
    """A binary glTF file of a red box between two corners; node, top: further keys of node and file."""
    ends = list(zip(low, high, strict=True))
    points = np.array([[x, y, z] for x in ends[0] for y in ends[1] for z in ends[2]], "<f4").tobytes()
    corners = np.array([(s[0], s[k], s[k + 1]) for s in SIDES for k in (1, 2)], "<u2").tobytes()
    document = {
        "asset": {"version": "2.0"},
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, **node}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1, "material": 0}]}],
        "materials": [{"pbrMetallicRoughness": {"baseColorFactor": [1, 0, 0, 1]}}],
        "buffers": [{"byteLength": len(points + corners)}],
        "bufferViews": [
            {"buffer": 0, "byteLength": len(points)},
            {"buffer": 0, "byteOffset": len(points), "byteLength": len(corners)},
        ],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 8, "type": "VEC3"},
            {"bufferView": 1, "componentType": 5123, "count": 36, "type": "SCALAR"},
        ],
        **(top or {}),
    }
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text
    chunks += struct.pack("<I4s", len(points + corners), b"BIN\0") + points + corners
    return b"glTF" + struct.pack("<II", 2, 12 + len(chunks)) + chunks


@pytest.fixture(scope="module")
def crane(tmp_path_factory: pytest.TempPathFactory) -> CraneDescription:
    """The loader with a rotator and a driven grapple, which has a mesh."""
    folder = tmp_path_factory.mktemp("crane")
    (folder / "meshes").mkdir()
    (folder / "meshes" / "jaw.glb").write_bytes(box(LOW, HIGH))
    text = LOADER.read_text(encoding="utf-8")
    begin, end = text.index("[grapple]"), text.index("[start]")
    six = f"{text[:begin]}{MORE.read_text(encoding='utf-8')}\n{text[end:]}"
    (folder / "six.toml").write_text(six, encoding="utf-8")
    return read(folder / "six.toml")


@pytest.fixture(scope="module")
def view(crane: CraneDescription, fmu_dir: Path, tmp_path_factory: pytest.TempPathFactory) -> ViewDescription:
    """What the page is told, with the mesh from a system that contains it."""
    system, path = load(fmu_dir / "supply.fmu"), tmp_path_factory.mktemp("page") / "six.ssp"
    return view_description(load(write_ssp(system, path, resources=page_files(crane))))


def test_functions_have_places(view: ViewDescription) -> None:
    """As on a forwarder: telescope on the left wheel, rotator on the right stick, grapple on its wheel."""
    iso, sae = view.patterns.values()
    assert (iso.left, iso.right) == (("slew", "jib"), ("rotator", "boom"))
    assert (sae.left, sae.right) == (("slew", "boom"), ("rotator", "jib"))
    assert iso.wheels == sae.wheels == ("extension", "grapple")
    assert view.functions["extension"] == ("extension in", "extension out")


@shards.browser
def test_wheels_as_in_real_time(script: Any, view: ViewDescription) -> None:
    """Pattern and response curve of a page's own machine are those of the server; missing wheels rest."""
    told = json.loads(json.dumps(page_data(view, None)))
    rows = [[0.05, 1, -1, 0.08], [0.5] * 5, *np.random.default_rng(3).uniform(-1, 1, (50, 6)).tolist()]
    for name, pattern in view.patterns.items():
        asked = [rows, told["patterns"][name], told["curve"]]
        given = script("levers", "a[0].map((r) => m.functions(r, a[1], a[2]))", asked)
        for row, found in zip(rows, given, strict=True):
            expected = functions(StickAxes(*row[:4], tuple(row[4:])), pattern)
            assert found == pytest.approx(expected, abs=1e-15)  # rounding
            assert len(found) == 6


@pytest.fixture(scope="module")
def opened(chromium: Any, crane: CraneDescription, view: ViewDescription) -> Iterator[tuple[Server, Any]]:
    """A server with a stand-in for the crane, and a page that drives."""
    axes = tuple(f"drives.{joint.name}_command" for joint in crane.driven)
    with serving(description=view, parameters=values(manipulator(crane)).p, axes=axes) as server:
        page = chromium.new_page(viewport={"width": 1000, "height": 800})
        page.set_default_timeout(1e3 * LONG)
        page.goto(server.http)
        page.locator(".hm-wheel").nth(1).wait_for()
        page.get_by_role("button", name="Take controls").click()
        page.get_by_role("button", name="Release controls").wait_for()
        yield server, page
        page.close()


def held(press: Callable[[], object], release: Callable[[], object], done: Callable[[], bool]) -> None:
    """Hold until it is done; a page that was slow for a moment wants the dead-man to be held again."""

    def once() -> bool:
        press()
        if until(done, 3.0):
            return True
        release()
        return False

    assert until(once)


def commanded(server: Server) -> dict[str, float]:
    """What moves, by joint [V]."""
    last = server.machine.commands[-1] if server.machine.commands else {}
    return {n.removeprefix("drives.").removesuffix("_command"): round(v, 2) for n, v in last.items() if v}


@shards.browser
def test_six_functions_at_once(opened: tuple[Server, Any]) -> None:
    """All six are held by keys; those that are released rest, and without the dead-man all do."""
    server, page = opened
    board, names = page.keyboard, ["Space", *HELD]
    press, release = (lambda to=to: [to(n) for n in names] for to in (board.down, board.up))
    held(press, release, lambda: commanded(server) == dict(HELD.values()))
    for key in ("u", "a"):
        board.up(key)
    left = dict(pair for key, pair in HELD.items() if key not in ("u", "a"))
    assert until(lambda: commanded(server) == left)
    board.up("Space")
    assert until(lambda: commanded(server) == {})
    for name in names:
        board.up(name)


@shards.browser
def test_wheels_by_hand(opened: tuple[Server, Any]) -> None:
    """A wheel on the screen is its own dead-man and springs back; those of a gamepad need its bumper."""
    server, page = opened
    mouse, at = page.mouse, page.locator(".hm-wheel svg").nth(1).bounding_box()
    x, y = at["x"] + at["width"] / 2, at["y"] + at["height"] / 2

    def drag() -> None:
        mouse.move(x, y)
        mouse.down()
        mouse.move(x - 100, y + 30)

    held(drag, mouse.up, lambda: commanded(server) == {"grapple": -6})
    mouse.up()
    assert until(lambda: commanded(server) == {})
    knob = page.locator(".hm-wheel circle").nth(1)
    assert until(lambda: float(knob.get_attribute("cx")) == 75)
    page.evaluate(PAD)
    press = "(on) => { pad.buttons[7].value = pad.buttons[14].value = 1; pad.buttons[4].pressed = on; }"
    page.evaluate(press, False)
    assert not until(lambda: commanded(server) != {}, 0.3)
    wanted = {"extension": 6, "grapple": -6}
    bumper = (lambda on=on: page.evaluate(press, on) for on in (True, False))
    held(*bumper, lambda: commanded(server) == wanted)
    page.evaluate(press, False)
    assert until(lambda: commanded(server) == {})


SHOWN = entry(__file__, "shown")


@shards.browser
def test_a_mesh_is_where_its_link_is(script: Any, crane: CraneDescription, view: ViewDescription) -> None:
    """Its bounding box is that of its corners, where the mechanics have them if they are the tip."""
    model, rng = Part(manipulator(crane)), np.random.default_rng(4)
    assert view.scene is not None
    free, poses, boxes = [j for j in crane.joints if not j.follows], [], []
    for row in rng.uniform(-1.0, 1.0, (20, len(free))):
        state = {j.coordinate: q if j.kind == "revolute" else 1 + q for j, q in zip(free, row, strict=True)}
        corners = list[list[float]]()
        for right, up, back in itertools.product(*zip(LOW, HIGH, strict=True)):
            model.p |= {"tip_at_x": right, "tip_at_y": -back, "tip_at_z": up}
            shown = model(model.start(**state))[1]
            corners.append([shown["tip_x"], shown["tip_y"], shown["tip_height"]])
        poses.append([shown[name] for name in view.scene.signals])
        boxes.append([np.min(corners, axis=0).tolist(), np.max(corners, axis=0).tolist()])
    given = {"machine": drawing.scene(view.scene, model.p)["machine"], "values": poses}
    for (parts, *found), box in zip(script("rig", SHOWN, given), boxes, strict=True):
        assert parts == 1, "only the mesh, and no beam"
        np.testing.assert_allclose(found, box, atol=1e-6)  # m; positions of some metres in 32 bit


def points(data: bytes, folder: Path) -> tuple[gltf.Mesh, Any]:
    """The only mesh of a file, and its points."""
    (folder / "one.glb").write_bytes(data)
    (mesh,) = gltf.read_file(Location(folder / "one.glb"))
    return mesh, np.frombuffer(mesh.points, "<f4").reshape(-1, 3)


def test_a_node_has_a_place(tmp_path: Path) -> None:
    """Scaled, then turned, then moved; y of the file is upwards; colours are encoded for a screen."""
    half = math.sqrt(0.5)
    data = box((0, 0, 0), (1, 2, 3), translation=[10, 0, 0], rotation=[0, 0, half, half], scale=[2, 1, 1])
    mesh, found = points(data, tmp_path)
    assert mesh.colour == "#ff0000"
    # a quarter turn about z of the file: x to y, y to -x
    np.testing.assert_allclose([found.min(axis=0), found.max(axis=0)], [[8, -3, 0], [10, 0, 2]], atol=1e-6)
    matrix = [0, 2, 0, 0, -1, 0, 0, 0, 0, 0, 1, 0, 10, 0, 0, 1]
    _, same = points(box((0, 0, 0), (1, 2, 3), matrix=matrix), tmp_path)
    np.testing.assert_allclose(same, found, atol=1e-6)


def test_a_damaged_mesh_is_a_problem(tmp_path: Path) -> None:
    """Cut anywhere, it is refused in one line."""
    data = box(LOW, HIGH)
    for size in range(0, len(data), 7):
        message = problem(lambda size=size: points(data[:size], tmp_path))
        assert message.startswith(f"{tmp_path / 'one.glb'}: expected the triangles of a binary glTF 2.0 file")


@pytest.mark.parametrize(
    ("key", "value", "told"),
    [
        ("nodes", [{"mesh": 0, "translation": [10**400, 0, 0]}], "a damaged one: OverflowError"),
        ("nodes", [{"mesh": 0}] * 15_000, "at most 10000 parts of 6000000 points, got more"),
        ("nodes", [{}] * 15_000, "too many"),
        ("materials", [{"pbrMetallicRoughness": {"baseColorFactor": ["nan", 0, 0]}}], "a colour that is no"),
        ("meshes", [{"primitives": [{"mode": 5, "attributes": {"POSITION": 0}}]}], "got points, lines"),
    ],
)
def test_numbers_that_are_none_are_a_problem(key: str, value: Any, told: str, tmp_path: Path) -> None:
    """In one line: numbers that are too large or none, strips, thousands of parts."""
    shown = {"scenes": [{"nodes": [*range(len(value))]}]} if key == "nodes" else {}
    assert told in problem(lambda: points(box(LOW, HIGH, {key: value} | shown), tmp_path))


@table(__file__, "shapes", "shape, told")
def test_mistakes(shape: str, told: str, tmp_path: Path) -> None:
    """File, table and key, what was expected and what was found."""
    (tmp_path / "text.glb").write_text("a mesh", encoding="utf-8")
    (tmp_path / "large.glb").write_bytes(bytes(6_000_000))
    draco = {"extensionsRequired": ["KHR_draco_mesh_compression"]}
    (tmp_path / "packed.glb").write_bytes(box(LOW, HIGH, draco))
    text = LOADER.read_text(encoding="utf-8").replace("[boom]", f"[boom]\nshape = {shape}", 1)
    (tmp_path / "crane.toml").write_text(text, encoding="utf-8")
    message = problem(lambda: read(tmp_path / "crane.toml"))
    assert message.startswith(f"{tmp_path / 'crane.toml'}: [boom] shape: ")
    assert told in message
