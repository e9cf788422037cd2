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
from fmus.components.additions import Accumulator, Addition, ChamberReliefs, Cushion, Regeneration
from fmus.components.chain import Axis
from fmus.contract import quantities
from fmus.manipulator import MANIPULATOR
from fmus.parameters import SOURCES, Number
from fmus.parameters import numbers as numbers_of
from orchestrator.base import toml
from orchestrator.base.errors import Mistakes, Problem, suggest
from orchestrator.base.files import Location, write_whole
from orchestrator.base.units import Unit, number_and_unit, parse_unit
from orchestrator.data import gltf

# tables of a joint by its drive
USED: Mapping[str, tuple[str, ...]] = {
    "none": (),
    "motor": ("motor", "hydraulics"),
    "cylinder": ("cylinder", "hydraulics"),
    "four-bar": ("cylinder", "four_bar", "hydraulics"),
}
AXES = get_args(Axis)
Assembly: TypeAlias = Literal["above", "below"]
LARGEST_LENGTH = 100.0  # m
MOST_JOINTS = 60  # whose equations are made in some seconds
INERTIAS = ("xx", "yy", "zz", "xy", "xz", "yz")
SYMMETRIC = ((0, 3, 4), (3, 1, 5), (4, 5, 2))  # place of each entry of a matrix in INERTIAS
LARGEST_SHARE = 1 + 1e-6  # of a principal moment of inertia in the sum of the two others, with rounding


@dataclass(frozen=True)
class Key:
    """A quantity in the file.

    names      of the parameters that it gives, one or several
    default    of each if the key is missing; None: the key is required
    low, high  bounds; a positive quantity has a `low` above 0
    """

    unit: str
    names: tuple[str, ...]
    default: float | None = 0.0
    low: float = -math.inf
    high: float = math.inf


def _length(*names: str, default: float | None = 0.0, low: float = -LARGEST_LENGTH) -> Key:
    return Key("m", names, default, low, LARGEST_LENGTH)


BODY = {
    "at": _length("at_x", "at_y", "at_z"),
    "mass": Key("kg", ("mass",), 0.0, 0.0, 1e6),
    "centre": _length("centre_x", "centre_y", "centre_z"),
}
DRIVES: Mapping[str, Mapping[str, Key]] = {
    "cylinder": {
        "base": _length("base_x", "base_z", default=None),
        "pin": _length("pin_x", "pin_z", default=None),
        "closed": _length("closed_length", default=None, low=0.05),
        "stroke": _length("stroke", default=None, low=0.01),
        "bore": Key("m", ("bore",), None, 0.01, 0.5),
        "rod": Key("m", ("rod",), None, 0.005, 0.5),
        "dead_volume": Key("m3", ("dead_volume",), 3e-4, 1e-6, 0.1),
        "damping": Key("N.s/m", ("piston_damping",), 2e4, 0.0),
        "friction": Key("N", ("piston_coulomb",), 0.0, 0.0),
    },
    "four_bar": {
        "pivot": _length("pivot_x", "pivot_z", default=None),
        "rocker": _length("rocker", default=None, low=0.01),
        "coupler": _length("coupler", default=None, low=0.01),
        "pin": _length("link_x", "link_z", default=None),
    },
    "motor": {
        "displacement": Key("m3/rad", ("motor_displacement",), None, 1e-8, 1e-2),
        "ratio": Key("1", ("gear_ratio",), 1.0, 1e-3, 1e4),
        "volume": Key("m3", ("motor_volume",), 2e-4, 1e-6, 0.1),
    },
    "hydraulics": {
        "valve": Key("m2", ("valve_area",), 4e-5, 1e-8, 1e-2),
        "flow": Key("m3/s", ("rated_flow",), 0.0, 0.0, 0.1),
        "drop": Key("Pa", ("rated_drop",), 3.5e6, 1e4, 1e8),
        "dead_band": Key("V", ("valve_dead_band",), 0.6, 0.0, 9.0),
        "rounding": Key("V", ("valve_command_rounding",), 0.4, 1e-3, 9.0),
        "leakage": Key("m3/(s.Pa)", ("valve_leakage",), 1.6e-14, 1e-17, 1e-9),
        "hose": _length("hose_length", default=3.0, low=0.01),
        "hose_bore": Key("m", ("hose_bore",), 0.01905, 1e-3, 0.2),
    },
}
# keys of a cylinder that a drive does not have: the rocker's end is its pin; it lies along a telescope
UNUSED = {"four-bar": ("pin",), "telescope": ("base", "pin", "closed")}
TABLES: Mapping[str, Mapping[str, Key]] = {
    "base": {n: Key("rad", (f"base_{n}",), 0.0, -1.5, 1.5) for n in ("pitch", "roll")},
    "payload": {
        "at": _length("tip_x", "tip_y", "tip_z", default=None),
        "length": _length("load_length", low=0.0),
        "mass": Key("kg", ("payload_mass",), 0.0, 0.0, 1e6),
    },
    "ground": {
        "height": _length("ground_height"),
        "stiffness": Key("N/m", ("ground_stiffness",), 2e6, 0.0),
        "damping": Key("s/m", ("ground_damping",), 0.5, 0.0),
        "friction": Key("1", ("ground_friction",), 0.6, 0.0, 10.0),
    },
    "oil": {
        "density": Key("kg/m3", ("density",), 870.0, 500.0, 1500.0),
        "viscosity": Key("Pa.s", ("viscosity",), 0.02, 1e-4, 10.0),
        "bulk_modulus": Key("Pa", ("bulk_modulus",), 1.4e9, 1e8, 1e10),
    },
    "supply": {
        "pressure": Key("Pa", ("pressure_setting",), 2.07e7, 1e5, 1e8),
        "return": Key("Pa", ("reservoir_pressure",), 0.0, 0.0, 1e7),
    },
}
# tables of a joint with a cylinder, and of the supply: components in addition; keys are their quantities
ADDITIONS: Mapping[str, type[Addition]] = {
    "cushion": Cushion,
    "reliefs": ChamberReliefs,
    "regeneration": Regeneration,
}
OF_SUPPLY: Mapping[str, type[Addition]] = {"accumulator": Accumulator}


