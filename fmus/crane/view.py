"""The page of a crane: levers, gauges, charts and the drawing, as a view description (`resources/view.toml`).

Joints and cylinders of the drawing follow the parameters of the FMU. Beams and brackets have the sizes of the
description; their thickness is made up.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from typing import Any

from fmus.crane.controller import controlled
from fmus.crane.description import CraneDescription, JointDescription
from fmus.crane.manipulator import manipulator
from orchestrator.base.errors import Problem

COLOURS = ("#009e73", "#0072b2", "#d55e00", "#cc79a7", "#e69f00", "#56b4e9", "#7d7d7d")  # Okabe and Ito 2008
RATE = {"motor": 3.0, "cylinder": 10.0, "four-bar": 10.0}  # V/s, ramps of the levers
FULL = {"motor": 4.0, "cylinder": 6.0, "four-bar": 6.0}  # V at full deflection
SLENDER, TAPER, LEAST = (
    0.042,
    0.86,
    0.09,
)  # depth of the first beam over the reach, of the next one, least [m]
BRACKET = 0.16  # m, half the foot of a bracket
NEAR = 0.06  # m: a pin so near to the line of its beam has no bracket
PEDESTAL = 0.3  # m, radius
# of the camera and the point that it looks at, over the reach
VIEWS = {
    "quarter": (0.85, -1.25, 0.5, 0.28, 0.0, 0.17),
    "side": (0.3, -1.75, 0.25, 0.3, 0.0, 0.15),
    "top": (0.2, -0.01, 1.9, 0.2, 0.0, 0.0),
}
# numbers of the functions left and right, sideways, then fore and aft. ISO: slewing and tilt left, lifting
# and telescope or rotator right; SAE: lifting and tilt exchanged
PATTERNS = {"ISO": ((0, 2), (3, 1)), "SAE": ((0, 1), (3, 2))}
STICKS = 4  # functions
MOST = 24  # functions
LEVER = ("lever", "command")
# inputs of the controller: limits in m/s and rad/s, ramps; it stays engaged while the crane comes to rest
TIP_AXES = [
    *({"name": [f"{n}_velocity"], "limit": 1.2, "rate": 2.5} for n in ("radial", "vertical")),
    {"name": ["swing_velocity"], "limit": 0.6, "rate": 0.6},
    {"name": ["engaged"], "limit": 1.0, "rate": 1e3, "rest_delay": 3.0},
]
WORDS = {"motor": ("left", "right"), "revolute": ("up", "down"), "prismatic": ("out", "in")}


def document(crane: CraneDescription) -> bytes:
    """The file."""
    return "".join(f"{key} = {_toml(value)}\n" for key, value in description(crane).items()).encode()


def page_files(crane: CraneDescription) -> dict[str, bytes]:
    """The file, and the meshes of links."""
    meshes = {_mesh(j): j.shape.read_bytes() for j in crane.joints if j.shape}
    return {"view.toml": document(crane), **meshes}


def _mesh(joint: JointDescription) -> str:
    """The file of its mesh, beside the description of the view."""
    return f"{joint.name}.glb"


def _toml(value: Any) -> str:
    """A value as TOML, which is JSON but for tables."""
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{json.dumps(k)} = {_toml(v)}" for k, v in value.items()) + " }"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(map(_toml, value)) + "]"
    return json.dumps(value)


def description(crane: CraneDescription) -> dict[str, Any]:
    """The content of the file."""
    pressure = crane.numbers["supply"]["pressure_setting"].value
    most = math.ceil(1.2e-6 * pressure)  # MPa, end of scales
    pistons, controls = [j for j in crane.driven if j.drive != "motor"], _levers(crane)
    driven = [n for mode in controls["modes"].values() for full in mode["full"].values() for n in full]
    return {
        "full_pressure": 1e6 * most,
        "signals": [f"tip_{n}" for n in "xy"],
        "axes": [
            {"name": [n for n in driven if n.startswith(f"{j.name}_")], "limit": 10.0, "rate": RATE[j.drive]}
            for j in crane.driven
        ]
        + (TIP_AXES if "tip" in controls["modes"] else []),
        "sliders": [_slider()],
        **controls,
        "gauges": _gauges(crane, most),
        "charts": _charts(crane, most),
        "notices": [
            {"name": f"{j.name}_stop_force", "above": 1e3, "text": f"the {j.name} is at an end of its stroke"}
            for j in pistons
        ],
        "scene": _scene(crane),
    }


def _slider() -> dict[str, Any]:
    return {
        **{"name": "payload_mass", "text": "Payload", "unit": "kg"},
        **{"low": 0.0, "high": 1000.0, "step": 10.0, "rate": 1e5},
    }


# ---- controls


def _levers(crane: CraneDescription) -> dict[str, Any]:
    """Functions of the levers, which are positive to the left and towards the operator.

    The first four are on the sticks, the others on wheels. If there are others, telescopes go there first.
    """
    words, full, of = dict[str, Any](), dict[str, Any](), manipulator(crane).model
    order, moved = list(crane.driven), list[str]()
    with suppress(Problem):  # of an arm that its controller does not know
        moved = [j.name for j in controlled(crane)]
    levers_of = LEVER if moved else LEVER[1:]
    if len(order) > STICKS:
        first = sorted(order, key=lambda j: j.kind == "prismatic")[:STICKS]
        order = [*first, *(j for j in order if j not in first)]
    for k, j in enumerate(order[:MOST]):
        ends = WORDS["motor" if j.drive == "motor" else j.kind]
        sign = of.joint(j.name).lever
        if k == 2 or j.kind == "prismatic":  # towards the operator is in, or down
            ends, sign = (ends[1], ends[0]), -sign
        words[j.name] = [f"{j.name} {end}" for end in ends]
        full[j.name] = {f"{j.name}_{n}": sign * FULL[j.drive] for n in levers_of}
    names = [*words, *["none"] * (STICKS - len(words))]
    if "none" in names:
        words["none"] = ["none", "none"]
    hands = {
        n: {h: [names[k] for k in of] for h, of in zip(("left", "right"), two, strict=True)}
        | {"wheels": names[STICKS:]}
        for n, two in PATTERNS.items()
    }
    modes: dict[str, Any] = {"levers": {"full": full}}
    if moved:
        slew, lift, tilt, *_ = moved
        modes["tip"] = {
            "constant": {"engaged": 1.0},
            "words": {lift: ["tip up", "tip down"], tilt: ["tip in", "tip out"]},
            "full": {
                slew: {"swing_velocity": 0.3},
                lift: {"vertical_velocity": 0.8},
                tilt: {"radial_velocity": -0.8},
                **{name: own for name, own in full.items() if name not in moved},
            },
        }
    return {"functions": words, "patterns": hands, "modes": modes}


def _gauges(crane: CraneDescription, most: int) -> list[dict[str, Any]]:
    supply = [{"name": "supply_pressure", "text": "Supply", "unit": "MPa", "high": most}]
    pressures = [
        {"name": f"{j.name}_{end}", "text": f"{j.name.capitalize()}, {text}", "unit": "MPa", "high": most}
        for j in crane.driven
        for end, text in _ends(j)
    ]
    motion = [
        {
            "name": j.coordinate,
            "text": j.name.capitalize(),
            "unit": "°",
            "low": -180,
            "high": 180,
            "digits": 0,
        }
        if j.kind == "revolute"
        else {"name": j.coordinate, "text": j.name.capitalize(), "unit": "m", "digits": 2}
        for j in crane.joints
        if not j.follows
    ]
    tip = [
        {"name": "tip_radius", "text": "Tip, reach", "unit": "m", "digits": 2},
        {
            "name": "tip_height",
            "text": "Tip, height",
            "unit": "m",
            "low": -2,
            "high": _reach(crane),
            "digits": 2,
        },
        {"name": "held_mass", "text": "Load", "unit": "kg", "high": 1000, "digits": 0},
    ]
    power = [{"name": "supply_flow", "text": "Flow", "unit": "L/min", "high": 300, "digits": 0}]
    return [
        {"title": "Pressure", "lines": supply + pressures},
        {"title": "Motion", "lines": motion + tip},
        {"title": "Power", "lines": power},
    ]


def _charts(crane: CraneDescription, most: int) -> list[dict[str, Any]]:
    colours = {j.name: COLOURS[k % len(COLOURS)] for k, j in enumerate(crane.driven)}
    pressures = [
        {"name": f"{j.name}_{end}", "text": f"{j.name}, {text}", "colour": colours[j.name], "dashed": dashed}
        for j in crane.driven
        for (end, text), dashed in zip(_ends(j), (False, True), strict=True)
    ]
    charts = [
        {
            "title": "Pressure",
            "unit": "MPa",
            "ends": [most, 2 * most, 4 * most],
            "both": False,
            "curves": pressures,
        }
    ]
    commands = [
        {"name": f"{j.name}_command", "text": j.name, "colour": colours[j.name]} for j in crane.driven
    ]
    charts.append({"title": "Command", "unit": "V", "ends": [10], "curves": commands})
    for kind, unit, ends in (("revolute", "°/s", [20, 40, 80, 160]), ("prismatic", "m/s", [0.2, 0.5, 1, 2])):
        curves = [
            {"name": f"{j.name}_speed", "text": j.name, "colour": colours[j.name]}
            for j in crane.driven
            if j.kind == kind
        ]
        if curves:
            charts.append({"title": "Speed", "unit": unit, "ends": ends, "curves": curves})
    return charts


def _ends(joint: JointDescription) -> tuple[tuple[str, str], tuple[str, str]]:
    """Signals of the two pressures of a drive, without the joint, and their words."""
    if joint.drive == "motor":
        return ("pressure_a", "port A"), ("pressure_b", "port B")
    return ("head_pressure", "head"), ("rod_pressure", "rod")


# ---- drawing


def _scene(crane: CraneDescription) -> dict[str, Any]:
    reach = _reach(crane)
    joints, cylinders, pressures = dict[str, Any](), dict[str, Any](), dict[str, str]()
    for j in crane.joints:
        at = [_sum((j, f"at_{n}")) for n in "xyz"]
        initial = "" if j.follows else f"initial_{j.coordinate}"
        joints[j.name] = {"parent": _body(j.parent), "at": at, "axis": j.axis, "kind": j.kind}
        joints[j.name] |= {"signal": j.coordinate, "initial": initial}
        if j.drive == "four-bar":
            joints |= _linkage(j)
        if j.kind == "revolute" and j.drive in ("cylinder", "four-bar"):
            cylinders[j.name] = _cylinder(j)
            pressures |= {f"{j.name}_{end}": f"{j.name}_{end}_pressure" for end in ("head", "rod")}
    tip = [f"tip_at_{n}" if crane.numbers["payload"][f"tip_{n}"].value else 0 for n in "xyz"]
    return {
        "joints": joints,
        "cylinders": cylinders,
        "pressures": pressures,
        "tip": {"body": crane.payload_on, "at": tip},
        "views": {n: [round(x * reach, 2) for x in place] for n, place in VIEWS.items()},
        "colours": {"body": "#ecebe6", "edge": "#4c6e5b", "dark": "#343a40", "steel": "#6d757c"},
        "shapes": [*_shapes(crane, reach)],
    }


def _body(parent: str) -> str:
    return parent or "ground"


def _sum(*terms: tuple[JointDescription, str]) -> str | float:
    """A formula of parameters of joints; those that are 0 are none."""
    return " + ".join(f"{j.name}_{n}" for j, n in terms if j[n] != 0) or 0


def _linkage(j: JointDescription) -> dict[str, Any]:
    """Rocker and coupler; their angles are those in the frame of the joint's parent."""
    at = [_sum((j, "at_x"), (j, "pivot_x")), _sum((j, "at_y")), _sum((j, "at_z"), (j, "pivot_z"))]
    body, common = _body(j.parent), {"axis": j.axis}
    return {
        f"{j.name}_rocker": {"parent": body, "at": at, "signal": f"{j.name}_rocker_angle", **common},
        f"{j.name}_coupler": {
            **{"parent": f"{j.name}_rocker", "frame": body, "at": [f"{j.name}_rocker", 0, 0]},
            **{"signal": f"{j.name}_coupler_angle", **common},
        },
    }


