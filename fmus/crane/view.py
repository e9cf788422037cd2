"""The page of a crane: levers, gauges, charts and the drawing, as a view description (`resources/view.toml`).

Joints and cylinders of the drawing follow the parameters of the FMU. Beams have the sizes of the description;
their thickness is made up.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from typing import Any

import numpy as np

from fmus.crane.controller import controlled
from fmus.crane.description import CraneDescription, JointDescription
from fmus.crane.manipulator import manipulator
from fmus.joints import BARS
from orchestrator.base.errors import Problem
from orchestrator.base.files import Location
from orchestrator.data.table import Array

COLOURS = ("#009e73", "#0072b2", "#d55e00", "#cc79a7", "#e69f00", "#56b4e9", "#7d7d7d")  # Okabe and Ito 2008
# of the levers of motors and of cylinders
RATE, FULL = {True: 3.0, False: 10.0}, {True: 4.0, False: 6.0}  # V/s, ramps; V at full deflection
SLENDER, TAPER = 0.042, 0.86  # depth of the first beam over the reach, of the next one over that
LEAST = 0.09  # m, of a beam
PEDESTAL = 0.3  # m, radius
RELIEVED, STOPPED = 1.7e-5, 1e3  # m3/s of a relief valve, N of a stop, from which a gauge tells so
HERE = np.zeros(3)
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
PAYLOAD = {
    **{"name": "payload_mass", "text": "Payload", "unit": "kg"},
    **{"low": 0.0, "high": 1000.0, "step": 10.0, "rate": 1e5},
}
WORDS = {"motor": ("left", "right"), "revolute": ("up", "down"), "prismatic": ("out", "in")}


def document(crane: CraneDescription) -> bytes:
    """The file."""
    return "".join(f"{key} = {_toml(value)}\n" for key, value in description(crane).items()).encode()


def page_files(crane: CraneDescription) -> dict[str, bytes]:
    """The file, and the meshes of links."""
    meshes = {_mesh(j): Location(j.shape).read() for j in crane.joints if j.shape}
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
    most = 10 * math.ceil(1.2e-6 * pressure)  # bar, end of scales
    controls = _levers(crane)
    driven = [n for mode in controls["modes"].values() for full in mode["full"].values() for n in full]
    axes = [
        {"name": [n for n in driven if n.startswith(f"{j.name}_")], "limit": 10.0, "rate": RATE[j.motor]}
        for j in crane.driven
    ]
    return {
        "full_pressure": 1e5 * most,
        "signals": [f"tip_{n}" for n in "xy"],
        "axes": axes + (TIP_AXES if "tip" in controls["modes"] else []),
        "sliders": [PAYLOAD],
        **controls,
        "gauges": _gauges(crane, most),
        "charts": _charts(crane, most),
        "scene": _scene(crane),
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
        first = sorted(order, key=lambda j: not j.revolute)[:STICKS]
        order = [*first, *(j for j in order if j not in first)]
    for k, j in enumerate(order[:MOST]):
        ends = WORDS["motor" if j.revolute and j.axis[-1] == "z" else j.kind]
        sign = of.joint(j.name).lever
        if k == 2 or not j.revolute:  # towards the operator is in, or down
            ends, sign = (ends[1], ends[0]), -sign
        words[j.name] = [f"{j.name} {end}" for end in ends]
        full[j.name] = {f"{j.name}_{n}": sign * FULL[j.motor] for n in levers_of}
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
    """Pressures, motion, power. Only some drives have the flow of relief valves as an output."""

    def line(name: str, text: str, scale: Mapping[str, Any], *told: tuple[str, float, str]) -> dict[str, Any]:
        words = [dict(zip(("name", "above", "text"), one, strict=True)) for one in told]
        return {"name": name, "text": text, **scale, "told": words}

    def drive(j: JointDescription) -> Iterator[dict[str, Any]]:
        first, second = ((f"{j.name}_{end}", f"{j.name.capitalize()}, {text}") for end, text in _ends(j))
        yield line(*first, bar, (f"{j.name}_relief_flow", RELIEVED, "relief open"))
        yield line(*second, bar)

    def joint(j: JointDescription) -> dict[str, Any]:
        stop = (f"{j.name}_stop_force", STOPPED, "end of stroke")
        return line(
            j.coordinate, j.name.capitalize(), angle if j.revolute else length, *[stop][: bool(j.cylinder)]
        )

    bar, length = {"unit": "bar", "high": most, "digits": 0}, {"unit": "m", "digits": 2}
    angle = {"unit": "°", "low": -180, "high": 180, "digits": 0}
    motion = [
        *(joint(j) for j in crane.joints if not j.follows),
        line("tip_radius", "Tip, reach", length),
        line("tip_height", "Tip, height", {**length, "low": -2, "high": _reach(crane)}),
        line("held_mass", "Load", {"unit": "kg", "high": 1000, "digits": 0}),
    ]
    pressures = [gauge for j in crane.driven for gauge in drive(j)]
    flow = line("supply_flow", "Flow", {"unit": "L/min", "high": 300, "digits": 0})
    return [
        {"title": "Pressure", "lines": [line("supply_pressure", "Supply", bar), *pressures]},
        {"title": "Motion", "lines": motion},
        {"title": "Power", "lines": [flow]},
    ]


def _charts(crane: CraneDescription, most: int) -> list[dict[str, Any]]:
    def curves(signal: str, *kinds: str) -> list[dict[str, Any]]:
        return [
            {"name": f"{j.name}_{signal}", "text": j.name, "colour": COLOURS[k % len(COLOURS)]}
            for k, j in enumerate(crane.driven)
            if j.kind in (kinds or WORDS)
        ]

    pressures = [
        {**curve, "name": f"{j.name}_{end}", "text": f"{j.name}, {text}", "dashed": dashed}
        for j, curve in zip(crane.driven, curves("pressure"), strict=True)
        for (end, text), dashed in zip(_ends(j), (False, True), strict=True)
    ]
    scale = {"unit": "bar", "ends": [most, 2 * most, 4 * most], "both": False}
    speeds = [("revolute", "°/s", [20, 40, 80, 160]), ("prismatic", "m/s", [0.2, 0.5, 1, 2])]
    return [
        {"title": "Pressure", **scale, "curves": pressures},
        {"title": "Command", "unit": "V", "ends": [10], "curves": curves("command")},
        *(
            {"title": "Speed", "unit": unit, "ends": ends, "curves": found}
            for kind, unit, ends in speeds
            if (found := curves("speed", kind))
        ),
    ]


def _ends(joint: JointDescription) -> tuple[tuple[str, str], tuple[str, str]]:
    """Signals of the two pressures of a drive, without the joint, and their words."""
    if joint.motor:
        return ("pressure_a", "port A"), ("pressure_b", "port B")
    return ("head_pressure", "head"), ("rod_pressure", "rod")


# ---- drawing


def _scene(crane: CraneDescription) -> dict[str, Any]:
    reach = _reach(crane)
    joints, cylinders, pressures = dict[str, Any](), dict[str, Any](), dict[str, str]()
    for j in crane.joints:
        initial = "" if j.follows else f"initial_{j.coordinate}"
        joints[j.name] = {
            "parent": j.parent or "ground",
            "at": _place(j, "at"),
            "axis": j.axis,
            "kind": j.kind,
        }
        joints[j.name] |= {"signal": j.coordinate, "initial": initial}
        if j.four_bar:
            joints |= _linkage(j)
        if j.revolute and j.cylinder:
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


def _place(j: JointDescription, *vectors: str) -> list[str | float]:
    """A sum of vectors by the parameters of a joint; those that are 0 are none."""
    names = ([n for v in vectors if (n := f"{v}_{axis}") in j.numbers and j[n] != 0] for axis in "xyz")
    return [" + ".join(f"{j.name}_{n}" for n in some) or 0 for some in names]


def _linkage(j: JointDescription) -> dict[str, Any]:
    """Rocker and coupler; their angles are those in the frame of the joint's parent."""
    body, rocker, coupler = j.parent or "ground", f"{j.name}_rocker", f"{j.name}_coupler"
    found: dict[str, Any] = {
        rocker: {"parent": body, "at": _place(j, "at", "pivot")},
        coupler: {"parent": rocker, "frame": body, "at": [rocker, 0, 0]},
    }
    return {bar: {**x, "signal": f"{bar}_angle", "axis": j.axis} for bar, x in found.items()}


