"""URDF of a crane, and a crane's file from a URDF.

URDF (ROS) has links with inertia and joints, but no cylinder, no oil and no valve, so an import leaves these
to the user. In our files the frames of all links are parallel at zero; those of a URDF may be turned, and are
turned back. A link at a fixed joint becomes a part of the link that carries it.
"""

from __future__ import annotations

import math
import re
import unicodedata
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.sax.saxutils import quoteattr

import numpy as np
from lxml import etree
from scipy.spatial.transform import Rotation

from fmus.crane.axes import AxisCheck, Speeds, stops
from fmus.crane.description import (
    AXES,
    ENDS,
    INERTIAS,
    MOST_JOINTS,
    SYMMETRIC,
    CraneDescription,
    JointDescription,
)
from fmus.crane.machine import taken
from orchestrator.base.errors import Mistakes, Problem, one_line
from orchestrator.base.files import Location, write_whole
from orchestrator.base.numerals import real
from orchestrator.base.text import first_names, grouped
from orchestrator.data.table import Array

BASE = "base"
XACRO = "xacro {} > robot.urdf"
ALIGNED, ROUNDED = 0.3, 1e-6  # deg: of an axis that is taken as x, y or z: pi/2 as 1.57, of 17 digits
MOST_BYTES = 16_000_000
ROUNDING = 1e-12  # of numbers that become zero
RADIUS = 0.06  # m, of the bars that are shown
DIRECTIONS = {n: (-1.0 if n[0] == "-" else 1.0) * np.eye(3)["xyz".index(n[-1])] for n in AXES}


# ---- export


def left_out(crane: CraneDescription) -> Iterator[str]:
    """What a URDF has no place for."""
    for j in (j for j in crane.joints if j.sequenced):
        yield f"note: {j.name}: moves freely: a mimic joint cannot follow {j.follows} in a part of its way"


def export(crane: CraneDescription, found: Sequence[AxisCheck], speeds: Mapping[str, Speeds]) -> str:
    """The text of a URDF.

    Ranges are those of the strokes, effort and velocity the largest ones of the check; speeds: by joint, of
    the drives that are built by default.
    """
    axes = {a.joint.name: a for a in found}
    links = "".join(_link(crane, j) for j in crane.joints)
    joints = "".join(_joint(j, _limits(crane, j, axes, speeds)) for j in crane.joints)
    name = quoteattr(crane.file.stem)
    return f'<?xml version="1.0"?>\n<robot name={name}>\n  <link name="{BASE}"/>\n{links}{joints}</robot>\n'


def _vector(values: Any) -> str:
    return " ".join(f"{x:.17g}" for x in values)


def _link(crane: CraneDescription, j: JointDescription) -> str:
    inertia = " ".join(f'i{n}="{j[f"inertia_{n}"]:.17g}"' for n in INERTIAS)
    ends = [o.vector("at") for o in crane.joints if o.parent == j.name]
    bars = "".join(_bar(end) for end in ends if math.hypot(*end) > RADIUS)
    centre = _vector(j.vector("centre"))
    return (
        f'  <link name="{j.name}">\n    <inertial>\n      <origin xyz="{centre}"/>\n'
        f'      <mass value="{j["mass"]:.17g}"/>\n      <inertia {inertia}/>\n'
        f"    </inertial>\n{bars}  </link>\n"
    )


def _bar(end: Array) -> str:
    """What is shown of a link: a bar from its joint to the next one."""
    long = float(np.linalg.norm(end))
    turn = f"0 {math.acos(end[2] / long):.9g} {math.atan2(end[1], end[0]):.9g}"
    shape = f'<cylinder radius="{RADIUS}" length="{long:.9g}"/>'
    place = f'<origin xyz="{_vector(end / 2)}" rpy="{turn}"/>'
    return f"    <visual>{place}<geometry>{shape}</geometry></visual>\n"


def _limits(
    crane: CraneDescription,
    j: JointDescription,
    axes: Mapping[str, AxisCheck],
    speeds: Mapping[str, Speeds],
) -> tuple[float, float, float, float]:
    """Ends of the coordinate, effort and velocity; zeros of a joint that nothing drives."""
    if a := axes.get(j.name):
        largest = max(map(abs, speeds[j.name]["lumped"][:2]))
        return a.low, a.high, max(a.push, a.pull) * a.levers[1], largest
    if not j.follows:
        return *stops(j), 0.0, 0.0
    low, high, effort, velocity = _limits(crane, crane.joint(j.follows), axes, speeds)
    ratio = j["ratio"]
    low, high = sorted(map(j.following, (low, high)))
    return low, high, effort / abs(ratio) if ratio else 0.0, abs(ratio) * velocity


