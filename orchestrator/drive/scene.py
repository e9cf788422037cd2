"""The drawing of a machine: bodies, joints and cylinders, as `[scene]` of its view description declares them.

A body is what one joint moves; the body "ground" stands still. A body has a frame: x along it, y to the left,
z upwards, with its origin at its joint. `pose` of `rig.js` places the bodies by the values of the joints.

A length is a number [m], or a formula: a sum of products of numbers, of parameters of the mechanics, and of
`sizes`, such as "boom_pivot_x - 0.26". So the drawing follows the parameters of a system.
"""

import base64
import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from itertools import chain
from typing import Annotated, Any, Literal

from orchestrator.base.errors import Problem, suggest
from orchestrator.base.numerals import finite
from orchestrator.base.toml import Rule
from orchestrator.data.gltf import Mesh
from orchestrator.ssp.parameter_sets import parameter_sets
from orchestrator.ssp.system import Component, System

GROUND = "ground"  # the body that stands still
_PRODUCT = r"(?:\d+(?:\.\d*)?|[A-Za-z_]\w*)(?:\*(?:\d+(?:\.\d*)?|[A-Za-z_]\w*))*"
_FORMULA = re.compile(rf"-?{_PRODUCT}(?:[+-]{_PRODUCT})*")
_NAME = re.compile(r"\b[A-Za-z_]\w*")
LENGTH = Rule(
    'a number or a sum of products, such as "0.5*arm_length - 0.2"',
    lambda value: not isinstance(value, str) or _FORMULA.fullmatch(value.replace(" ", "")) is not None,
)
GLB = Rule(
    "a file of this folder that ends in .glb", lambda value: re.fullmatch(r"[\w-]+\.glb", value) is not None
)
THREE = Rule("three lengths", lambda value: len(value) == 3)
Length = Annotated[float | str, LENGTH]
Position = Annotated[tuple[Length, ...], THREE]
Values = Mapping[str, float]  # by name
ORIGIN = (0.0, 0.0, 0.0)
DARK, STEEL, CHROME = "#343a40", "#6d757c", "#c9d1d8"  # of cylinders
EYE = 0.13  # m; length of the eye at the end of a rod


@dataclass(frozen=True)
class Joint:
    """A joint, which moves the body of its name.

    axis      direction in `frame`
    signal    its value, an angle [rad] or a length [m]
    kind      revolute: turns about the axis; prismatic: slides along it
    parent    the body that carries it
    at        its position in the parent
    frame     the body in whose directions it stands at zero; default: the parent
    initial   parameter with its value at the start, which is shown until the first frame; default: zero
    """

    axis: Literal["x", "y", "z", "-x", "-y", "-z"]
    signal: str
    kind: Literal["revolute", "prismatic"] = "revolute"
    parent: str = GROUND
    at: Position = ORIGIN
    frame: str = ""
    initial: str = ""


@dataclass(frozen=True)
class Place:
    """A point of a body."""

    body: str
    at: Position


@dataclass(frozen=True)
class Cylinder:
    """A hydraulic cylinder NAME between two bodies. Its own bodies are NAME_barrel and NAME_rod.

    Half of the barrel shows the pressure NAME_head, half NAME_rod.
    """

    base: Place
    pin: Place
    closed_length: Length
    stroke: Length
    barrel_radius: float = 0.078
    rod_radius: float = 0.040


@dataclass(frozen=True)
class Shape:
    """A part of the drawing, fixed to a body.

    size     box: lengths along x, y, z; plate: thickness; round: radii at both ends, length; tube: radius;
             mesh: none
    at       centre of a box, begin of a round, origin of the outline of a plate and of a mesh
    file     of a mesh, binary glTF (`orchestrator.data.gltf`) next to the view description
    path     outline of a plate in x and z, or points of a tube
    scale    unit of `path`; default: 1 m
    axis     of a round
    colour   "#rrggbb", or a name of `colours`
    channel  a name of `pressures`: the pressure that colours the shape instead
    mirror   True: there is a second one on the other side of the plane y = 0
    """

    body: str
    kind: Literal["box", "plate", "round", "tube", "mesh"]
    size: tuple[Length, ...] = ()
    at: Position = ORIGIN
    path: tuple[tuple[Length, ...], ...] = ()
    scale: Length = 1.0
    axis: Literal["x", "y", "z"] = "x"
    colour: str = "#888888"
    channel: str = ""
    mirror: bool = False
    file: Annotated[str, GLB] = ""

    def __post_init__(self) -> None:
        expected = {"box": 3, "round": 3, "mesh": 0}.get(self.kind, 1)
        if len(self.size) != expected:
            raise Problem(f"scene: {self.kind}: size: expected {expected} lengths, got {len(self.size)}")
        expected = 3 if self.kind == "tube" else 2
        if (self.kind == "mesh") != bool(self.file):
            raise Problem(f"scene: {self.kind}: file: expected of a mesh, and only there, got {self.file!r}")
        if any(len(point) != expected for point in self.path):
            raise Problem(f"scene: {self.kind}: path: expected points of {expected} lengths")


