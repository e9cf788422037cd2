"""Cranes as URDF: another library reads the same mechanics, and a foreign URDF becomes a crane."""

import os
import re
from operator import attrgetter
from pathlib import Path
from xml.etree import ElementTree

import casadi as ca
import numpy as np
import pytest
from crane.rigid_bodies import mass_and_weight
from kit.cranes import checked, crane
from kit.mistakes import entry, problem
from kit.needs import needs

from fmus.components.chain import Chain
from fmus.contract import nested
from fmus.crane.axes import capacity
from fmus.crane.check import check
from fmus.crane.description import read
from fmus.crane.manipulator import manipulator
from fmus.crane.urdf import export, imported, left_out
from fmus.parameters import values

JOINT = """<joint name="{}" type="revolute"><parent link="{}"/><child link="{}"/></joint>"""
FOREIGN = entry(__file__, "foreign")


# of the loader, made up: to both sides, and of the oil
SPEEDS = {j.name: {"lumped": (0.5 + k, -1.0 - k, 9.0)} for k, j in enumerate(crane().driven)}


def same(pin, crane, text, q, shift=0.0):
    """M and G of a crane whose joints are all free are those of Pinocchio's reader, within rounding.

    shift   of the crane's coordinates
    """
    sub = manipulator(crane)
    own = sub.model
    chain = own.chain(nested(own.parameters, values(sub).p))
    links = [type(link)(**{**vars(link), "follows": None}) for link in chain.links]
    motion = Chain(tuple(links), (0, 0, -9.81)).equations(ca.SX(q + shift), ca.SX(0 * q))
    model = pin.buildModelFromXML(text)
    model.gravity.linear = np.array([0.0, 0.0, -9.81])
    place = pin.integrate(model, pin.neutral(model), q)  # a continuous joint has the sine and cosine
    expected = mass_and_weight(pin, model, model.createData(), place)
    for own, other in zip((motion.mass, ca.vec(motion.gravity)), expected, strict=True):
        found = ca.evalf(own).full().reshape(other.shape)
        np.testing.assert_allclose(found, other, rtol=0, atol=1e-12 * np.abs(other).max())


def test_an_export_has_the_same_mechanics_in_pinocchio(pin):
    """M and G of the loader at random coordinates, its second stage as a joint of its own."""
    text = export(crane(), checked(), SPEEDS).replace('<mimic joint="extension_joint" multiplier="1"/>', "")
    for q in np.random.default_rng(4).uniform(-1, 1, (20, 7)):
        same(pin, crane(), text, q)


def test_a_stage_that_moves_in_a_part_of_a_way_is_told():
    """No mimic joint has the ends of a part; stages that follow all of a way need no note."""
    text = (
        "\n[wing]\nparent = 'boom'\njoint = 'prismatic'\naxis = 'x'\nfollows = 'extension'\nto = 1\n[payload]"
    )
    own = read(Path("own.toml"), crane().file.read_text(encoding="utf-8").replace("[payload]", text).encode())
    (note,) = left_out(own)
    assert note == "note: wing: moves freely: a mimic joint cannot follow extension in a part of its way"


def test_a_foreign_urdf_becomes_a_crane_with_the_same_mechanics(pin, tmp_path):
    """Turned frames are turned back, the link of a fixed joint is a part of its carrier."""
    source, target = tmp_path / "arm.urdf", tmp_path / "arm.toml"
    source.write_text(FOREIGN, encoding="utf-8")
    told = imported(source, target)
    assert "3 joints" in told
    assert "j1, j3, j4" in told
    found = read(target)
    assert capacity(found, check(found)).values[2] == 0.0  # nothing is driven yet
    assert [j["damping"] for j in found.joints] == [0, 7, 0]
    for q in np.random.default_rng(5).uniform(-1, 1, (20, 3)):
        same(pin, found, FOREIGN, q)


def test_an_exported_crane_comes_back(tmp_path):
    """All numbers of links and joints, also the coupled stage; ranges as end stops, with a start within."""
    (tmp_path / "a.urdf").write_text(export(crane(), checked(), SPEEDS), encoding="utf-8")
    imported(tmp_path / "a.urdf", tmp_path / "a.toml")
    again = read(tmp_path / "a.toml")
    check(again)
    for axis in checked()[1:]:
        ends = [again.joint(axis.joint.name)[n] for n in ("stop_from", "stop_at")]
        assert ends == pytest.approx([axis.low, axis.high], rel=1e-8)  # of the digits
    same_of = attrgetter("name", "kind", "axis", "parent", "follows")
    for one, other in zip(crane().joints, again.joints, strict=True):
        assert same_of(one) == same_of(other)
        kept = [n for n in other.numbers if n != "stiffness" and not n.startswith("stop")]
        assert [one[n] for n in kept] == pytest.approx([other[n] for n in kept], abs=1e-11)


