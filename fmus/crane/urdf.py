"""URDF of a crane, and a crane's file from a URDF.

URDF (ROS) has links with inertia and joints, but no cylinder, no oil and no valve, so an import leaves these
to the user. In our files the frames of all links are parallel at zero; those of a URDF may be turned, and are
turned back. A link at a fixed joint becomes a part of the link that carries it.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.sax.saxutils import quoteattr

import numpy as np
from lxml import etree

from fmus.crane.check import AxisCheck
from fmus.crane.description import INERTIAS, SYMMETRIC, CraneDescription, JointDescription
from orchestrator.base.errors import Mistakes, Problem
from orchestrator.base.files import write_whole
from orchestrator.data.table import Array

BASE = "base"
ALIGNED = 1e-6  # largest component of an axis across its direction
ROUNDING = 1e-12  # of numbers that become zero
RADIUS = 0.06  # m, of the bars that are shown


# ---- export


def export(crane: CraneDescription, found: list[AxisCheck]) -> str:
    """The text of a URDF; ranges are those of the strokes."""
    ranges = {a.joint.name: (a.low, a.high) for a in found}
    links = "".join(_link(crane, j) for j in crane.joints)
    joints = "".join(_joint(j, *ranges.get(j.name, (-math.inf, math.inf))) for j in crane.joints)
    name = quoteattr(crane.file.stem)
    return f'<?xml version="1.0"?>\n<robot name={name}>\n  <link name="{BASE}"/>\n{links}{joints}</robot>\n'


def _vector(values: Any) -> str:
    return " ".join(f"{x:.17g}" for x in values)


def _link(crane: CraneDescription, j: JointDescription) -> str:
    inertia = " ".join(f'i{n}="{j[f"inertia_{n}"]:.17g}"' for n in INERTIAS)
    ends = [[o[f"at_{n}"] for n in "xyz"] for o in crane.joints if o.parent == j.name]
    bars = "".join(_bar(np.array(end)) for end in ends if math.hypot(*end) > RADIUS)
    centre = _vector(j[f"centre_{n}"] for n in "xyz")
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


def _joint(j: JointDescription, low: float, high: float) -> str:
    sign = -1 if j.axis[0] == "-" else 1
    axis = _vector(sign * (n == j.axis[-1]) for n in "xyz")
    bounded = math.isfinite(high - low)
    kind = j.kind if bounded or j.kind == "prismatic" else "continuous"
    ends = (low, high) if bounded else (-100.0, 100.0)
    limit = f'    <limit lower="{ends[0]:.9g}" upper="{ends[1]:.9g}" effort="0" velocity="0"/>\n'
    mimic = f'    <mimic joint="{j.follows}_joint" multiplier="{j.ratio.value:.17g}"/>\n' if j.follows else ""
    damping = f'    <dynamics damping="{j["damping"]:.17g}"/>\n'
    return (
        f'  <joint name="{j.name}_joint" type="{kind}">\n    <parent link="{j.parent or BASE}"/>\n'
        f'    <child link="{j.name}"/>\n    <origin xyz="{_vector(j[f"at_{n}"] for n in "xyz")}"/>\n'
        f'    <axis xyz="{axis}"/>\n{"" if kind == "continuous" else limit}{mimic}{damping}  </joint>\n'
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
    robot = etree.fromstring(source.read_bytes(), parser)
    if robot.tag != "robot":
        raise Problem(f"{source}: expected the element robot, got {robot.tag}")
    mistakes, joints = list[str](), robot.findall("joint")
    bodies = {link.get("name", ""): _body(link) for link in robot.findall("link")}
    children = {_of(j, "child") for j in joints}
    roots = [name for name in bodies if name not in children]
    if len(roots) != 1:
        raise Problem(f"{source}: expected one link without a parent, got {', '.join(roots) or 'none'}")
    tables = dict[str, dict[str, Any]]()
    _walk(roots[0], "", np.eye(3), np.zeros(3), joints, bodies, tables, mistakes)
    if mistakes:
        raise Mistakes([f"{source}: {text}" for text in mistakes])
    passive = [name for name, table in tables.items() if "follows" not in table]
    text = "".join(_lines(tables, str(robot.get("name") or source.stem)))
    write_whole(target, text.encode())
    missing = f"drive, cylinder or motor, and hydraulics of the driven ones of {', '.join(passive)}"
    return f"{target}: {len(tables)} joints. Still missing: {missing}; [payload] at; [start]; [supply]"


def _of(joint: Any, tag: str) -> str:
    found = joint.find(tag)
    return "" if found is None else str(found.get("link", ""))


def _numbers(element: Any, name: str, default: str) -> Array:
    return np.array([float(x) for x in (default if element is None else element.get(name, default)).split()])


def _rotation(origin: Any) -> Array:
    """Of roll, pitch and yaw about fixed axes."""
    (r, p, y) = _numbers(origin, "rpy", "0 0 0")
    (a, b), (c, d), (e, f) = ((math.cos(x), math.sin(x)) for x in (r, p, y))
    about_x, about_y = (
        np.array([[1, 0, 0], [0, a, -b], [0, b, a]]),
        np.array([[c, 0, d], [0, 1, 0], [-d, 0, c]]),
    )
    turned: Array = np.array([[e, -f, 0], [f, e, 0], [0, 0, 1]]) @ about_y @ about_x
    return turned


def _body(link: Any) -> _Body:
    inertial = link.find("inertial")
    if inertial is None:
        return _Body(0.0, np.zeros(3), np.zeros((3, 3)))
    origin, inertia = inertial.find("origin"), inertial.find("inertia")
    moments = [0.0 if inertia is None else float(inertia.get(f"i{n}", 0)) for n in INERTIAS]
    own = np.array(moments)[np.array(SYMMETRIC)]
    turn, mass = _rotation(origin), float(inertial.find("mass").get("value"))
    return _Body(mass, _numbers(origin, "xyz", "0 0 0"), turn @ own @ turn.T)


def _walk(
    link: str,
    carrier: str,
    turn: Array,
    offset: Array,
    joints: list[Any],
    bodies: Mapping[str, _Body],
    tables: dict[str, dict[str, Any]],
    mistakes: list[str],
) -> None:
    """Tables of the joints beyond a link.

    carrier        the table that its body belongs to, "" for the base
    turn, offset   of the frame of the link in the frame of that table
    """
    if carrier:
        tables[carrier]["body"] += bodies[link].moved(turn, offset)
    for joint in (j for j in joints if _of(j, "parent") == link):
        origin, child, kind = joint.find("origin"), _of(joint, "child"), joint.get("type")
        at, turned = offset + turn @ _numbers(origin, "xyz", "0 0 0"), turn @ _rotation(origin)
        if kind == "fixed":
            _walk(child, carrier, turned, at, joints, bodies, tables, mistakes)
            continue
        if kind not in ("revolute", "continuous", "prismatic"):
            mistakes.append(f"{joint.get('name')}: expected a revolute, prismatic or fixed joint, got {kind}")
            continue
        name = re.sub("[^a-z0-9]", "", child.lower()) or "joint"
        axis = turned @ _numbers(joint.find("axis"), "xyz", "1 0 0")
        along = int(np.argmax(np.abs(axis)))
        if name in tables or np.abs(np.delete(axis, along)).max() > ALIGNED:
            what = "a name of its own" if name in tables else "an axis along x, y or z with all joints at 0"
            mistakes.append(f"{joint.get('name')}: expected {what}, got {name if name in tables else axis}")
            continue
        mimic, dynamics = joint.find("mimic"), joint.find("dynamics")
        tables[name] = {
            **{"joint": "prismatic" if kind == "prismatic" else "revolute", "parent": carrier or BASE},
            **{"axis": ("-" if axis[along] < 0 else "") + "xyz"[along], "at": at},
            "damping": 0.0 if dynamics is None else float(dynamics.get("damping", 0)),
            "body": _Body(0.0, np.zeros(3), np.zeros((3, 3))),
        }
        if mimic is not None:
            leader = next((_of(j, "child") for j in joints if j.get("name") == mimic.get("joint")), "")
            tables[name]["follows"] = re.sub("[^a-z0-9]", "", leader.lower())
            tables[name]["ratio"] = float(mimic.get("multiplier", 1))
        _walk(child, name, turned, np.zeros(3), joints, bodies, tables, mistakes)


def _lines(tables: Mapping[str, Mapping[str, Any]], title: str) -> Iterator[str]:
    yield f'title = {quoteattr(title)}\nsource = "assumed"\nnote = "from a URDF"\n'
    for name, table in tables.items():
        body: _Body = table["body"]
        entries = {"at": table["at"], "mass": body.mass, "centre": body.centre}
        entries |= {
            "inertia": [body.inertia[i // 3, i % 3] for i in (0, 4, 8, 1, 2, 5)],
            "damping": table["damping"],
        }
        entries |= {"ratio": table["ratio"]} if "ratio" in table else {}
        yield f"\n[{name}]\n"
        yield from (f'{n} = "{table[n]}"\n' for n in ("joint", "axis", "parent", "follows") if n in table)
        yield from (f"{n} = {_toml(value)}\n" for n, value in entries.items())
    yield f'\n[payload]\non = "{[*tables][-1]}"\nat = [0, 0, 0]  # the tip\n'


def _toml(value: Any) -> str:
    if isinstance(value, float | int):
        return repr(float(value)) if abs(value) > ROUNDING else "0"
    return "[" + ", ".join(_toml(float(x)) for x in value) + "]"
