"""The file that describes a crane: joints in order, each with body and drive; base, payload, start, supply.

`read` checks all of the file and reports all mistakes at once, a line each. Quantities are numbers in SI
units, or texts with a unit, "4200 mm". docs/crane.md describes the keys.
"""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal, TypeAlias, cast, get_args

import numpy as np

from fmus.boom_stick import BOOM_STICK
from fmus.boom_stick import VARIANTS as BOOM_VARIANTS
from fmus.components.additions import (
    Accumulator,
    Addition,
    ChamberReliefs,
    CrossoverReliefs,
    Cushion,
    Regeneration,
)
from fmus.components.chain import Axis
from fmus.components.chamber import BulkModulus, Liquid
from fmus.components.cylinder import Cylinder
from fmus.components.hose import HoseSize
from fmus.components.opening_curve import EDGES
from fmus.components.spool_valve import Valve
from fmus.contract import Quantity, quantities
from fmus.drives.motor import MotorSize
from fmus.manipulator import MANIPULATOR
from fmus.manipulator.friction import JointContact, PistonContact
from fmus.parameters import SOURCES, Number
from fmus.parameters import numbers as numbers_of
from fmus.supply import SUPPLY
from fmus.swing import SWING
from orchestrator.base import toml
from orchestrator.base.errors import Mistakes, Problem, suggest
from orchestrator.base.files import Location, write_whole
from orchestrator.base.units import Unit, number_and_unit, parse_unit
from orchestrator.data import gltf
from orchestrator.data.table import Array

AXES = get_args(Axis)
PLANES: Mapping[str, tuple[Axis, Axis]] = {
    "x": ("y", "z"),
    "y": ("x", "z"),
    "z": ("x", "y"),
}  # axis of a joint -> coordinates of the pins of its cylinder
Assembly: TypeAlias = Literal["above", "below"]
LARGEST_LENGTH = 100.0  # m
MOST_JOINTS = 60  # whose equations are made in some seconds
INERTIAS = ("xx", "yy", "zz", "xy", "xz", "yz")
SYMMETRIC = ((0, 3, 4), (3, 1, 5), (4, 5, 2))  # place of each entry of a matrix in INERTIAS
LARGEST_SHARE = 1 + 1e-6  # of a principal moment of inertia in the sum of the two others, with rounding
TURN = 2 * math.pi
UNITS = {"revolute": ("rad", "N.m"), "prismatic": ("m", "N")}  # of coordinate and effort
ENDS = {"revolute": TURN, "prismatic": LARGEST_LENGTH}  # largest coordinate


class _Hydraulics(Cylinder, MotorSize, Liquid, BulkModulus, valve=Valve, hose=HoseSize):
    """Parameters of drives and their oil that a file has."""


# parameters that parts of the machine declare; the stroke of a cylinder is one of the manipulator, too
DECLARED = {n: q for g in (_Hydraulics, SUPPLY.parameters) for n, q in quantities(g).items() if n != "stroke"}
# a key of a table of the file: the parameters that it gives, one or several of one unit and bounds, which are
# those of the file; `value` of each if the key is missing; None: the key is required
Key: TypeAlias = Mapping[str, Quantity]
Keys: TypeAlias = Mapping[str, Key]
Given: TypeAlias = Mapping[str, Any]
Bound: TypeAlias = float | None


def _key(
    names: str, unit: str, text: str, default: Bound = 0.0, low: Bound = None, high: Bound = None
) -> Key:
    """Parameters of the manipulator, "{}" for the joint, or of the check; several along x, y or z."""
    declared = Quantity(unit, text, minimum=low, maximum=high, value=default)
    several = " " in names
    return {n: replace(declared, text=f"{text}, {n[-1]}" if several else text) for n in names.split()}


def _length(names: str, text: str, default: Bound = 0.0, low: Bound = -LARGEST_LENGTH) -> Key:
    return _key(names, "m", text, default, low, LARGEST_LENGTH)


def _own(name: str, default: Bound, low: float, high: float) -> Key:
    """A parameter that a part of the machine declares, with the bounds of the file."""
    return {name: replace(DECLARED[name], value=default, minimum=low, maximum=high)}


def _mass(name: str, of: str) -> Key:
    return _key(name, "kg", f"Mass of the {of}, a slender bar from pin to pin", 0.0, 0.0, 1e5)


def in_plane(key: Key, axis: str) -> Key:
    """A key of a pin, which has two coordinates, in the plane of a joint about an axis."""
    if len(key) != len(PLANES[axis[-1]]):
        return key
    names = zip(key.items(), PLANES[axis[-1]], strict=True)
    return {f"{n[:-1]}{to}": replace(q, text=f"{q.text[:-1]}{to}") for (n, q), to in names}


def _joint_keys(kind: str) -> Keys:
    """Keys of a joint itself."""
    unit, effort = UNITS[kind]
    spring = "Stiffness of the spring in the {} joint, which is without force at 0"
    contact = JointContact if kind == "revolute" else PistonContact
    return {
        "at": _length("at_x at_y at_z", "Place of the {} joint in the frame of its parent"),
        "mass": _key("mass", "kg", "Mass of the {}", 0.0, 0.0, 1e6),
        "centre": _length("centre_x centre_y centre_z", "Centre of mass of the {} from its joint"),
        "damping": _key("damping", f"{effort}.s/{unit}", "Viscous friction of the {} joint", 0.0, 0.0),
        "stiffness": _key("stiffness", f"{effort}/{unit}", spring, 0.0, 0.0),
        "friction": {"coulomb": replace(quantities(contact)["coulomb"], value=0.0)},
    }