def keys_of(table: str, addition: type[Addition]) -> dict[str, Key]:
    """Keys of the table of an addition."""
    found = dict[str, Key]()
    for n, q in quantities(addition).items():
        low, high = (
            -math.inf if q.minimum is None else q.minimum,
            math.inf if q.maximum is None else q.maximum,
        )
        found[n] = Key(q.unit, (f"{table}_{n}",), q.value, low, high)
    return found


# of a data sheet; `check` compares
DATASHEET = {
    "lifting_moment": Key("N.m", ("lifting_moment",), 0.0, 0.0),
    "reach": Key("m", ("reach",), 0.0, 0.0),
}
WORDS = (
    *("joint", "axis", "parent", "drive", "follows", "ratio", "inertia", "damping", "friction", "stiffness"),
    *("stop", *ADDITIONS, "shape", "source", "note"),
)
TEXTS = ("title", "source", "note")
WORD, PART = "[a-z][a-z0-9]*", "[a-z][a-z0-9_]*"
COMPONENTS = (  # names of other components of a machine
    *("manipulator", "supply", "controller", "valve_actuation", "operator_input", "sensors", "diagnosis"),
)
OPTIONAL = ("follows",)
DEFAULT = "default"  # note of a number that the file does not have
ONE = Number(1.0, "1", "assumed", DEFAULT)
MEANT = {"m": ("mm", "cm"), "rad": ("deg",)}  # units of a number that is out of range without one
TURN = 2 * math.pi
NEW = Path(__file__).with_name("new.toml")  # a crane to begin with
EXAMPLES = {"m": "350 mm", "rad": "20 deg", "Pa": "207 bar", "m2": "40 mm2", "m3/s": "60 L/min"}
EXAMPLES |= {"N.m": "120 kN.m", "m3/rad": "160 cm3/rev", "N.s/m": "30 kN.s/m", "kg": "900 kg"}
# as data sheets write units; a moment in t.m is that of a weight
SHEETS = {
    "Nm": "N.m",
    "kNm": "kN.m",
    "tm": "t.m",
    "mt": "t.m",
    "cc": "cm3",
    "ccm": "cm3",
    "U": "rev",
    "lbs": "lb",
}
GRAVITY = 9.80665  # m/s2, standard