def _joint(j: JointDescription, limits: tuple[float, float, float, float]) -> str:
    bounded = math.isfinite(limits[1] - limits[0])
    kind = "continuous" if j.revolute and not bounded else j.kind
    shown = limits if bounded else (-100.0, 100.0, *limits[2:])
    keys = zip(("lower", "upper", "effort", "velocity"), shown, strict=True)
    limit = "    <limit " + " ".join(
        f'{n}="{x:.9g}"' for n, x in keys if kind != "continuous" or n[0] in "ev"
    )
    offset = f' offset="{j["offset"]:.17g}"' if j["offset"] else ""
    of = f'{j.follows}_joint" multiplier="{j["ratio"]:.17g}"{offset}'
    mimic = f'    <mimic joint="{of}/>\n' if j.follows else ""
    if j.sequenced:
        mimic = f"    <!-- follows {j.follows} in a part of its way, which a mimic joint cannot -->\n"
    losses = f'    <dynamics damping="{j["damping"]:.17g}" friction="{j["coulomb"]:.17g}"/>\n'
    return (
        f'  <joint name="{j.name}_joint" type="{kind}">\n    <parent link="{j.parent or BASE}"/>\n'
        f'    <child link="{j.name}"/>\n    <origin xyz="{_vector(j.vector("at"))}"/>\n'
        f'    <axis xyz="{_vector(j.direction)}"/>\n{limit}/>\n{mimic}{losses}'
        "  </joint>\n"
    )


# ---- import


@dataclass(frozen=True)
class _Body:
    """Mass [kg], centre [m] (3,), inertia about the centre [kg.m2] (3, 3)."""

    mass: float
    centre: Array
    inertia: Array

    def moved(self, turn: Array, at: Array) -> _Body:
        """In a frame in which its own has this orientation and place."""
        return _Body(self.mass, at + turn @ self.centre, turn @ self.inertia @ turn.T)

    def __add__(self, other: _Body) -> _Body:
        mass = self.mass + other.mass
        if not mass:
            return self
        centre = (self.mass * self.centre + other.mass * other.centre) / mass
        return _Body(mass, centre, self._about(centre) + other._about(centre))

    def _about(self, point: Array) -> Array:
        d = self.centre - point
        return self.inertia + self.mass * (d @ d * np.eye(3) - np.outer(d, d))


NOTHING = _Body(0.0, np.zeros(3), np.zeros((3, 3)))


def imported(source: Path, target: Path) -> str:
    """Write the file of a crane from a URDF; returns what is still missing. A Problem for each mistake."""
    if target.suffix != ".toml" or target.exists():
        expected = "a file that ends in .toml" if target.suffix != ".toml" else "a file that does not exist"
        raise Problem(f"{target}: expected {expected}")
    try:
        return _imported(source, target)
    except (OSError, etree.XMLSyntaxError, ValueError, KeyError, AttributeError, RecursionError) as reason:
        raise Problem(f"{source}: expected a URDF: {reason}") from None