def _stop_keys(kind: str) -> Keys:
    """End stops of a joint; the defaults are those of the paper's column, or of its pistons."""
    (unit, effort), shipped = UNITS[kind], numbers_of(MANIPULATOR)["parameters"]
    begin = "swing_" if kind == "revolute" else ""
    stiffness, damping = (shipped[f"{begin}stop_{n}"].value for n in ("stiffness", "damping"))
    at = "Position of the {} joint at which its upper end stop begins; without a lower one to both sides of 0"
    low = "Position of the {} joint at which its lower end stop begins"
    spring = "Stiffness of the end stops of the {} joint"
    law = "Contact damping of the end stops of the {} joint (Hunt and Crossley)"
    return {
        "at": _key("stop_at", unit, at, None, -ENDS[kind], ENDS[kind]),
        "from": _key("stop_from", unit, low, 0.0, -ENDS[kind], ENDS[kind]),
        "stiffness": _key("stop_stiffness", f"{effort}/{unit}", spring, stiffness, 1.0),
        "damping": _key("stop_damping", f"s/{unit}", law, damping, 0.0),
    }


JOINTS, STOPS = ({kind: keys(kind) for kind in UNITS} for keys in (_joint_keys, _stop_keys))
FOLLOWED = {  # kinds of a joint and of the one that it follows
    (kind, leader): {
        "ratio": _key("ratio", "1", "Motion of the {} over that of the joint that it follows", 1.0),
        "offset": _key("offset", unit, "Coordinate of the {} where the joint that it follows is at 0"),
        **{
            n: _key(f"follows_{n}", of_leader, f"Coordinate of the joint that the {{}} follows, {text}")
            for n, text in (("from", "from which on it moves"), ("to", "up to which it moves"))
        },
    }
    for kind, (unit, _) in UNITS.items()
    for leader, (of_leader, _) in UNITS.items()
}
DRIVES: Mapping[str, Keys] = {
    "cylinder": {
        "base": _length("base_x base_z", "Base pin of the {} cylinder from the joint", None),
        "pin": _length("pin_x pin_z", "Rod pin of the {} cylinder from the joint", None),
        "closed": _length("closed_length", "Pin-to-pin length of the closed {} cylinder", None, 0.05),
        "stroke": _length("stroke", "Stroke of the {} cylinder", None, 0.01),
        "bore": _own("bore", None, 0.01, 0.5),
        "rod": _own("rod", None, 0.005, 0.5),
        "dead_volume": _own("dead_volume", 3e-4, 1e-6, 0.1),
        "damping": _key("piston_damping", "N.s/m", "Viscous friction of the {} cylinder's piston", 2e4, 0.0),
        "friction": {"piston_coulomb": replace(quantities(PistonContact)["coulomb"], value=0.0)},
        "barrel_mass": _mass("barrel_mass", "barrel of the {} cylinder"),
        "rod_mass": _mass("rod_mass", "rod of the {} cylinder with its piston"),
        "count": _key("count", "1", "Cylinders between the same pins", 1.0, 1.0, 8.0),
    },
    "four_bar": {
        "pivot": _length("pivot_x pivot_z", "Pin of the rocker of the {} from the joint", None),
        "rocker": _length("rocker", "Length of the rocker of the {}", None, 0.01),
        "coupler": _length("coupler", "Length of the coupler of the {}", None, 0.01),
        "pin": _length("link_x link_z", "Pin of the coupler on the {} from the joint", None),
        "rod": _length("rod_x rod_z", "Rod pin along and across the rocker of the {}; zeros: at the coupler"),
        "rocker_mass": _mass("rocker_mass", "rocker of the {}"),
        "coupler_mass": _mass("coupler_mass", "coupler of the {}"),
    },
    "motor": {
        "displacement": _own("motor_displacement", None, 1e-8, 1e-2),
        "ratio": _own("gear_ratio", 1.0, 1e-3, 1e4),
        "volume": _own("motor_volume", 2e-4, 1e-6, 0.1),
    },
    "hydraulics": {
        "valve": _own("valve_area", 4e-5, 1e-8, 1e-2),
        "flow": _key("rated_flow", "m3/s", "Flow through the open valve", 0.0, 0.0, 0.1),
        "drop": _key("rated_drop", "Pa", "Pressure drop over one of its edges then", 3.5e6, 1e4, 1e8),
        "dead_band": _own("valve_dead_band", 0.6, 0.0, 9.0),
        "rounding": _own("valve_command_rounding", 0.4, 1e-3, 9.0),
        "leakage": _own("valve_leakage", 1.6e-14, 1e-17, 1e-9),
        "hose": _own("hose_length", 3.0, 0.01, LARGEST_LENGTH),
        "hose_bore": _own("hose_bore", 0.01905, 1e-3, 0.2),
        "rod_valve": _key("rod_valve_area", "m2", "Meter-in edge to the rod side", 0.0, 0.0, 1e-2),
        "rod_flow": _key("rod_rated_flow", "m3/s", "Flow of the section to the rod side", 0.0, 0.0, 0.1),
        **{
            f"{side}_return": _key(f"{side}_return_area", "m2", "Meter-out edge", 0.0, 0.0, 1e-2)
            for side in ("head", "rod")
        },
        **{
            f"{side}_pilot_ratio": _key(f"{side}_pilot_ratio", "1", "Pilot ratio", 0.0, 0.0, 100.0)
            for side in ("head", "rod")
        },
    },
}
INERTIA = {
    f"inertia_{n}": Quantity("kg.m2", f"Moment of inertia {n} of the {{}} about its centre of mass")
    for n in INERTIAS
}


def _of_joint(kind: str) -> dict[str, Quantity]:
    """Parameters of a joint in the manipulator."""
    tables = (JOINTS[kind], STOPS[kind], DRIVES["four_bar"], FOLLOWED[kind, kind])
    keys = [key for table in tables for key in table.values()]
    keys += [in_plane(key, axis) for key in DRIVES["cylinder"].values() for axis in PLANES]
    return INERTIA | {n: q for key in keys for n, q in key.items() if n not in (*DECLARED, "count")}