@dataclass(frozen=True)
class JointDescription:
    """A joint with the link behind it.

    kind       "revolute" or "prismatic"
    axis       in the frame of the parent
    parent     joint whose link carries this one; "": the base
    follows    joint whose motion this one has, times `ratio`; "": none
    assembly   of a four-bar: "above" or "below" the line of its pivots
    part       of the machine that has its hydraulics
    numbers    its parameters, without the name of the joint
    shape      mesh of its link, binary glTF; None: the page draws beams
    additions  names of the components in addition that its cylinder has
    """

    name: str
    kind: Literal["revolute", "prismatic"]
    axis: Axis
    parent: str
    drive: str
    numbers: Mapping[str, Number]
    start: Number
    follows: str = ""
    ratio: Number = ONE
    assembly: Assembly = "above"
    part: str = ""
    shape: Path | None = None
    additions: tuple[str, ...] = ()

    @property
    def coordinate(self) -> str:
        """Name of its coordinate."""
        return f"{self.name}_{'angle' if self.kind == 'revolute' else 'extension'}"

    def __getitem__(self, name: str) -> float:
        return self.numbers[name].value


@dataclass(frozen=True)
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
        first = next((k for k, j in enumerate(way) if j.drive != "none"), 0)
        still = (k for k, j in enumerate(way) if k > first and j.drive in ("none", "motor") and not j.follows)
        end = next(still, len(way))
        return tuple(way[:end]), way[end] if end < len(way) else None

    @property
    def driven(self) -> tuple[JointDescription, ...]:
        """The joints with a drive of their own."""
        return tuple(j for j in self.joints if j.drive != "none")


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

    def unknown(self, table: str, given: Mapping[str, Any], names: Collection[str]) -> None:
        """Note each key that has none of these names."""
        for key in given:
            if key not in names:
                hint = suggest(key, names) or f"; there are {', '.join(names)}"
                self.wrong(table, f"unknown key {key!r}{hint}")

    def tables(self, where: str, given: Any) -> Mapping[str, Any]:
        """A table, empty after a mistake."""
        if isinstance(given, dict):
            return given
        self.wrong(where, f"expected a table, got {given!r}")
        return {}

    def one_of(
        self, table: str, given: Mapping[str, Any], key: str, choices: Sequence[str], default: str = ""
    ) -> str:
        """One of some words; the first one after a mistake."""
        value = given.get(key, default)
        if value in choices or (value == "" and default == "" and key not in given and key in OPTIONAL):
            return str(value)
        hint = suggest(value, choices) if isinstance(value, str) and value else ""
        got = repr(value) if key in given else "nothing"
        self.wrong(table, f"{key}: expected one of {', '.join(choices) or 'none'}, got {got}{hint}")
        return choices[0] if choices else ""

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

    def numbers(self, table: str, given: Mapping[str, Any], keys: Mapping[str, Key]) -> dict[str, Number]:
        """The parameters of the keys of a table."""
        found = dict[str, Number]()
        for key, rule in keys.items():
            source, note = (self.source, self.note) if key in given else ("assumed", DEFAULT)
            for n, x in zip(rule.names, self._entries(table, key, given.get(key), rule), strict=True):
                found[n] = Number(x, rule.unit, source, note)
        return found

    def addition(self, where: str, value: Any, keys: Mapping[str, Key]) -> dict[str, Number]:
        """The parameters of a table that may be missing; none after a mistake."""
        if not isinstance(value, dict):
            self.tables(where, value)
            return {}
        self.unknown(where, value, keys)
        return self.numbers(where, value, keys)

    def _entries(self, table: str, key: str, value: Any, rule: Key) -> list[float]:
        size = len(rule.names)
        shape = f"a list of {size} numbers in {rule.unit}" if size > 1 else f"a number in {rule.unit}"
        if value is None and rule.default is not None:
            return [rule.default] * size
        entries = value if isinstance(value, list) and size > 1 else [value]
        if value is None or len(entries) != size:
            self.wrong(table, f"{key}: expected {shape}, got {'nothing' if value is None else repr(value)}")
            return [math.nan] * size
        found = [self.quantity(table, key, x, rule.unit) for x in entries]
        for x, given in zip(found, entries, strict=True):
            if x < rule.low or x > rule.high:
                self.wrong(table, f"{key}: {_out_of_range(x, given, rule)}")
        return found