def _cylinder(j: JointDescription) -> dict[str, Any]:
    base = [_sum((j, "at_x"), (j, "base_x")), _sum((j, "at_y")), _sum((j, "at_z"), (j, "base_z"))]
    if j.drive == "four-bar":
        pin = {"body": f"{j.name}_rocker", "at": [f"{j.name}_rocker", 0, 0]}
    else:
        pin = {"body": j.name, "at": [_sum((j, "pin_x")), 0, _sum((j, "pin_z"))]}
    return {
        "base": {"body": _body(j.parent), "at": base},
        "pin": pin,
        "closed_length": f"{j.name}_closed_length",
        "stroke": f"{j.name}_stroke",
        "barrel_radius": round(0.6 * j["bore"], 4),
        "rod_radius": round(0.5 * j["rod"], 4),
    }


Point = tuple[float, float, float]


def _at(j: JointDescription) -> Point:
    return j["at_x"], j["at_y"], j["at_z"]


def _reach(crane: CraneDescription) -> float:
    """Length of the stretched crane [m]."""
    tip = math.hypot(*(crane.numbers["payload"][f"tip_{n}"].value for n in "xyz"))
    strokes = sum(j.numbers["stroke"].value for j in crane.driven if j.kind == "prismatic")
    return sum(math.hypot(*_at(j)) for j in crane.joints) + tip + strokes