OF_JOINT = {kind: _of_joint(kind) for kind in UNITS}
# tables of a joint by its drive
USED: Mapping[str, tuple[str, ...]] = {
    "none": (),
    "motor": ("motor", "hydraulics"),
    "cylinder": ("cylinder", "hydraulics"),
    "four-bar": ("cylinder", "four_bar", "hydraulics"),
}
# keys of tables that a drive does not have: the rocker's end is its pin; it lies along a telescope
UNUSED: Mapping[str, Mapping[str, tuple[str, ...]]] = {
    "four-bar": {"cylinder": ("pin",)},
    "telescope": {"cylinder": ("base", "pin", "closed", "barrel_mass", "rod_mass")},
    "motor": {"hydraulics": tuple(n for n in DRIVES["hydraulics"] if n.partition("_")[0] in ("head", "rod"))},
}
HELD = {"both": ("head", "rod"), "head": ("head",), "rod": ("rod",), "none": ()}
BASE, TIP = "Slope of the base: the", "Tip, where the payload is, from the joint of its link"
TABLES: Mapping[str, Keys] = {
    "base": {
        "pitch": _key("base_pitch", "rad", f"{BASE} front is lower by this angle", 0.0, -1.5, 1.5),
        "roll": _key("base_roll", "rad", f"{BASE} right side is lower by this angle", 0.0, -1.5, 1.5),
    },
    "payload": {
        "at": _length("tip_x tip_y tip_z", TIP, None),
        "length": _length("load_length", "Length of the payload, a slender bar; 0: a point mass", 0.0, 0.0),
        "mass": _key("payload_mass", "kg", "Payload held from the start", 0.0, 0.0, 1e6),
    },
    "ground": {
        "height": _length("ground_height", "Height of the ground above the base"),
        "stiffness": _key("ground_stiffness", "N/m", "Stiffness of the ground under the tip", 2e6, 0.0),
        "damping": _key(
            "ground_damping", "s/m", "Contact damping of the ground (Hunt and Crossley)", 0.5, 0.0
        ),
        "friction": _key("ground_friction", "1", "Coefficient of friction of the ground", 0.6, 0.0, 10.0),
    },
    "oil": {
        "density": _own("density", 870.0, 500.0, 1500.0),
        "viscosity": _own("viscosity", 0.02, 1e-4, 10.0),
        "bulk_modulus": _own("bulk_modulus", 1.4e9, 1e8, 1e10),
    },
    "supply": {
        "pressure": _own("pressure_setting", 2.07e7, 1e5, 1e8),
        "return": _own("reservoir_pressure", 0.0, 0.0, 1e7),
    },
    "pump": {  # 0: at the size of the crane
        "displacement": _key(
            "displacement", "m3/rad", "Displacement of the load-sensing pump", 0.0, 0.0, 1e-2
        ),
        "flow": _key("flow", "m3/s", "Flow of this pump at the speed of the engine", 0.0, 0.0, 0.1),
        "margin": _key("margin", "Pa", "Pressure of the pump above the load", 0.0, 0.0, 1e8),
        "cut_off": _key("cut_off", "Pa", "Pressure cut-off of the pump", 0.0, 0.0, 1e8),
        "power": _key("power", "W", "Power limit of the pump", 0.0, 0.0, 1e7),
    },
    "engine": {
        "speed": _key("rated_speed", "rad/s", "Rated speed of the engine", 0.0, 0.0, 1e3),
        "power": _key("rated_power", "W", "Rated power of the engine", 0.0, 0.0, 1e7),
    },
    "counterbalance": {
        "pressure": _key("counterbalance_pressure", "Pa", "Setting of the valves", 0.0, 0.0, 1e8),
        "area": _key("counterbalance_area", "m2", "Area of the open poppet", 0.0, 0.0, 1e-2),
        "check_area": _key("counterbalance_check_area", "m2", "Area of the check valve", 0.0, 0.0, 1e-2),
        "neutral_area": _key("neutral_area", "m2", "From each port to the return line", 0.0, 0.0, 1e-3),
    },
    "datasheet": {  # `check` compares
        "lifting_moment": _key("lifting_moment", "N.m", "Lifting moment, gross", 0.0, 0.0),
        "reach": _key("reach", "m", "Largest reach", 0.0, 0.0),
    },
}
# tables of a joint with a cylinder, with a motor, of the supply: additions, whose keys are their quantities
ADDITIONS: Mapping[str, type[Addition]] = {
    "cushion": Cushion,
    "reliefs": ChamberReliefs,
    "regeneration": Regeneration,
}
OF_MOTOR: Mapping[str, type[Addition]] = {"reliefs": CrossoverReliefs}
OF_SUPPLY: Mapping[str, type[Addition]] = {"accumulator": Accumulator}


def keys_of(table: str, addition: type[Addition]) -> Keys:
    """Keys of the table of an addition."""
    return {n: {f"{table}_{n}": q} for n, q in quantities(addition).items()}


# other keys of tables, and of a joint
WORDS = {"payload": ("on", "along"), "supply": (*OF_SUPPLY,), "datasheet": ("loads",)}
WORDS |= {"hydraulics": ("part", "counterbalance"), "four_bar": ("assembly",)}
OTHERS = (*FOLLOWED["revolute", "revolute"], "inertia", "stop", *ADDITIONS, "shape", "source", "note")
WORD, PART = "[a-z][a-z0-9]*", "[a-z][a-z0-9_]*"
DEFAULT = "default"  # note of a number that the file does not have
MEANT = {"m": ("mm", "cm"), "rad": ("deg",)}  # units of a number that is out of range without one
NEW = Path(__file__).with_name("new.toml")  # a crane to begin with
EXAMPLES = {"m": "350 mm", "rad": "20 deg", "Pa": "207 bar", "m2": "40 mm2", "m3/s": "60 L/min"}
EXAMPLES |= {"rad/s": "2200 rpm", "W": "90 kW"}
EXAMPLES |= {"N.m": "120 kN.m", "m3/rad": "160 cm3/rev", "N.s/m": "30 kN.s/m", "kg": "900 kg"}
# as data sheets write units; a moment in t.m is that of a weight
SHEETS = {"Nm": "N.m", "kNm": "kN.m", "tm": "t.m", "mt": "t.m"}
SHEETS |= {"cc": "cm3", "ccm": "cm3", "U": "rev", "lbs": "lb"}
COMPENSATED = 1.2e6  # Pa, that a compensator holds over its section
SECTION = 2.7e-3  # m3/s, of the paper's boom
NONE = Number(0.0, "1", "assumed", "")
OIL_SPEED = 5.0  # m/s, in a hose at the flow of its section: usual in pressure lines
NARROWEST = 4.8e-3  # m, hose of 3/16 in
GRAVITY = 9.80665  # m/s2, standard