@dataclass(frozen=True)
class Scene:
    """The drawing. Joints are in order: parent and frame of each are the ground or above it.

    ground      height of the ground [m]
    tip         the point that leaves a trail, and that a view follows
    sizes       name -> length, in order; formulas may use it
    defaults    parameters that a machine may lack -> value
    views       name -> position of the camera, then the point that it looks at [m]
    pressures   channel of the drawing -> signal of its pressure
    meshes      file of a shape -> its content, which `view_description` reads
    """

    joints: Mapping[str, Joint]
    tip: Place
    ground: float = 0.0
    cylinders: Mapping[str, Cylinder] = field(default_factory=dict)
    shapes: tuple[Shape, ...] = ()
    sizes: Mapping[str, Length] = field(default_factory=dict)
    defaults: Mapping[str, float] = field(default_factory=dict)
    views: Mapping[str, tuple[float, float, float, float, float, float]] = field(default_factory=dict)
    colours: Mapping[str, str] = field(default_factory=dict)
    pressures: Mapping[str, str] = field(default_factory=dict)
    meshes: Mapping[str, tuple[Mesh, ...]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Refuse names of bodies and channels that do not exist, or come later."""
        known = [GROUND]
        for name, joint in self.joints.items():
            _require(f"joints.{name}", known, joint.parent, joint.frame or GROUND)
            known.append(name)
        points = {f"cylinders.{name}": (c.base.body, c.pin.body) for name, c in self.cylinders.items()}
        for where, bodies in ({"tip": (self.tip.body,)} | points).items():
            _require(where, known, *bodies)
        known += [f"{name}_{part}" for name in self.cylinders for part in ("barrel", "rod")]
        for number, shape in enumerate(self.shapes, 1):
            _require(f"shapes {number}", known, shape.body)
            _require(f"shapes {number}", ["", *self.pressures], shape.channel)

    @property
    def signals(self) -> tuple[str, ...]:
        """The values of the joints."""
        return tuple(joint.signal for joint in self.joints.values())

    @property
    def initial(self) -> Mapping[str, int]:
        """Parameters with the initial values of joints -> number of the joint."""
        return {joint.initial: k for k, joint in enumerate(self.joints.values()) if joint.initial}

    @property
    def parameters(self) -> list[str]:
        """Parameters of the mechanics that the drawing needs."""
        places = [joint.at for joint in self.joints.values()] + [self.tip.at]
        for c in self.cylinders.values():
            places += [c.base.at, c.pin.at, (c.closed_length, c.stroke)]
        for s in self.shapes:
            places += [s.size, s.at, *s.path, (s.scale,)]
        lengths = [*self.sizes.values(), *chain.from_iterable(places)]
        names = dict.fromkeys(name for text in lengths for name in _NAME.findall(str(text)))
        return [name for name in names if name not in self.sizes and name not in self.defaults]


def _require(where: str, known: list[str], *names: str) -> None:
    for name in names:
        if name not in known:
            expected = f"expected one of {', '.join(filter(None, known)) or 'none'}"
            raise Problem(f"scene: {where}: {expected}, got {name!r}{suggest(name, known)}")


def parameters(scene: Scene, system: System) -> Values:
    """Real parameters of the component with those of the arm. Raises `Problem` if there is none."""
    needed, components = scene.parameters, system.components.values()
    if not needed:
        return {}
    if found := [c for c in components if all(name in c.interface.variables for name in needed)]:
        return _finite(max(found, key=lambda c: sum(n in c.interface.variables for n in scene.initial)))
    expected = f"expected a component with the arm's parameters, {needed[0]} to {needed[-1]}"
    raise Problem(f"{system.source or system.name}: {expected}, found none in {', '.join(system.components)}")


def sizes(scene: Scene, values: Values) -> Values:
    """Values of the names in formulas: the parameters, and `sizes`."""
    known = {**scene.defaults, **values}
    for name, formula in scene.sizes.items():
        known[name] = length(formula, known)
    return known


def start(scene: Scene, values: Values) -> list[float]:
    """Initial values of the joints, from the parameters."""
    return [values.get(joint.initial, 0.0) for joint in scene.joints.values()]


def pose_names(scene: Scene | None, system: System) -> tuple[str, ...]:
    """Names of the parameter sets that set the initial values of the joints."""
    initial = [name.encode() for name in scene.initial] if scene else []
    texts = {name: file.read() for name, file in parameter_sets(system).items()}
    return tuple(name for name, text in texts.items() if initial and all(one in text for one in initial))


def _finite(component: Component) -> Values:
    """Values of the real parameters, as set in the system, else those of the FMU."""
    values = component.real_parameters()
    for name, value in values.items():
        if not math.isfinite(value):
            raise Problem(f"{component.name}.{name}: expected a finite number, got {value}")
    return values


def length(formula: float | str, known: Values) -> float:
    """Value of a length [m]."""
    if not isinstance(formula, str):
        return formula
    total = 0.0
    for sign, product in re.findall(r"([+-]?)([^+-]+)", formula.replace(" ", "")):
        if missing := [name for name in _NAME.findall(product) if name not in known]:
            raise Problem(f"scene: {formula!r}: {missing[0]} is not known, or only later")
        try:
            value = math.prod(known[f] if f in known else finite(f) for f in product.split("*"))
        except ValueError as error:
            raise Problem(f"scene: {formula!r}: {error}") from None
        total += -value if sign == "-" else value
    if not math.isfinite(total):
        raise Problem(f"scene: {formula!r}: expected a finite length, got {total}")
    return total


# ---- for the browser


def data(scene: Scene, values: Values) -> dict[str, Any]:
    """Joints, cylinders, tip and shapes with numbers, for `rig.js`."""
    known = sizes(scene, values)

    def numbers(lengths: tuple[float | str, ...]) -> list[float]:
        return [length(formula, known) for formula in lengths]

    def place(point: Place) -> dict[str, Any]:
        return {"body": point.body, "at": numbers(point.at)}

    joints = [
        {
            "body": name,
            "parent": joint.parent,
            "frame": joint.frame or joint.parent,
            "at": numbers(joint.at),
            "axis": [(-1 if "-" in joint.axis else 1) * (letter in joint.axis) for letter in "xyz"],
            "slides": joint.kind == "prismatic",
        }
        for name, joint in scene.joints.items()
    ]
    cylinders = [{"name": n, "base": place(c.base), "pin": place(c.pin)} for n, c in scene.cylinders.items()]
    own = (s for n, c in scene.cylinders.items() for s in _cylinder_shapes(n, c, known))
    sides = (one for s in (*scene.shapes, *own) for one in _sides(s, known))
    shapes = [part for one in sides for part in _parts(one, scene, known)]
    return {"joints": joints, "cylinders": cylinders, "tip": place(scene.tip), "shapes": shapes}


def _parts(shape: Shape, scene: Scene, known: Values) -> Iterator[dict[str, Any]]:
    """The shape as data, rounded to 0.1 mm; of a mesh one part for each colour."""
    unit = length(shape.scale, known)
    size, at = ([round(length(v, known), 4) for v in values] for values in (shape.size, shape.at))
    path = [[round(length(v, known) * unit, 4) for v in values] for values in shape.path]
    colour = scene.colours.get(shape.colour, shape.colour)
    kept: dict[str, Any] = {
        "body": shape.body,
        "kind": shape.kind,
        "axis": shape.axis,
        "channel": shape.channel,
    }
    kept |= {"size": size, "at": at, "path": path, "colour": colour}
    if shape.kind != "mesh":
        yield kept
    for mesh in scene.meshes.get(shape.file, ()):
        points, corners = (base64.b64encode(x).decode() for x in (mesh.points, mesh.corners))
        yield kept | {"colour": mesh.colour or colour, "points": points, "corners": corners}


def _sides(shape: Shape, known: Values) -> Iterator[Shape]:
    """The shape, and the one on the other side."""
    yield shape
    if shape.mirror:
        x, y, z = (length(v, known) for v in shape.at)
        across = length(shape.size[2], known) if shape.axis == "y" else 0.0
        path = tuple((p[0], -length(p[1], known), p[2]) if len(p) == 3 else p for p in shape.path)
        yield replace(shape, at=(x, -y - across, z), path=path)


def _cylinder_shapes(name: str, cylinder: Cylinder, known: Values) -> Iterator[Shape]:
    """A barrel shows the head pressure in its lower part, the rod pressure in its upper part."""
    stroke = length(cylinder.stroke, known)
    end = length(cylinder.closed_length, known) - EYE
    split, thick, thin = 0.62 * end, cylinder.barrel_radius, cylinder.rod_radius
    barrel, rod, head = f"{name}_barrel", f"{name}_rod", f"{name}_head"

    def bar(body: str, begin: float, radius: float, long: float, colour: str, channel: str = "") -> Shape:
        at, size = (begin, 0.0, 0.0), (radius, radius, long)
        return Shape(body, "round", size, at, colour=colour, channel=channel)

    def eye(body: str, radius: float) -> Shape:
        return Shape(body, "round", (radius, radius, 0.15), (0.0, -0.075, 0.0), axis="y", colour=DARK)

    yield eye(barrel, 0.075)
    yield bar(barrel, 0.05, thick, split - 0.05, STEEL, head)
    yield bar(barrel, split, thick + 0.006, 0.035, DARK)
    yield bar(barrel, split + 0.035, thick, end - split - 0.035, STEEL, rod)
    yield bar(barrel, end - 0.05, thick + 0.009, 0.06, DARK)
    yield bar(rod, -(stroke + 0.2), thin, stroke + 0.2, CHROME)
    yield eye(rod, 0.068)