def _shapes(crane: CraneDescription, reach: float) -> Iterator[dict[str, Any]]:
    """A beam from each joint to each joint behind it and to the tip, brackets of the pins; or a mesh."""
    depth, last = SLENDER * reach, crane.joint(crane.payload_on)
    first = crane.joints[0]
    yield _round(
        "ground", "z", (PEDESTAL, PEDESTAL, first["at_z"] or 0.1), (first["at_x"], first["at_y"], 0), "steel"
    )
    for k, j in enumerate(crane.joints):
        ends = [_at(other) for other in crane.joints if other.parent == j.name]
        if j is last:
            x, y, z = (crane.numbers["payload"][f"tip_{n}"].value for n in "xyz")
            ends.append((x, y, z))
        ends = ends or [(2 * j["centre_x"], 2 * j["centre_y"], 2 * j["centre_z"])]
        thick, colour = max(depth * TAPER**k, LEAST), "edge" if k % 2 else "body"
        if j.shape:
            yield {"body": j.name, "kind": "mesh", "file": _mesh(j), "colour": colour}
            ends = []
        elif j.kind == "prismatic":
            begin = [-_inside(crane, j) * x for x in _direction(j)]
            yield from _beam(j.name, begin, (0.0, 0.0, 0.0), thick, "steel")
        for end in ends:
            yield from _beam(j.name, (0.0, 0.0, 0.0), end, thick, colour)
        for x, z in _pins(crane, j):
            yield from _bracket(j.name, (x, z), [(e[0], e[2]) for e in ends], thick)
        if ends:
            yield _round(j.name, "y", (0.3 * thick, 0.3 * thick, 1.1 * thick), (0, -0.55 * thick, 0), "steel")
        if j is last and ends and ends[-1][2] < -math.hypot(*ends[-1][:2]):
            yield from _claws(j.name, ends[-1][2])
        if j.drive == "four-bar":
            yield from _beam(f"{j.name}_rocker", (0.0, 0.0, 0.0), (j["rocker"], 0.0, 0.0), LEAST, "dark")
            yield from _beam(f"{j.name}_coupler", (0.0, 0.0, 0.0), (j["coupler"], 0.0, 0.0), LEAST, "dark")