@dataclass(frozen=True)
class JointDescription:
    """A joint with the link behind it.

    kind       "revolute" or "prismatic"
    axis       in the frame of the parent
    parent     joint whose link carries this one; "": the base
    follows    joint whose motion this one has, times its number `ratio`; "": none
    assembly   of a four-bar: "above" or "below" the line of its pivots
    part       of the machine that has its hydraulics
    numbers    its parameters, without the name of the joint
    shape      mesh of its link, binary glTF; None: the page draws beams
    additions  names of the components in addition that its drive has
    held       sides of its cylinder with a counterbalance valve
    """

    name: str
    kind: Literal["revolute", "prismatic"]
    axis: Axis
    parent: str
    drive: str
    numbers: Mapping[str, Number]
    start: Number
    follows: str = ""
    assembly: Assembly = "above"
    part: str = "drives"
    shape: Path | None = None
    additions: tuple[str, ...] = ()
    held: tuple[str, ...] = HELD["both"]

    @property
    def coordinate(self) -> str:
        """Name of its coordinate."""
        return f"{self.name}_{'angle' if self.revolute else 'extension'}"

    @property
    def direction(self) -> Array:
        """Of its axis, shape (3,)."""
        sign = -1.0 if self.axis[0] == "-" else 1.0
        return np.array([sign if n == self.axis[-1] else 0.0 for n in "xyz"])

    @property
    def plane(self) -> tuple[Axis, Axis, float]:
        """Coordinates of its pins; 1 or -1: it turns the first one towards the second, or away from it."""
        return *PLANES[self.axis[-1]], 1.0 if self.axis in ("x", "-y", "z") else -1.0

    @property
    def revolute(self) -> bool:
        """Whether it turns."""
        return self.kind == "revolute"

    @property
    def driven(self) -> bool:
        """Whether it has a drive of its own."""
        return self.drive != "none"

    @property
    def motor(self) -> bool:
        """Whether a motor drives it."""
        return "motor" in USED[self.drive]

    @property
    def cylinder(self) -> bool:
        """Whether a cylinder drives it."""
        return "cylinder" in USED[self.drive]

    @property
    def four_bar(self) -> bool:
        """Whether its cylinder does so over a four-bar linkage."""
        return "four_bar" in USED[self.drive]

    @property
    def edges(self) -> dict[str, Number]:
        """Areas of the edges of its valve: those that have none of their own have that of the valve."""
        own = {"at": "head_return_area", "pb": "rod_valve_area", "bt": "rod_return_area"}
        found = {edge: self.numbers.get(own.get(edge, ""), NONE) for edge in EDGES}
        return {edge: x if x.value else self.numbers["valve_area"] for edge, x in found.items()}

    def __getitem__(self, name: str) -> float:
        return self.numbers[name].value

    @property
    def sequenced(self) -> bool:
        """Whether it moves in a part of the way of the joint that it follows."""
        return any(f"follows_{n}" in self.numbers for n in ("from", "to"))

    def following(self, x: float) -> float:
        """Its coordinate at that of the joint that it follows; corners of its way are not rounded."""
        way = min(x, self["follows_to"]) if "follows_to" in self.numbers else x
        way = max(way - self["follows_from"], 0.0) if "follows_from" in self.numbers else way
        return self["ratio"] * way + self["offset"]

    def vector(self, name: str, axes: str = "xyz") -> Array:
        """Some of its numbers, along axes, shape (n,)."""
        return np.array([self[f"{name}_{n}"] for n in axes])


@dataclass(frozen=True, eq=False)
class CraneDescription:
    """A crane.

    payload_on   joint whose link carries the payload
    along        axis of its link that a payload with a length lies along
    numbers      table -> parameters
    datasheet    lifting moment [N.m] and reach [m] by the data sheet, 0 without one
    loads        by the data sheet: reach [m], load [kg]
    """

    file: Path
    title: str
    joints: tuple[JointDescription, ...]
    payload_on: str
    numbers: Mapping[str, Mapping[str, Number]]
    datasheet: Mapping[str, float] = field(default_factory=dict)
    loads: tuple[tuple[float, float], ...] = ()
    along: str = "y"

    @property
    def ground(self) -> bool:
        """Whether the tip meets the ground."""
        return bool(self.numbers["ground"])

    def joint(self, name: str) -> JointDescription:
        """The joint with this name."""
        return next(j for j in self.joints if j.name == name)

    @property
    def arm(self) -> tuple[tuple[JointDescription, ...], JointDescription | None]:
        """The joints from the base to the crane tip, and the joint there; None: the payload is there.

        The crane tip is on the way to the payload, where the first joint is that no cylinder moves, behind
        the first driven one.
        """
        way, name = list[JointDescription](), self.payload_on
        while name:
            way.insert(0, self.joint(name))
            name = way[0].parent
        first = next((k for k, j in enumerate(way) if j.driven), 0)
        still = (k for k, j in enumerate(way) if k > first and not j.cylinder and not j.follows)
        end = next(still, len(way))
        return tuple(way[:end]), way[end] if end < len(way) else None

    @property
    def driven(self) -> tuple[JointDescription, ...]:
        """The joints with a drive of their own."""
        return tuple(j for j in self.joints if j.driven)