TURNED = {  # joints whose links are turned about their own axes, by what, and the shifts of their zeros
    "boom": ({"j3": 0.14}, [0, 0.14, 0]),
    "column": ({"j1": 0.4}, [0.4, 0, 0]),
    "both, one by more than half a right angle": ({"j1": -0.3, "j3": 1.0}, [-0.3, 1.0 - np.pi / 2, 0]),
}


@pytest.mark.parametrize(("turned", "shifts"), TURNED.values(), ids=TURNED)
def test_a_link_turned_about_its_own_axis_shifts_its_zero(pin, tmp_path, turned, shifts):
    """The mechanics at shifted coordinates are those of Pinocchio; limits and start follow, and are told."""
    source, target, text = tmp_path / "arm.urdf", tmp_path / "arm.toml", FOREIGN
    text = text.replace('xyz="0 0 0.5"', f'xyz="0 0 0.5" rpy="0 0 {turned.get("j1", 0.0)}"')
    text = text.replace(TURN, f'rpy="{np.pi / 2 + turned.get("j3", 0.0)!r} 0 0')
    source.write_text(text, encoding="utf-8")
    told, found = imported(source, target), read(target)
    for joint, shift in zip(found.joints, shifts, strict=True):
        line = f"note: {joint.name}: zero and limits shifted by {np.degrees(shift):.3g} deg"
        assert (line in told) == bool(shift)
        assert joint.start.value == pytest.approx(np.clip(shift, *((-1, 1) if shift else (0, 0))))
    ends = [found.joint("j3")[n] for n in ("stop_from", "stop_at")]
    assert ends == pytest.approx([-1 + shifts[1], 1 + shifts[1]], abs=1e-12)
    for q in np.random.default_rng(6).uniform(-1, 1, (5, 3)):
        same(pin, found, text, q, np.array(shifts))


@pytest.mark.parametrize("yaw", [90, -180, -90])
def test_an_arm_that_lies_along_another_axis_is_turned(tmp_path, yaw):
    """As people draw them, along y or backwards: the same crane as along x, and a note."""
    text = export(crane(), checked(), SPEEDS)
    base = f'<joint name="fixed" type="fixed"><origin rpy="0 0 {np.radians(yaw)}"/><parent link="world"/>'
    base = f'<link name="world"/>{base}<child link="base"/></joint>\n  <link name="base"/>'
    read_as = []
    for name, urdf in {"along": text, "turned": text.replace('<link name="base"/>', base)}.items():
        (tmp_path / f"{name}.urdf").write_text(urdf, encoding="utf-8")
        told = imported(tmp_path / f"{name}.urdf", tmp_path / f"{name}.toml")
        assert (f"turned by {-yaw} deg about z" in told) == (name == "turned")
        read_as.append(read(tmp_path / f"{name}.toml"))
    along, turned = read_as
    for one, other in zip(along.joints, turned.joints, strict=True):
        assert one.axis == other.axis
        assert [other[n] for n in one.numbers] == pytest.approx([one[n] for n in one.numbers], abs=1e-11)


def test_weight_behind_an_upright_arm_turns_nothing(tmp_path):
    """The arm alone decides, from its first horizontal joint on."""
    text = """<robot name="r"><link name="base"/><link name="column"><inertial><origin xyz="-0.9 0 0"/>
<mass value="500"/><inertia ixx="9" iyy="9" izz="9" ixy="0" ixz="0" iyz="0"/></inertial></link>
<link name="boom"><inertial><origin xyz="0.2 0 1"/><mass value="90"/>
<inertia ixx="9" iyy="9" izz="9" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="slew" type="continuous"><parent link="base"/><child link="column"/><axis xyz="0 0 1"/></joint>
<joint name="lift" type="continuous"><parent link="column"/><child link="boom"/><origin xyz="-0.3 0 1"/>
<axis xyz="0 -1 0"/></joint></robot>"""
    (tmp_path / "a.urdf").write_text(text, encoding="utf-8")
    assert "turned" not in imported(tmp_path / "a.urdf", tmp_path / "a.toml")