def _imported(source: Path, target: Path) -> str:
    parser = etree.XMLParser(resolve_entities=False, no_network=True)
    robot = etree.fromstring(Location(source).read(MOST_BYTES), parser)
    if robot.tag != "robot":
        raise Problem(f"{source}: expected the element robot, got {robot.tag}")
    for element in robot.iter(etree.Element):
        if "/xacro" in element.tag or any(re.search(r"\$[{(]", x) for x in element.attrib.values()):
            where = f"line {element.sourceline}: {etree.QName(element).localname}"
            raise Problem(f"{source}: {where}: expected a URDF, got xacro; first: {XACRO.format(source)}")
    links, joints = robot.findall("link"), robot.findall("joint")
    names, below = Counter(x.get("name", "") for x in links), grouped(joints, lambda j: _of(j, "parent"))
    under, moving = Counter(_of(j, "child") for j in joints), [j for j in joints if j.get("type") != "fixed"]
    called, roots = Counter(str(j.get("name")) for j in joints), [n for n in names if n not in under]
    if len(roots) != 1:
        raise Problem(f"{source}: expected one link without a parent, got {first_names(roots) or 'none'}")
    for expected, wrong in {
        "one link of a name": [n for n, count in names.items() if count > 1],
        "one joint of a name": [n for n, count in called.items() if count > 1],
        "one joint to a link": [n for n, count in under.items() if count > 1],
        "links that exist": sorted((under.keys() | below.keys()) - names.keys()),
    }.items():
        if wrong:
            raise Problem(f"{source}: {first_names(wrong)}: expected {expected}")
    if not 0 < len(moving) <= MOST_JOINTS:
        raise Problem(f"{source}: expected 1 to {MOST_JOINTS} joints that move, got {len(moving)}")
    bodies, words = {x.get("name", ""): _body(x) for x in links}, _words(str(j.get("name")) for j in moving)
    tables, notes, left = _walk(source, bodies, below, words, {}, roots[0])
    if left:
        raise Problem(f"{source}: {first_names(left)}: expected joints from {roots[0]} to all links")
    if meshes := {x.get("filename", "") for x in robot.iter("mesh")}:
        files = first_names(sorted(meshes))
        notes.append(f"note: left out: {files}: shape of a joint takes a mesh in a binary glTF file (.glb)")
    passive = [name for name, table in tables.items() if "follows" not in table]
    note = "from a URDF"
    if turned_by := _along_x(tables):
        note += f", turned by {turned_by} deg about z, so that the arm lies along x"
        notes.append(f"note: {note}")
    text = "".join(_lines(tables, str(robot.get("name") or source.stem), note))
    write_whole(target, text.encode())
    missing = f"drive, cylinder or motor, and hydraulics of the driven ones of {', '.join(passive)}"
    told = f"{target}: {len(tables)} joints. Still missing: {missing}; [payload] at; [start]; [supply]"
    return "\n".join([told, *notes])


def _walk(
    source: Path,
    links: Mapping[str, _Body],
    below: Mapping[str, Sequence[Any]],
    words: Mapping[str, str],
    zeros: Mapping[str, float],
    root: str,
) -> tuple[dict[str, dict[str, Any]], list[str], Mapping[str, _Body]]:
    """Tables of the joints, notes, and the links that no joint leads to; Mistakes of all joints.

    words   joint -> its table
    zeros   joint -> by what its zero is shifted [rad]
    """
    bodies, tables, mistakes, notes = dict(links), dict[str, dict[str, Any]](), list[str](), list[str]()
    stack = [(root, "", np.eye(3), np.zeros(3), list[tuple[Any, Array]]())]
    while stack:  # link, its table, its orientation and place in there; joints on the way, their axes
        link, carrier, turn, offset, way = stack.pop()
        body = bodies.pop(link)
        if carrier:
            tables[carrier]["body"] += body.moved(turn, offset)
        for joint in below.get(link, ()):
            origin, child, name = joint.find("origin"), _of(joint, "child"), str(joint.get("name"))
            at, turned = offset + turn @ _numbers(origin, "xyz", "0 0 0"), turn @ _rotation(origin)
            if joint.get("type") == "fixed":
                stack.append((child, carrier, turned, at, [*way, (joint, np.zeros(3))]))
                continue
            if more := _zero(turned @ _numbers(joint.find("axis"), "xyz", "1 0 0"), way, zeros):
                return _walk(source, links, below, words, {**zeros, **more}, root)
            try:
                table, texts = _table(joint, turned, words, zeros, way)
            except Problem as problem:
                mistakes.append(f"{source}: {name}: {problem}")
                continue
            about = DIRECTIONS[table["axis"]]
            turned = Rotation.from_rotvec(-zeros.get(name, 0.0) * about).as_matrix() @ turned
            tables[words[name]] = {**table, "parent": carrier or BASE, "at": at, "told": texts}
            notes += [f"note: {name}: {text}" for text in texts]
            stack.append((child, words[name], turned, np.zeros(3), [*way, (joint, about)]))
    if mistakes:
        raise Mistakes(mistakes)
    return tables, notes, bodies


def _off(axis: Array) -> tuple[int, float]:
    """The coordinate axis that is nearest to an axis, and the angle between them [deg]."""
    along = int(np.argmax(np.abs(axis)))
    return along, math.degrees(math.atan2(np.linalg.norm(np.delete(axis, along)), abs(axis[along])))


def _zero(axis: Array, way: Sequence[tuple[Any, Array]], zeros: Mapping[str, float]) -> dict[str, float]:
    """The last joint on the way whose zero, shifted by an angle [rad], brings an axis along x, y or z.

    Its link is turned about the axis of the joint itself, and all joints behind it with the link.
    """
    for k, (joint, about) in reversed([*enumerate(way)] if _off(axis)[1] > ALIGNED else []):
        across = any(abs(other @ about) < np.abs(other).max() for _, other in way[k:])
        if across or joint.get("type") in ("fixed", "prismatic") or (name := joint.get("name")) in zeros:
            continue
        u = np.roll(np.abs(about), 1)
        angle = math.remainder(math.atan2(axis @ np.cross(about, u), axis @ u), math.pi / 2)
        if _off(Rotation.from_rotvec(-angle * about).apply(axis))[1] <= ALIGNED:
            return {name: angle}
    return {}