@dataclass(frozen=True)
class _Reader:
    """What is read has this origin; whether meshes are beside the file; all mistakes so far."""

    file: Path
    source: str
    note: str
    meshes: bool = True
    mistakes: list[str] = field(default_factory=list)

    def wrong(self, table: str, text: str) -> None:
        """Note a mistake."""
        self.mistakes.append(f"{self.file}: {f'[{table}] ' if table else ''}{text}")

    def unknown(self, table: str, given: Given, names: Collection[str]) -> None:
        """Note each key that has none of these names."""
        for key in given:
            if key not in names:
                hint = suggest(key, names) or f"; there are {', '.join(names)}"
                self.wrong(table, f"unknown key {key!r}{hint}")

    def tables(self, where: str, given: Given, names: Collection[str]) -> dict[str, Any]:
        """The content of a table; keys with these names are tables, else they are left out."""
        wrong = {n: x for n, x in given.items() if n in names and not isinstance(x, dict)}
        for n, x in wrong.items():
            self.wrong(f"{where}{n}", f"expected a table, got {x!r}")
        return {n: x for n, x in given.items() if n not in wrong}

    def one_of(
        self, table: str, given: Given, key: str, choices: Collection[str], default: str | None = None
    ) -> str:
        """One of some words; the first one after a mistake."""
        value = given.get(key, default)
        if (isinstance(value, str) and value in choices) or (key not in given and value is not None):
            return str(value)
        hint = suggest(value, choices) if isinstance(value, str) and value else ""
        got = repr(value) if key in given else "nothing"
        self.wrong(table, f"{key}: expected one of {', '.join(choices) or 'none'}, got {got}{hint}")
        return next(iter(choices), "")

    def quantity(self, table: str, key: str, value: Any, unit: str) -> float:
        """A number in SI units; NaN after a mistake."""
        if isinstance(value, str):
            number, given = number_and_unit(value)
            with suppress(Problem, ValueError):
                given = re.sub("(?<=[a-z])-(?=[a-z])", ".", given)  # lb-ft
                scale = parse_unit(re.sub("[A-Za-z]+", lambda m: SHEETS.get(m[0], m[0]), given))
                if unit == "N.m" and scale.exponents == parse_unit("kg.m").exponents:  # moment of a weight
                    scale = Unit(parse_unit(unit).exponents, GRAVITY * scale.factor)
                if given and scale.exponents == parse_unit(unit).exponents and math.isfinite(float(number)):
                    return float(number) * scale.factor + scale.offset
        elif toml.is_number(value):
            return float(value)
        example = f'"{EXAMPLES.get(unit, f"1 {unit}")}"'
        expected = "a number" if unit == "1" else f"a number in {unit}, such as {example}"
        self.wrong(table, f"{key}: expected {expected}, got {value!r}")
        return math.nan

    def numbers(self, table: str, given: Given, keys: Keys, *others: str) -> dict[str, Number]:
        """The parameters of the keys of a table, which has no further keys than the others."""
        self.unknown(table, given, dict.fromkeys((*keys, *others)))
        found = dict[str, Number]()
        for key, rule in keys.items():
            source, note = (self.source, self.note) if key in given else ("assumed", DEFAULT)
            for (n, q), x in zip(rule.items(), self._entries(table, key, given.get(key), rule), strict=True):
                found[n] = Number(x, q.unit, source, note)
        return found

    def _entries(self, table: str, key: str, value: Any, rule: Key) -> list[float]:
        size, q = len(rule), next(iter(rule.values()))
        if value is None and q.value is not None:
            return [q.value] * size
        entries = value if isinstance(value, list) and size > 1 else [value]
        if value is None or len(entries) != size:
            shape = f"a list of {size} numbers in {q.unit}" if size > 1 else f"a number in {q.unit}"
            self.wrong(table, f"{key}: expected {shape}, got {'nothing' if value is None else repr(value)}")
            return [math.nan] * size
        found = [self.quantity(table, key, x, q.unit) for x in entries]
        low = -math.inf if q.minimum is None else q.minimum
        high = math.inf if q.maximum is None else q.maximum
        for k, (x, given) in enumerate(zip(found, entries, strict=True)):
            if x < low or x > high:
                found[k] = math.nan
                units = () if isinstance(given, str) else MEANT.get(q.unit, ())
                meant = [u for u in units if low <= x * parse_unit(u).factor <= high]
                hint = f'; did you mean "{x:g} {meant[0]}"?' if meant else ""
                self.wrong(table, f"{key}: expected {low:g} to {high:g} {q.unit}, got {given!r}{hint}")
        return found