def _inside(crane: CraneDescription, j: JointDescription) -> float:
    """Length of a stage of a telescope behind its joint [m]: its stroke, as far as there is room."""
    led = crane.joint(j.follows) if j.follows else j
    ratio = j["ratio"] if j.follows else 1.0
    stroke = ratio * led["stroke"] if "stroke" in led.numbers else 2 * math.hypot(*_along(j))
    before = crane.joint(j.parent) if j.parent else None
    room = math.hypot(*_at(j))
    room += _inside(crane, before) if before and before.kind == "prismatic" else 0.0
    return min(stroke + 0.1, room or stroke)


def _along(j: JointDescription) -> Point:
    return j["centre_x"], j["centre_y"], j["centre_z"]


def _direction(j: JointDescription) -> Point:
    sign = -1.0 if j.axis[0] == "-" else 1.0
    x, y, z = (sign * (n == j.axis[-1]) for n in "xyz")
    return x, y, z


def _pins(crane: CraneDescription, j: JointDescription) -> Iterator[tuple[float, float]]:
    """Pins on the link of a joint, in its plane: of its own drive and of the drives behind it."""
    if j.kind == "revolute" and j.drive in ("cylinder", "four-bar"):
        yield (j["pin_x"], j["pin_z"]) if j.drive == "cylinder" else (j["link_x"], j["link_z"])
    for other in crane.joints:
        if other.parent == j.name and other.kind == "revolute" and other.drive in ("cylinder", "four-bar"):
            for pin in ("base", "pivot") if other.drive == "four-bar" else ("base",):
                yield other["at_x"] + other[f"{pin}_x"], other["at_z"] + other[f"{pin}_z"]