def _along_x(tables: Mapping[str, dict[str, Any]]) -> int:
    """Turn all frames about z, so that the arm lies along x with all joints at 0; by how much [deg].

    The arm begins at the first horizontal revolute joint and lies across the axis that most of its revolute
    joints have, or the first of them, on the side where its farthest centre of mass or joint is from there.
    """
    places, arm = dict[str, Array](), dict[str, str]()  # from its first joint; names and axes of its joints
    for name, table in tables.items():
        lies = table["joint"] == "revolute" and table["axis"][-1] != "z"
        if table["parent"] in places or (lies and not places):
            places[name] = places[table["parent"]] + table["at"] if places else np.zeros(3)
            arm |= {name: table["axis"][-1]} if lies else {}
    if not arm:
        return 0
    along = 1 if Counter(arm.values()).most_common(1)[0][0] == "x" else 0
    ends = [at[along] + x for n, at in places.items() for x in (0.0, tables[n]["body"].centre[along])]
    backwards = min(ends) < -max(ends)
    quarters = (1 if backwards else -1) if along else 2 * backwards
    turn = np.rint(Rotation.from_euler("z", 90 * quarters, degrees=True).as_matrix())
    for table in tables.values():
        axis = turn @ DIRECTIONS[table["axis"]]
        table["axis"] = next(n for n, other in DIRECTIONS.items() if np.array_equal(axis, other))
        table["at"], table["body"] = turn @ table["at"], table["body"].moved(turn, np.zeros(3))
    return 90 * quarters


def _table(
    joint: Any,
    turned: Array,
    words: Mapping[str, str],
    zeros: Mapping[str, float],
    way: Sequence[tuple[Any, Array]],
) -> tuple[dict[str, Any], list[str]]:
    """The keys of a joint, whose frame has this orientation, and sentences on what has none."""
    name, zero = str(joint.get("name")), zeros.get(str(joint.get("name")), 0.0)
    kind, axis = joint.get("type"), turned @ _numbers(joint.find("axis"), "xyz", "1 0 0")
    if kind not in ("revolute", "continuous", "prismatic"):
        raise Problem(f"expected a revolute, prismatic or fixed joint, got {kind}")
    if not (size := float(np.linalg.norm(axis))):
        raise Problem("expected an axis, got 0 0 0")
    along, off = _off(axis)
    if off > ALIGNED:
        expected, got = "an axis along x, y or z with all joints at 0", np.round(axis / size, 3)
        frames = ((j.get("name"), _rotation(j.find("origin"))) for j, _ in way)
        oblique = [n for n, frame in frames if max(_off(x)[1] for x in frame) > ALIGNED]
        cause = f"; the origin of {first_names(oblique)} turns it" if oblique else ""
        raise Problem(f"expected {expected}, up to {ALIGNED:g} deg, got {got}, {off:.3g} deg off{cause}")
    direction = ("-" if axis[along] < 0 else "") + "xyz"[along]
    left_out = [f"the {off:.2g} deg between the axis and {direction}"] if off > ROUNDED else []
    table: dict[str, Any] = {
        "joint": "prismatic" if kind == "prismatic" else "revolute",
        "axis": direction,
        "body": NOTHING,
    }
    table["damping"], friction = (_number(joint.find("dynamics"), n) for n in ("damping", "friction"))
    if (mimic := joint.find("mimic")) is not None:
        if not (leader := words.get(mimic.get("joint"))):
            raise Problem(f"expected mimic of a joint that exists and moves, got {mimic.get('joint')}")
        table["follows"], table["ratio"] = leader, _number(mimic, "multiplier", 1.0)
        of_leader = table["ratio"] * zeros.get(str(mimic.get("joint")), 0.0)
        table["offset"] = _number(mimic, "offset") + zero - of_leader
        left_out += [f"dynamics friction {friction:g}"] if friction else []
    else:
        table["friction"] = friction
    limit = joint.find("limit")
    known = {} if limit is None else limit.attrib
    low, high = (_number(limit, n) if n in known else 0.0 for n in ("lower", "upper"))
    within = -ENDS[table["joint"]] <= low < high <= ENDS[table["joint"]]
    used = {"lower", "upper"} if mimic is None and kind != "continuous" and within else set()
    if used:
        table["stop"] = (low + zero, high + zero)
    for tag in ("limit", "safety_controller"):
        given = {} if (found := joint.find(tag)) is None else found.attrib
        nothing = {n for n in ("effort", "velocity") if given.get(n) == "0"}
        others = [f"{n} {x}" for n, x in given.items() if n not in used | nothing]
        left_out += [one_line(" ".join([tag, *others]))] if others else []
    left_out += [] if name in (words[name], f"{words[name]}_joint") else [f"the name {name}"]
    texts = [f"left out: {text}" for text in left_out]
    if zero:
        table |= {"start": zero} if mimic is None else {}
        texts.append(f"zero and limits shifted by {math.degrees(zero):.3g} deg, by which its link is turned")
    return table, texts