def _out_of_range(value: float, given: Any, rule: Key) -> str:
    """What was expected, and the unit that may be meant."""
    units = () if isinstance(given, str) else MEANT.get(rule.unit, ())
    meant = [u for u in units if rule.low <= value * parse_unit(u).factor <= rule.high]
    hint = f'; did you mean "{value:g} {meant[0]}"?' if meant else ""
    return f"expected {rule.low:g} to {rule.high:g} {rule.unit}, got {given!r}{hint}"


def read(path: Path, data: bytes | None = None) -> CraneDescription:
    """A crane from its file, or from its content in a system, without meshes; a Problem with all mistakes."""
    content = dict((toml.read_file(path) if data is None else toml.read(path, data)).data)
    reader = _with_origin(_Reader(path, "assumed", "", meshes=data is None), "", content)
    title, starts = content.pop("title", path.stem), reader.tables("start", content.pop("start", {}))
    for key in ("source", "note"):
        content.pop(key, None)
    datasheet = reader.tables("datasheet", content.pop("datasheet", {}))
    reader.unknown("datasheet", datasheet, (*DATASHEET, "loads"))
    told = {n: x.value for n, x in reader.numbers("datasheet", datasheet, DATASHEET).items()}
    loads = _loads(reader, datasheet.get("loads", []))
    given_tables = {*content}
    tables = {n: reader.tables(n, content.pop(n, {})) for n in TABLES}
    numbers = {n: reader.numbers(n, given, TABLES[n]) for n, given in tables.items()}
    for n in (n for n in OF_SUPPLY if n in tables["supply"]):
        numbers["supply"] |= reader.addition(f"supply.{n}", tables["supply"][n], keys_of(n, OF_SUPPLY[n]))
    if "ground" not in given_tables:
        numbers["ground"] = {}
    for n, given in tables.items():
        reader.unknown(n, given, (*TABLES[n], *{"payload": ("on", "along"), "supply": OF_SUPPLY}.get(n, ())))
    names = [n for n, given in content.items() if isinstance(given, dict)]
    tops = (*TEXTS, *TABLES, "start", "datasheet")
    reader.unknown("", {n: x for n, x in content.items() if n not in names}, tops)
    density = numbers["oil"]["density"].value
    if len(names) > MOST_JOINTS:
        raise Problem(f"{path}: expected at most {MOST_JOINTS} joints, got {len(names)}")
    joints = [_joint(reader, n, content[n], names[:k], starts, density) for k, n in enumerate(names)]
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
    units = ("m", "kg")
    pairs = (
        (reader.quantity("datasheet", "loads", x, unit) for x, unit in zip(p, units, strict=True))
        for p in value
    )
    return tuple((reach, load) for reach, load in pairs)


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


def _with_origin(reader: _Reader, table: str, given: Mapping[str, Any]) -> _Reader:
    """The reader with source and note of a table."""
    source, note = given.get("source", reader.source), given.get("note", reader.note)
    if source not in SOURCES:
        reader.wrong(table, f"source: expected one of {', '.join(SOURCES)}, got {source!r}")
    return replace(reader, source=str(source), note=str(note))