TURN, Z, NAN = 'rpy="1.5707963267948966 0 0', '<axis xyz="0 0 1"/>', '<axis xyz="nan 0 1"/>'
RING = '<link name="b"/><link name="c"/>' + JOINT.format("j5", "b", "c") + JOINT.format("j6", "c", "b")
REFUSED = {
    "j4: expected a revolute, prismatic or fixed joint, got floating": ("prismatic", "floating"),
    "j3: expected an axis along x, y or z with all joints at 0": (TURN, 'rpy="0.3 0.2 1'),
    "j3: expected an axis along x, y or z with all joints at 0, up to 0.3 deg, got [ 0.     0.955 -0.296], "
    "17.2 deg off; the origin of j2 turns it": ('rpy="0 0 1.57', 'rpy="0 0.3 1.57'),
    "expected one link without a parent": ('<link name="world"/>', '<link name="world"/><link name="b"/>'),
    "expected a URDF: Opening and ending tag mismatch": ("<robot", "<robots"),
    "expected a URDF: line 10: origin: xyz: expected 3 finite numbers, got '0 0 a'": ("0 0 0.5", "0 0 a"),
    "expected a URDF: line 11: axis: xyz: expected 3 finite numbers, got 'nan 0 1'": (Z, NAN),
    "expected a URDF: line 2: mass: value: expected 1 finite numbers, got 'inf'": ("200", "inf"),
    "j1: expected an axis, got 0 0 0": (Z, '<axis xyz="0 0 0"/>'),
    "slide: expected one joint to a link": ("</robot>", JOINT.format("j5", "arm", "slide") + "</robot>"),
    "arm: expected one link of a name": ("</robot>", '<link name="arm"/></robot>'),
    "leg: expected links that exist": ("</robot>", JOINT.format("j5", "arm", "leg") + "</robot>"),
    "b, c: expected joints from world to all links": ("</robot>", f"{RING}</robot>"),
    "j4: expected mimic of a joint that exists and moves, got j9": (
        "</joint></r",
        '<mimic joint="j9"/></joint></r',
    ),
}


ROUNDED = {"1.5707": "0.0055", "1.57": "0.046", "-1.5708": "0.00021"}


@pytest.mark.parametrize(("written", "off"), ROUNDED.items())
def test_rounded_angles_give_the_nearest_axis_and_a_note(tmp_path, written, off):
    """With the angle that is left; joints behind it are imported, too."""
    source, target = tmp_path / "arm.urdf", tmp_path / "arm.toml"
    source.write_text(FOREIGN.replace(TURN, f'rpy="{written} 0 0'), encoding="utf-8")
    told = imported(source, target).splitlines()
    slide = "-x" if written[0] == "-" else "x"  # its frame is turned back about y behind that turn
    assert f"note: j4: left out: the {off} deg between the axis and {slide}" in told
    axes = ["z", "y", "x"] if slide == "x" else ["z", "-y", "x"]  # an arm along -x is turned
    assert [j.axis for j in read(target).joints] == axes


def test_what_a_crane_has_no_key_for_is_told_and_a_comment(tmp_path):
    """Effort and velocity, limits and dry friction of a coupled joint, names with other letters, meshes."""
    source, target = tmp_path / "arm.urdf", tmp_path / "arm.toml"
    more = '<mimic joint="j3" multiplier="2" offset="0.3"/><dynamics damping="3" friction="40"/>'
    mesh = '<link name="slide"><visual><geometry><mesh filename="a.stl"/></geometry></visual>'
    text = FOREIGN.replace("</joint></robot>", f"{more}</joint></robot>")
    source.write_text(text.replace('<link name="slide">', mesh), encoding="utf-8")
    told, text = imported(source, target), target.read_text(encoding="utf-8")
    for joint, lost in {
        "j3": "limit effort 1 velocity 1",
        "j4": "dynamics friction 40\nnote: j4: left out: limit lower 0 upper 1 effort 1 velocity 1",
    }.items():
        assert f"note: {joint}: left out: {lost}" in told
        assert f"# left out: {lost.splitlines()[0]}" in text.splitlines()
    assert "note: left out: a.stl: shape of a joint takes a mesh in a binary glTF file" in told
    _, arm, slide = read(target).joints
    assert (slide.follows, slide["ratio"], slide["offset"], slide["damping"]) == ("j3", 2, 0.3, 3)
    assert (arm["stop_from"], arm["stop_at"]) == (-1, 1)


NAMES = {
    "return": "return2",
    "Boom-Link": "boomlink",
    "2nd arm": "ndarm",
    "relief": "relief2",
    "été": "ete",
    "Löffel": "loffel",
}


@pytest.mark.parametrize(("name", "word"), NAMES.items())
def test_any_name_becomes_one_of_a_joint(tmp_path, name, word):
    """One word, none that a machine has otherwise, and another one than those before it."""
    source, target = tmp_path / "a.urdf", tmp_path / "a.toml"
    text = JOINT.format(name, "base", "first") + JOINT.format(f"{name}_", "first", "second")
    links = "".join(f'<link name="{n}"/>' for n in ("base", "first", "second"))
    source.write_text(f'<robot name="r">{links}{text}</robot>', encoding="utf-8")
    told = imported(source, target)
    assert [read_names(target)[0], f"note: {name}: left out: the name {name}" in told] == [word, True]
    assert len(set(read_names(target))) == 2