def _cylinder(j: JointDescription) -> dict[str, Any]:
    rocker, pin = f"{j.name}_rocker", {"body": j.name, "at": _place(j, "pin")}
    beside = [x for x in _place(j, "rod") if x]
    end = _place(j, "rod") if beside else [rocker, 0, 0]
    return {
        "base": {"body": j.parent or "ground", "at": _place(j, "at", "base")},
        "pin": {"body": rocker, "at": end} if j.four_bar else pin,
        "closed_length": f"{j.name}_closed_length",
        "stroke": f"{j.name}_stroke",
        "barrel_radius": round(0.6 * j["bore"], 4),
        "rod_radius": round(0.5 * j["rod"], 4),
    }


def _tip(crane: CraneDescription) -> Array:
    return np.array([crane.numbers["payload"][f"tip_{n}"].value for n in "xyz"])


def _reach(crane: CraneDescription) -> float:
    """Length of the stretched crane [m]."""
    strokes = sum(j["stroke"] for j in crane.driven if not j.revolute)
    return sum(math.hypot(*j.vector("at")) for j in crane.joints) + math.hypot(*_tip(crane)) + strokes


def _shapes(crane: CraneDescription, reach: float) -> Iterator[dict[str, Any]]:
    """A beam from each joint to each joint behind it and to the tip, a bar to each of its pins; or a mesh."""
    depth, last = SLENDER * reach, crane.joint(crane.payload_on)
    first = crane.joints[0]
    yield _round(
        "ground", "z", (PEDESTAL, PEDESTAL, first["at_z"] or 0.1), (first["at_x"], first["at_y"], 0), "steel"
    )
    for k, j in enumerate(crane.joints):
        ends = [other.vector("at") for other in crane.joints if other.parent == j.name]
        if j is last:
            ends.append(_tip(crane))
        ends = ends or [2 * j.vector("centre")]
        thick, colour = max(depth * TAPER**k, LEAST), "edge" if k % 2 else "body"
        if j.shape:
            yield {"body": j.name, "kind": "mesh", "file": _mesh(j), "colour": colour}
            ends = []
        elif not j.revolute:
            yield from _beam(j.name, -_inside(crane, j) * j.direction, HERE, thick, "steel")
        for end in ends:
            yield from _beam(j.name, HERE, end, thick, colour)
        for x, z in () if j.shape else _pins(crane, j):
            yield from _beam(j.name, HERE, np.array([x, 0, z]), LEAST, "dark")
        if ends:
            yield _round(j.name, "y", (0.3 * thick, 0.3 * thick, 1.1 * thick), (0, -0.55 * thick, 0), "steel")
        for bar in BARS if j.four_bar else ():
            yield from _beam(f"{j.name}_{bar}", HERE, np.array([j[bar], 0, 0]), LEAST, "dark")