def _joint(
    reader: _Reader,
    name: str,
    given: Mapping[str, Any],
    before: Sequence[str],
    starts: Mapping[str, Any],
    density: float,
) -> JointDescription:
    if not re.fullmatch(WORD, name):
        expected = (
            f"a joint name of one word of small letters and digits: its signals are such as {name}_angle"
        )
        reader.wrong(name, f"expected {expected}")
    reader = _with_origin(reader, name, given)
    kind = reader.one_of(name, given, "joint", ("revolute", "prismatic"), "revolute")
    drive = reader.one_of(name, given, "drive", tuple(USED), "none")
    axis = reader.one_of(name, given, "axis", AXES)
    parent = reader.one_of(name, given, "parent", (*before, "base"), before[-1] if before else "base")
    follows = reader.one_of(name, given, "follows", tuple(before))
    rotational = kind == "revolute"
    if follows and drive != "none":
        reader.wrong(name, f"drive: expected none of a joint that follows {follows}, got {drive!r}")
    if not rotational and drive in ("motor", "four-bar"):
        reader.wrong(name, f"drive: expected cylinder or none of a prismatic joint, got {drive!r}")
    if (
        rotational and drive in ("cylinder", "four-bar") and axis != "-y"
    ):  # pins are [x, z] in the plane of it
        reader.wrong(name, f'axis: expected "-y" of a joint with a cylinder, got {axis!r}')
    damping = Key("N.m.s/rad" if rotational else "N.s/m", ("damping",), 0.0, 0.0)
    stiffness = Key("N.m/rad" if rotational else "N/m", ("stiffness",), 0.0, 0.0)
    start = Key("rad", (name,), 0.0, -TURN, TURN) if rotational else _length(name)
    if "stiffness" in given and (drive != "none" or follows):
        reader.wrong(name, f"stiffness: expected none of a joint with a drive, got {given['stiffness']!r}")
    reader.unknown(name, given, (*BODY, *WORDS, *USED[drive]))
    of_joint = {"damping": damping, "stiffness": stiffness}
    if rotational:
        of_joint["friction"] = Key("N.m", ("coulomb",), 0.0, 0.0)
    elif "friction" in given:
        reader.wrong(name, "friction: expected none of a prismatic joint: its cylinder has one")
    numbers = reader.numbers(name, given, {**BODY, **of_joint})
    if "stop" in given:
        if follows or drive in ("cylinder", "four-bar"):
            reader.wrong(name, "stop: expected none of a joint that follows another one or has a cylinder")
        numbers |= _stop(reader, name, given["stop"], rotational)
    numbers |= _inertia(reader, name, given.get("inertia", [0, 0, 0]), numbers)
    additions = tuple(n for n in ADDITIONS if n in given)
    for n in additions:
        if drive not in ("cylinder", "four-bar"):
            reader.wrong(name, f"{n}: expected a joint with a cylinder, got drive {drive!r}")
        numbers |= reader.addition(f"{name}.{n}", given[n], keys_of(n, ADDITIONS[n]))
    part, assembly = "drives", "above"
    for table in USED[drive]:
        where, inner = f"{name}.{table}", reader.tables(f"{name}.{table}", given.get(table, {}))
        own = {"hydraulics": ("part",), "four_bar": ("assembly",)}.get(table, ())
        left_out = UNUSED.get(drive if rotational else "telescope", ()) if table == "cylinder" else ()
        keys = {n: rule for n, rule in DRIVES[table].items() if n not in left_out}
        reader.unknown(where, inner, (*keys, *own))
        numbers |= reader.numbers(where, inner, keys)
        if "assembly" in own:
            assembly = reader.one_of(where, inner, "assembly", ("above", "below"))
        elif "part" in own:
            part = inner.get("part", "drives")
            if not isinstance(part, str) or not re.fullmatch(PART, part) or part in COMPONENTS:
                expected = f"a name of small letters, digits and _, none of {', '.join(COMPONENTS)}"
                reader.wrong(where, f"part: expected {expected}, got {part!r}")
                part = "drives"
            numbers |= _rated(reader, where, inner, numbers, density)
    if "rod" in numbers and numbers["rod"].value >= numbers["bore"].value:
        rod, bore = (1e3 * numbers[n].value for n in ("rod", "bore"))
        reader.wrong(
            f"{name}.cylinder", f"rod: expected thinner than the bore of {bore:g} mm, got {rod:g} mm"
        )
    if "closed_length" in numbers:
        closed, least = (
            1e3 * x for x in (numbers["closed_length"].value, numbers["stroke"].value + numbers["bore"].value)
        )
        if closed < least:
            expected = f"at least {least:g} mm, the stroke and a bore for piston, gland and eyes"
            reader.wrong(f"{name}.cylinder", f"closed: expected {expected}, got {closed:g} mm")
    begin = reader.numbers("start", starts, {name: start})[name]
    if "stop_at" in numbers and abs(begin.value) > numbers["stop_at"].value:
        reader.wrong("start", f"{name}: expected between the end stops of the joint, got {starts[name]!r}")
    return JointDescription(
        name=name,
        kind="revolute" if rotational else "prismatic",
        axis=cast(Axis, axis),
        parent="" if parent == "base" else parent,
        drive=drive,
        numbers=numbers,
        start=begin,
        follows=follows,
        ratio=Number(
            reader.quantity(name, "ratio", given.get("ratio", 1.0), "1"), "1", reader.source, reader.note
        ),
        part=part,
        assembly=cast(Assembly, assembly),
        shape=_shape(reader, name, given.get("shape")),
        additions=additions,
    )