def read_names(path):
    """Names of the joints of a file."""
    return re.findall(r"^\[(\w+)\]$", path.read_text(encoding="utf-8"), re.MULTILINE)[:2]


def test_effort_and_velocity_are_those_of_the_check():
    """Force times the largest lever; the coupled stage moves with the first one; no ends of the slew."""
    joints = ElementTree.fromstring(export(crane(), checked(), SPEEDS)).findall("joint")
    limits = {j.get("name"): j.find("limit").attrib for j in joints}
    slew, boom, _, extension = checked()
    for axis, speed in ((slew, 1.0), (boom, 2.0), (extension, 4.0)):
        limit = limits[f"{axis.joint.name}_joint"]
        effort = max(axis.push, axis.pull) * axis.levers[1]
        assert [float(limit[n]) for n in ("effort", "velocity")] == pytest.approx([effort, speed])
    assert limits["second_joint"] == limits["extension_joint"]
    assert "lower" not in limits["slew_joint"]


XACRO = (
    ("<robot name", '<robot xmlns:xacro="http://www.ros.org/wiki/xacro" name'),
    ("</robot>", '<xacro:include filename="a.xacro"/></robot>'),
)


@pytest.mark.parametrize("changes", [XACRO, [('"200"', '"${mass}"')], [('"0 0 0.5"', '"$(arg place)"')]])
def test_xacro_is_told_from_a_urdf(tmp_path, changes):
    """Elements of its name space or expressions: they are to be expanded first."""
    source, text = tmp_path / "arm.urdf", FOREIGN
    for change in changes:
        text = text.replace(*change)
    source.write_text(text, encoding="utf-8")
    told = problem(lambda: imported(source, tmp_path / "arm.toml"))
    assert re.match(rf"{source}: line \d+: \w+: expected a URDF, got xacro; first: xacro {source} >", told)


def chain_of(joints):
    """A URDF of these joints: type, parent, child."""
    links = dict.fromkeys(x for _, *ends in joints for x in ends)
    text = "".join(f'<link name="{n}"/>' for n in links)
    for k, (kind, parent, child) in enumerate(joints):
        text += JOINT.format(f"j{k}", parent, child).replace("revolute", kind)
    return f'<robot name="r">{text}</robot>'


STAR = [("revolute", "a", f"b{k}") for k in range(20_000)]
DIAMONDS = [("fixed", f"l{k}", f"l{k + 1}") for k in range(26) for _ in "ab"]
BOMBS = [
    ("expected 1 to 60 joints that move, got 20000", STAR),
    ("expected 1 to 60 joints that move, got 0", [("fixed", *ends) for _, *ends in STAR]),
    ("l1, l2, l3, l4 and 22 more: expected one joint to a link", DIAMONDS),
    ("expected one link without a parent, got none", []),
    ("expected one link without a parent, got none", [("revolute", "a", "b"), ("revolute", "b", "a")]),
]


@pytest.mark.parametrize(("line", "change"), [*REFUSED.items(), *BOMBS], ids=lambda x: str(x)[:60])
@pytest.mark.timeout(30)  # of which it takes 1; with the square of the joints it takes minutes
def test_what_a_crane_cannot_have_is_told_at_once(tmp_path, line, change):
    """With file, joint, expected and found; not after the square of the joints, or a power of two."""
    source = tmp_path / "arm.urdf"
    text = FOREIGN.replace(*change) if isinstance(change, tuple) else chain_of(change)
    source.write_text(text, encoding="utf-8")
    assert f"{source}: {line}" in problem(lambda: imported(source, tmp_path / "arm.toml"))


@pytest.mark.timeout(30)
def test_a_long_chain_of_plates_is_one_link(tmp_path):
    """5000 fixed joints behind a joint that moves: no limit of recursion."""
    source, target = tmp_path / "plates.urdf", tmp_path / "plates.toml"
    joints = [("revolute", "a", "l0"), *(("fixed", f"l{k}", f"l{k + 1}") for k in range(5000))]
    source.write_text(chain_of(joints), encoding="utf-8")
    assert "1 joints" in imported(source, target)


@needs("POSIX", "Windows has no such pipes")
def test_only_files_are_read(tmp_path):
    """A device has no end, a pipe waits for its other end: neither is opened."""
    os.mkfifo(tmp_path / "pipe")
    for source in (Path("/dev/zero"), tmp_path / "pipe"):
        for call in (lambda s=source: imported(s, tmp_path / "a.toml"), lambda s=source: read(s)):
            assert f"{source}: expected a file, got a device or a pipe" in problem(call)