def read(path: Path, data: bytes | None = None) -> CraneDescription:
    """A crane from its file, or from its content in a system, without meshes; a Problem with all mistakes."""
    content = dict((toml.read_file(path) if data is None else toml.read(path, data)).data)
    reader = _with_origin(_Reader(path, "assumed", "", meshes=data is None), "", content)
    content = reader.tables("", content, (*TABLES, "start"))
    title, starts = content.pop("title", path.stem), content.pop("start", {})
    for key in ("source", "note"):
        content.pop(key, None)
    tables = {n: content.get(n, {}) for n in TABLES}
    for n in (n for n, given in tables.items() if {"axis", "drive", "joint"} & given.keys()):
        reader.wrong(n, "expected another name of the joint: the file has a table of this name")
        tables[n], starts = {}, {key: x for key, x in starts.items() if key != n}
    tables["supply"] = reader.tables("supply.", tables["supply"], OF_SUPPLY)
    numbers = {n: reader.numbers(n, x, TABLES[n], *WORDS.get(n, ())) for n, x in tables.items()}
    for n in (n for n in OF_SUPPLY if n in tables["supply"]):
        keys = keys_of(n, OF_SUPPLY[n])
        numbers["supply"] |= reader.numbers(f"supply.{n}", tables["supply"][n], keys)
    if "ground" not in content:
        numbers["ground"] = {}
    if "displacement" in tables["pump"] and "flow" in tables["pump"]:
        reader.wrong("pump", f"flow: expected none beside displacement, got {tables['pump']['flow']!r}")
    told = {n: x.value for n, x in numbers.pop("datasheet").items()}
    loads = _loads(reader, tables["datasheet"].get("loads", []))
    names = [n for n, given in content.items() if isinstance(given, dict) and n not in TABLES]
    others = {n: x for n, x in content.items() if n not in (*TABLES, *names)}
    reader.unknown("", others, ("title", "source", "note", *TABLES, "start"))
    density = numbers["oil"]["density"].value
    if len(names) > MOST_JOINTS:
        raise Problem(f"{path}: expected at most {MOST_JOINTS} joints, got {len(names)}")
    joints = list[JointDescription]()
    for n in names:
        joints.append(_joint(reader, n, content[n], {j.name: j for j in joints}, starts, density))
    if tables["counterbalance"] and not any(j.cylinder and j.held for j in joints):
        reader.wrong("counterbalance", "expected a cylinder with such a valve, got none")
    reader.unknown("start", starts, names)
    on = reader.one_of("payload", tables["payload"], "on", names)
    along = reader.one_of("payload", tables["payload"], "along", ("x", "y", "z"), "y")
    if not names:
        reader.wrong("", "expected a table for each joint, such as [boom], got none")
    if not reader.mistakes:
        _check_masses(reader, joints)
    if reader.mistakes:
        raise Mistakes(reader.mistakes)
    return CraneDescription(path, str(title), tuple(joints), on, numbers, told, loads, along)


def _loads(reader: _Reader, value: Any) -> tuple[tuple[float, float], ...]:
    """Pairs of reach and load."""
    if not (isinstance(value, list) and all(isinstance(x, list) and len(x) == 2 for x in value)):
        expected = 'expected a list of pairs, such as [["4 m", "900 kg"]]'
        reader.wrong("datasheet", f"loads: {expected}, got {value!r}")
        return ()
    return tuple(
        (reader.quantity("datasheet", "loads", reach, "m"), reader.quantity("datasheet", "loads", load, "kg"))
        for reach, load in value
    )


def new(path: Path) -> str:
    """Write a commented file of a small crane; a Problem if there is one. Returns what to do next."""
    if path.suffix != ".toml":
        raise Problem(f"{path}: expected a file that ends in .toml")
    if path.exists():
        raise Problem(f"{path}: exists already")
    if not path.parent.is_dir():
        raise Problem(f"{path}: expected a file in a folder that exists, got no folder {path.parent}")
    write_whole(path, NEW.read_bytes())
    return f"{path}: a crane to begin with. Next: harvester crane check {path}"


def _with_origin(reader: _Reader, table: str, given: Given) -> _Reader:
    """The reader with source and note of a table."""
    source, note = given.get("source", reader.source), given.get("note", reader.note)
    if not (isinstance(source, str) and source in SOURCES):
        reader.wrong(table, f"source: expected one of {', '.join(SOURCES)}, got {source!r}")
    return replace(reader, source=str(source), note=str(note))