def _stop(reader: _Reader, name: str, value: Any, rotational: bool) -> dict[str, Number]:
    """End stops on both sides of a joint; the defaults of a revolute one are those of the paper's column."""
    column = numbers_of(MANIPULATOR)["parameters"]
    stiffness, damping = (
        column[f"swing_stop_{n}"].value if rotational else None for n in ("stiffness", "damping")
    )
    unit = "rad" if rotational else "m"
    keys = {
        "at": Key(unit, ("stop_at",), None, 1e-3, TURN if rotational else LARGEST_LENGTH),
        "stiffness": Key("N.m/rad" if rotational else "N/m", ("stop_stiffness",), stiffness, 1.0),
        "damping": Key(f"s/{unit}", ("stop_damping",), damping, 0.0),
    }
    return reader.addition(f"{name}.stop", value, keys)


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
    reader: _Reader, where: str, given: Mapping[str, Any], read: Mapping[str, Number], density: float
) -> dict[str, Number]:
    """The area of a valve whose flow at a pressure drop over one edge is given: eq. (2)."""
    if "valve" in given and "flow" in given:
        reader.wrong(where, f"flow: expected none beside valve, got {given['flow']!r}")
    if not read["rated_flow"].value > 0:
        return {}
    coefficient = numbers_of(BOOM_STICK)["parameters"]["valve_discharge_coefficient"].value
    area = read["rated_flow"].value / (coefficient * math.sqrt(2 * read["rated_drop"].value / density))
    return {"valve_area": Number(area, "m2", "derived", "of its rated flow at a pressure drop over one edge")}


def _inertia(reader: _Reader, name: str, value: Any, body: Mapping[str, Number]) -> dict[str, Number]:
    """Moments and products of inertia about the centre of mass; "bar": of a slender one from the joint on."""
    unit, keys = "kg.m2", tuple(f"inertia_{n}" for n in INERTIAS)
    if value == "bar":
        c = [body[f"centre_{n}"].value for n in "xyz"]
        square, of = sum(x * x for x in c), body["mass"].value / 3
        found = [of * (square - x * x) for x in c] + [-of * c[a] * c[b] for a, b in ((0, 1), (0, 2), (1, 2))]
    else:
        some = value if isinstance(value, list) and len(value) in (3, 6) else [math.nan] * 3
        if some is not value:
            expected = f'"bar", or a list of 3 moments or of {", ".join(INERTIAS)} in {unit}'
            reader.wrong(name, f"inertia: expected {expected}, got {value!r}")
            return {n: Number(math.nan, unit, "assumed", "") for n in keys}
        found = [reader.quantity(name, "inertia", x, unit) for x in some]
        found += [0.0] * (6 - len(found))
        if np.isfinite(found).all():
            low, middle, high = np.linalg.eigvalsh(np.array(found)[np.array(SYMMETRIC)])
            if high > LARGEST_SHARE * (low + middle):
                got = f"principal moments {low:.3g}, {middle:.3g}, {high:.3g} kg.m2"
                reader.wrong(name, f"inertia: {got}: of a body, none is above the sum of the two others")
    return {n: Number(x, unit, reader.source, reader.note) for n, x in zip(keys, found, strict=True)}


def _check_masses(reader: _Reader, joints: Sequence[JointDescription]) -> None:
    """Behind each joint there is inertia about its axis, or mass, or its acceleration has no bound."""
    for joint in joints:
        beyond, names = list[JointDescription](), {joint.name}
        for other in joints:
            if other.name in names or other.parent in names:
                names.add(other.name)
                beyond.append(other)
        if joint.follows or (sum(j["mass"] for j in beyond) > 0 and joint.kind == "prismatic"):
            continue
        along = joint.axis[-1]
        own = joint[f"inertia_{along}{along}"]
        off = sum(joint[f"centre_{n}"] ** 2 for n in "xyz" if n != along)
        if not own + joint["mass"] * off + sum(j["mass"] for j in beyond[1:]) > 0:
            what = "inertia about its axis" if joint.kind == "revolute" else "mass"
            reader.wrong(joint.name, f"expected {what} at or beyond this joint, got none")