def _words(names: Iterable[str]) -> dict[str, str]:
    """Names as those of joints, one word each, all of them different, none that a machine has otherwise.

    Without the ending of an export.
    """
    found, used = dict[str, str](), set(taken())
    for name in names:
        plain = unicodedata.normalize("NFKD", name.removesuffix("_joint"))  # o before the dots of an umlaut
        word = first = re.sub("^[0-9]+|[^a-z0-9]", "", plain.lower()) or "joint"
        number = 2
        while word in used:
            word, number = f"{first}{number}", number + 1
        used.add(word)
        found[name] = word
    return found


def _of(joint: Any, tag: str) -> str:
    found = joint.find(tag)
    return "" if found is None else str(found.get("link", ""))


def _numbers(element: Any, name: str, default: str, count: int = 3) -> Array:
    text = default if element is None else element.get(name, default)
    try:
        found = np.array([*map(real, text.split())])
    except ValueError:
        found = np.empty(0)
    if found.size != count or not np.isfinite(found).all():
        place = f"line {element.sourceline}: {element.tag}"
        raise ValueError(f"{place}: {name}: expected {count} finite numbers, got {text!r}")
    return found


def _number(element: Any, name: str, default: float = 0.0) -> float:
    return float(_numbers(element, name, str(default), 1)[0])


def _rotation(origin: Any) -> Array:
    """Of roll, pitch and yaw about fixed axes."""
    turned: Array = Rotation.from_euler("xyz", _numbers(origin, "rpy", "0 0 0")).as_matrix()
    return turned


def _body(link: Any) -> _Body:
    inertial = link.find("inertial")
    if inertial is None:
        return NOTHING
    origin, inertia = inertial.find("origin"), inertial.find("inertia")
    own = np.array([_number(inertia, f"i{n}") for n in INERTIAS])[np.array(SYMMETRIC)]
    turn, mass = _rotation(origin), _number(inertial.find("mass"), "value")
    return _Body(mass, _numbers(origin, "xyz", "0 0 0"), turn @ own @ turn.T)


def _lines(tables: Mapping[str, Mapping[str, Any]], title: str, note: str) -> Iterator[str]:
    yield f'title = {quoteattr(title)}\nsource = "assumed"\nnote = "{note}"\n'
    for name, table in tables.items():
        body: _Body = table["body"]
        entries = {"at": table["at"], "mass": body.mass, "centre": body.centre}
        entries["inertia"] = body.inertia.ravel()[[0, 4, 8, 1, 2, 5]]
        entries |= {n: table[n] for n in ("damping", "friction", "ratio", "offset") if n in table}
        yield f"\n[{name}]\n"
        yield from (f"# {text}\n" for text in table["told"])
        yield from (f'{n} = "{table[n]}"\n' for n in ("joint", "axis", "parent", "follows") if n in table)
        yield from (f"{n} = {_toml(value)}\n" for n, value in entries.items())
        if stop := table.get("stop"):  # a cylinder ends at its stroke instead
            yield f"stop = {{ from = {_toml(stop[0])}, at = {_toml(stop[1])} }}\n"
    yield f'\n[payload]\non = "{[*tables][-1]}"\nat = [0, 0, 0]  # the tip\n\n[start]\n'
    for name, table in tables.items():
        zero, (low, high) = table.get("start", 0.0), table.get("stop", (-math.inf, math.inf))
        if start := min(max(zero, low), high):
            yield f"{name} = {_toml(start)}\n"


def _toml(value: Any) -> str:
    if isinstance(value, float | int):
        return repr(float(value)) if abs(value) > ROUNDING else "0"
    return "[" + ", ".join(_toml(float(x)) for x in value) + "]"