def _beam(
    body: str, begin: Sequence[float], end: Sequence[float], thick: float, colour: str
) -> Iterator[Any]:
    """A girder, thinner at its end, in the plane of the crane; a tube across it."""
    (x, y, z), long = (b - a for a, b in zip(begin, end, strict=True)), math.dist(begin, end)
    if long < thick / 2:
        return
    if abs(y) > 0.01 or abs(begin[1]) > 0.01:
        path = [list(begin), *([a + f * (b - a) for a, b in zip(begin, end, strict=True)] for f in (0.5, 1))]
        yield {"body": body, "kind": "tube", "size": [thick / 3], "path": path, "colour": colour}
        return
    u, n = (x / long, z / long), (-z / long, x / long)
    corners = ((-0.3, 0.5), (0.25 * long / thick, 0.62), (long / thick + 0.2, 0.36))
    outline = [(a, b) for a, b in corners] + [(a, -b) for a, b in reversed(corners)]
    path = [
        [round(begin[i] + thick * (a * u[k] + b * n[k]), 4) for k, i in ((0, 0), (1, 2))] for a, b in outline
    ]
    yield {"body": body, "kind": "plate", "size": [round(0.75 * thick, 4)], "path": path, "colour": colour}


def _claws(body: str, down: float) -> Iterator[dict[str, Any]]:
    """The open jaws of a hanging grapple, so that the tip is between them."""
    for x in (-0.12, 0.12):
        path = [[x, a, b * down] for a, b in ((0.06, 0.4), (0.42, 0.55), (0.5, 0.85), (0.22, 1.15))]
        yield {"body": body, "kind": "tube", "size": [0.035], "path": path, "colour": "dark", "mirror": True}


def _bracket(
    body: str, pin: tuple[float, float], ends: Sequence[tuple[float, float]], thick: float
) -> Iterator[Any]:
    """Two cheeks from a pin to the nearest beam."""
    feet = [_foot(pin, end) for end in ends if math.hypot(*end) > NEAR]
    if not feet:
        return
    foot, along = min(feet, key=lambda f: math.dist(pin, f[0]))
    if math.dist(pin, foot) < NEAR:
        return
    path = [[foot[k] + s * BRACKET * along[k] for k in (0, 1)] for s in (-1, 1)]
    path.insert(1, [pin[k] + 0.06 * along[k] for k in (0, 1)])
    path.insert(1, [pin[k] - 0.06 * along[k] for k in (0, 1)])
    shape = {"body": body, "kind": "plate", "size": [0.035], "at": [0, round(0.4 * thick, 4), 0]}
    yield {**shape, "path": path, "colour": "dark", "mirror": True}


def _foot(
    pin: tuple[float, float], end: tuple[float, float]
) -> tuple[tuple[float, float], tuple[float, float]]:
    """The point of the beam from the joint to `end` nearest to the pin, and the direction of the beam."""
    long = math.hypot(*end)
    along = end[0] / long, end[1] / long
    share = min(max(pin[0] * along[0] + pin[1] * along[1], 0.0), long)
    return (share * along[0], share * along[1]), along


def _round(body: str, axis: str, size: Sequence[float], at: Sequence[float], colour: str) -> dict[str, Any]:
    return {"body": body, "kind": "round", "axis": axis, "size": [*size], "at": [*at], "colour": colour}