def _inside(crane: CraneDescription, j: JointDescription) -> float:
    """Length of a stage of a telescope behind its joint [m]: its stroke, as far as there is room."""
    led = crane.joint(j.follows) if j.follows else j
    stroke = 2 * math.hypot(*j.vector("centre"))
    if "stroke" in led.numbers:
        stroke = j.following(led["stroke"]) if j.follows else led["stroke"]
    before = crane.joint(j.parent) if j.parent else None
    room = math.hypot(*j.vector("at"))
    room += _inside(crane, before) if before and not before.revolute else 0.0
    return min(stroke + 0.1, room or stroke)


def _pins(crane: CraneDescription, j: JointDescription) -> Iterator[Array]:
    """Pins on the link of a joint, in its plane: of its own drive and of the drives behind it."""
    turned = [other for other in crane.joints if other.axis[-1] == "y" and other.cylinder]
    if j in turned:
        yield j.vector("link" if j.four_bar else "pin", "xz")
    for other in (other for other in turned if other.parent == j.name):
        for pin in ("base", "pivot") if other.four_bar else ("base",):
            yield other.vector("at", "xz") + other.vector(pin, "xz")


def _beam(body: str, begin: Array, end: Array, thick: float, colour: str) -> Iterator[dict[str, Any]]:
    """A girder, thinner at its end, in the plane of the crane; a tube across it."""
    along = end - begin
    if (long := math.hypot(*along)) < thick / 2:
        return
    if max(abs(along[1]), abs(begin[1])) > 0.01:
        path = [[*(begin + share * along)] for share in (0, 0.5, 1)]
        yield {"body": body, "kind": "tube", "size": [thick / 3], "path": path, "colour": colour}
        return
    x, z = along[::2] / long
    upper = np.array([(-0.3, 0.5), (0.25 * long / thick, 0.62), (long / thick + 0.2, 0.36)])
    outline = np.vstack([upper, upper[::-1] * (1, -1)])
    path = np.round(begin[::2] + thick * outline @ [[x, z], [-z, x]], 4).tolist()
    yield {"body": body, "kind": "plate", "size": [round(0.75 * thick, 4)], "path": path, "colour": colour}


def _round(body: str, axis: str, size: Sequence[float], at: Sequence[float], colour: str) -> dict[str, Any]:
    return {"body": body, "kind": "round", "axis": axis, "size": [*size], "at": [*at], "colour": colour}