def _joint(
    reader: _Reader,
    name: str,
    given: Given,
    before: Mapping[str, JointDescription],
    starts: Given,
    density: float,
) -> JointDescription:
    if not re.fullmatch(WORD, name):
        expected = "a joint name of one word of small letters and digits: its signals are such as"
        reader.wrong(name, f"expected {expected} {name}_angle")
    reader = _with_origin(reader, name, given)
    given = reader.tables(f"{name}.", given, ("stop", *ADDITIONS, *DRIVES))
    words: Mapping[str, tuple[Collection[str], str | None]] = {
        "joint": (UNITS, "revolute"),
        "drive": (USED, "none"),
        "axis": (AXES, None),
        "parent": ((*before, "base"), next(reversed([*before]), "base")),
        "follows": (before, ""),
    }
    kind, drive, axis, parent, follows = (reader.one_of(name, given, n, *of) for n, of in words.items())
    text, end = "Coordinate at the start", ENDS[kind]
    key = {name: Quantity(UNITS[kind][0], text, minimum=-end, maximum=end, value=0.0)}  # any name
    j = JointDescription(
        name=name,
        kind=cast(Literal["revolute", "prismatic"], kind),
        axis=cast(Axis, axis),
        parent="" if parent == "base" else parent,
        drive=drive,
        numbers={},
        start=reader.numbers("start", starts, {name: key}, *starts)[name],
        follows=follows,
        shape=_shape(reader, name, given.get("shape")),
        additions=tuple(n for n in ADDITIONS if n in given),
    )
    leader = before[follows] if follows else j
    followed = FOLLOWED[kind, leader.kind]
    if leader.follows:
        reader.wrong(
            name, f"follows: expected a joint that follows none, such as {leader.follows}, got {follows!r}"
        )
    if follows and j.driven:
        reader.wrong(name, f"drive: expected none of a joint that follows {follows}, got {drive!r}")
    if not j.revolute and (j.motor or j.four_bar):
        reader.wrong(name, f"drive: expected cylinder or none of a prismatic joint, got {drive!r}")
    if j.four_bar and axis != "-y":
        reader.wrong(name, f'axis: expected "-y" of a joint with a four-bar linkage, got {axis!r}')
    for n in followed if not follows else ("friction",):
        if n in given:
            other = "none of a joint that follows another one" if follows else "it beside follows only"
            reader.wrong(name, f"{n}: expected {other}, got {given[n]!r}")
    if "stiffness" in given and (j.driven or follows):
        reader.wrong(name, f"stiffness: expected none of a joint with a drive, got {given['stiffness']!r}")
    if "stop" in given and (follows or j.cylinder):
        reader.wrong(name, "stop: expected none of a joint that follows another one or has a cylinder")
    known = ADDITIONS if j.cylinder else OF_MOTOR if j.motor else {}
    for n in (n for n in j.additions if n not in known):
        other = " or a motor" * (n in OF_MOTOR)
        reader.wrong(name, f"{n}: expected a joint with a cylinder{other}, got drive {drive!r}")
    numbers = reader.numbers(name, given, JOINTS[kind], *words, *OTHERS, *USED[drive])
    tables = {"stop": STOPS[kind]} | {n: keys_of(n, a) for n, a in known.items()}
    for table in (n for n in tables if n in given):
        numbers |= reader.numbers(f"{name}.{table}", given[table], tables[table])
    for n in ("pressure", "gain"):
        if n in given.get("reliefs", {}) and (x := numbers.get(f"reliefs_{n}")) and x.value == 0:
            reader.wrong(f"{name}.reliefs", f"{n}: expected more than 0, got {given['reliefs'][n]!r}")
    numbers |= _inertia(reader, name, given.get("inertia", [0, 0, 0]), numbers)
    for table in USED[drive]:
        left_out = UNUSED.get(drive if j.revolute else "telescope", {}).get(table, ())
        keys = {n: in_plane(key, axis) for n, key in DRIVES[table].items() if n not in left_out}
        numbers |= reader.numbers(f"{name}.{table}", given.get(table, {}), keys, *WORDS.get(table, ()))
    ends = [n for n in ("from", "to") if n in given]
    keys = {n: key for n, key in followed.items() if n in ("ratio", "offset", *ends)}
    numbers |= reader.numbers(name, {n: x for n, x in given.items() if n in keys}, keys)
    if len(ends) == 2 and numbers["follows_to"].value <= numbers["follows_from"].value:
        reader.wrong(name, f"to: expected more than from, got {given['to']!r}")
    if j.four_bar:
        linkage, choices = given.get("four_bar", {}), get_args(Assembly)
        assembly = reader.one_of(f"{name}.four_bar", linkage, "assembly", choices)
        j = replace(j, assembly=cast(Assembly, assembly))
    if "stop_at" in numbers:
        low, high = (numbers[n].value for n in ("stop_from", "stop_at"))
        if "from" not in given["stop"]:
            low = -high
            numbers.pop("stop_from")
        if low >= high:
            expected = f"above {low:g} {UNITS[kind][0]}, the lower end"
            reader.wrong(f"{name}.stop", f"at: expected {expected}, got {given['stop'].get('at')!r}")
        elif j.start.value < low or j.start.value > high:
            reader.wrong(
                "start", f"{name}: expected between the end stops of the joint, got {starts.get(name, 0)!r}"
            )
    if j.driven:
        where, hydraulics = f"{name}.hydraulics", given.get("hydraulics", {})
        numbers |= _rated(reader, where, hydraulics, numbers, density)
        numbers |= _by_size(numbers, density)
        part = hydraulics.get("part", j.part)
        if not isinstance(part, str) or not re.fullmatch(PART, part):
            reader.wrong(where, f"part: expected a name of small letters, digits and _, got {part!r}")
        held = reader.one_of(where, hydraulics, "counterbalance", HELD if j.cylinder else ("both",), "both")
        j = replace(j, part=str(part), held=HELD[held])
        for side in HELD["both"] if j.cylinder else ():
            if (ratio := f"{side}_pilot_ratio") in hydraulics and side not in j.held:
                expected = f"none without a counterbalance valve at the {side} side"
                reader.wrong(where, f"{ratio}: expected {expected}, got {hydraulics[ratio]!r}")
    if "rod" in numbers and numbers["rod"].value >= numbers["bore"].value:
        rod, bore = (1e3 * numbers[n].value for n in ("rod", "bore"))
        expected = f"thinner than the bore of {bore:g} mm"
        reader.wrong(f"{name}.cylinder", f"rod: expected {expected}, got {rod:g} mm")
    if "closed_length" in numbers:
        closed, stroke, bore = (1e3 * numbers[n].value for n in ("closed_length", "stroke", "bore"))
        if closed < stroke + bore:
            expected = f"at least {stroke + bore:g} mm, the stroke and a bore for piston, gland and eyes"
            reader.wrong(f"{name}.cylinder", f"closed: expected {expected}, got {closed:g} mm")
    return replace(j, numbers=numbers | _together(reader, name, numbers))


# powers of the number of cylinders between the same pins in the numbers of one that has their areas
TOGETHER = {"bore": 0.5, "rod": 0.5, "barrel_mass": 1.0, "rod_mass": 1.0}
TOGETHER |= {"dead_volume": 1.0, "piston_damping": 1.0, "piston_coulomb": 1.0}


def _together(reader: _Reader, name: str, numbers: dict[str, Number]) -> dict[str, Number]:
    """Numbers of the one cylinder that stands for several between the same pins."""
    if "count" not in numbers:
        return {}
    count = numbers.pop("count").value
    if count % 1 > 0:
        reader.wrong(f"{name}.cylinder", f"count: expected a whole number, got {count:g}")
    if count == 1:
        return {}
    note = f"of one with the areas of {count:g} cylinders"
    own = {n: (x, count**power) for n, power in TOGETHER.items() if (x := numbers.get(n))}
    return {n: replace(x, value=factor * x.value, note=f"{x.note}; {note}") for n, (x, factor) in own.items()}


def _shape(reader: _Reader, name: str, value: Any) -> Path | None:
    """The file with the mesh of a link, relative to that of the crane."""
    if value is None or not reader.meshes:
        return None
    if not isinstance(value, str):
        reader.wrong(name, f'shape: expected a file, such as "{name}.glb", got {value!r}')
        return None
    path = reader.file.parent / value
    try:
        gltf.read_file(Location(path))
    except Problem as problem:
        reader.wrong(name, f"shape: {problem}")
    return path


def _rated(
    reader: _Reader, where: str, given: Given, read: Mapping[str, Number], density: float
) -> dict[str, Number]:
    """The area of a valve whose flow at a pressure drop over one edge is given: eq. (2).

    Also of the edge to the rod side; beside `valve`, `rod_flow` is that of a compensated section.
    """
    if "valve" in given and "flow" in given:
        reader.wrong(where, f"flow: expected none beside valve, got {given['flow']!r}")
    coefficient = numbers_of(BOOM_STICK)["parameters"]["valve_discharge_coefficient"].value
    rated, found = read["rated_flow"].value > 0, dict[str, Number]()
    drop = read["rated_drop"].value if rated else COMPENSATED
    flows = {"valve_area": read["rated_flow"]}
    if "rod_valve_area" in read and not read["rod_valve_area"].value:
        flows["rod_valve_area"] = read["rod_rated_flow"]
    note = "of its rated flow at a pressure drop over one edge" if rated else "of rod_flow at a compensator"
    for name, flow in flows.items():
        if flow.value > 0:
            area = flow.value / (coefficient * math.sqrt(2 * drop / density))
            found[name] = Number(area, "m2", "derived", note)
    return found


def _by_size(read: Mapping[str, Number], density: float) -> dict[str, Number]:
    """Numbers that the file does not have, at the size of the drive: those of the paper's boom and swing.

    The dead volume follows the swept one, friction of the piston the square of its bore, the volume of a
    motor its displacement, leakage the area of the valve, relief valves the flow of the section; the hose has
    5 m/s at it. A motor has at most half of what it displaces between its end stops: a rack in its middle.
    """
    of, size = {n: x.value for n, x in read.items()}, numbers_of(BOOM_STICK)["parameters"]
    paper = {n: x.value for n, x in {**numbers_of(SWING)["parameters"], **size}.items()}
    jet = paper["valve_discharge_coefficient"] * math.sqrt(2 * COMPENSATED / density)
    flow = of["rated_flow"] or of["valve_area"] * jet
    found = {"valve_leakage": of["valve_leakage"] * of["valve_area"] / paper["valve_area"]}
    found["hose_bore"] = max(math.sqrt(4 * flow / (math.pi * OIL_SPEED)), NARROWEST)
    if "bore" in of:
        bore = of["bore"] / paper["boom_bore"]
        found["dead_volume"] = of["dead_volume"] * bore**2 * of["stroke"] / paper["boom_stroke"]
        found["piston_damping"] = of["piston_damping"] * bore**2
    if "reliefs_gain" in of:
        shipped = numbers_of(BOOM_VARIANTS["compensated"])["parameters"]["port_relief_gain"].value
        found["reliefs_gain"] = shipped * flow / SECTION
    if "motor_volume" in of:
        volume = of["motor_volume"] * of["motor_displacement"] / paper["motor_displacement"]
        way = of["stop_at"] - of.get("stop_from", -of["stop_at"]) if "stop_at" in of else math.inf
        found["motor_volume"] = min(volume, of["motor_displacement"] * of["gear_ratio"] * way / 2)
    least = {n: DECLARED[n].minimum or 0.0 for n in found if n in DECLARED}
    values = {n: max(x, least.get(n, 0.0)) for n, x in found.items() if read[n].note == DEFAULT}
    return {n: replace(read[n], value=x) for n, x in values.items()}


def _inertia(reader: _Reader, name: str, value: Any, body: Mapping[str, Number]) -> dict[str, Number]:
    """Moments and products of inertia about the centre of mass; "bar": of a slender one from the joint on."""
    if value == "bar":
        c = [body[f"centre_{n}"].value for n in "xyz"]
        square, of = sum(x * x for x in c), body["mass"].value / 3
        found = [of * (square - x * x) for x in c] + [-of * c[a] * c[b] for a, b in ((0, 1), (0, 2), (1, 2))]
    else:
        some = value if isinstance(value, list) and len(value) in (3, 6) else [math.nan] * 3
        if some is not value:
            expected = f'"bar", or a list of 3 moments or of {", ".join(INERTIAS)} in kg.m2'
            reader.wrong(name, f"inertia: expected {expected}, got {value!r}")
            return {n: Number(math.nan, q.unit, "assumed", "") for n, q in INERTIA.items()}
        found = [reader.quantity(name, "inertia", x, "kg.m2") for x in some]
        found += [0.0] * (6 - len(found))
        if np.isfinite(found).all():
            low, middle, high = np.linalg.eigvalsh(np.array(found)[np.array(SYMMETRIC)])
            if high > LARGEST_SHARE * (low + middle):
                got = f"principal moments {low:.3g}, {middle:.3g}, {high:.3g} kg.m2"
                reader.wrong(name, f"inertia: {got}: of a body, none is above the sum of the two others")
    return {n: Number(x, "kg.m2", reader.source, reader.note) for n, x in zip(INERTIA, found, strict=True)}


def _check_masses(reader: _Reader, joints: Sequence[JointDescription]) -> None:
    """Behind each joint there is inertia about its axis, or mass, or its acceleration has no bound."""
    for joint in joints:
        beyond, names = list[JointDescription](), {joint.name}
        for other in joints:
            if other.name in names or other.parent in names:
                names.add(other.name)
                beyond.append(other)
        if joint.follows or (sum(j["mass"] for j in beyond) > 0 and not joint.revolute):
            continue
        along = joint.axis[-1]
        own = joint[f"inertia_{along}{along}"]
        off = sum(joint[f"centre_{n}"] ** 2 for n in "xyz" if n != along)
        if not own + joint["mass"] * off + sum(j["mass"] for j in beyond[1:]) > 0:
            what = "inertia about its axis" if joint.revolute else "mass"
            reader.wrong(joint.name, f"expected {what} at or beyond this joint, got none")
