"""The structure in a .ssd file as flat tables: components, connectors, connections, bindings.

From chains of connectors to direct connections between components, with one linear map each.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import pairwise
from typing import NamedTuple

from orchestrator.base.coupling import Suggestion
from orchestrator.base.errors import Problem, suggest
from orchestrator.base.files import Location
from orchestrator.base.units import IDENTITY, DeclaredUnit, Linear, conversion
from orchestrator.base.xml import (
    Element,
    child,
    children,
    finite,
    local,
    number,
    parse,
    required,
    transformation,
    truth,
    units,
)
from orchestrator.fmi.description import FLOATS
from orchestrator.ssp.annotations import left_out, read_suggestion
from orchestrator.ssp.system import Port, System

SOURCES = ("output", "calculatedParameter", "local", "constant")  # kinds of connectors that give a value
SINKS = ("input", "parameter", "structuralParameter")
FMU, SSD, SSP = "application/x-fmu-sharedlibrary", "application/x-ssp-definition", "application/x-ssp-package"
SOURCE, SINK = "source", "sink"


class Node(NamedTuple):
    """A connector; `owner` is the path of its component or system, empty for the outermost system."""

    owner: str
    connector: str

    def __str__(self) -> str:
        return f"{self.owner}.{self.connector}" if self.owner else self.connector


class Hop(NamedTuple):
    """What feeds a connector."""

    source: Node
    map: Linear
    suppressed: bool


class Binding(NamedTuple):
    """A ParameterBinding of the component or system at `owner`, found in `file`."""

    owner: str
    element: Element
    file: Location


@dataclass
class Flat:
    """All systems of an SSP in flat tables.

    roots   every .ssd file that was read, the outermost first
    """

    name: str
    file: Location
    sources: dict[str, Location] = field(default_factory=dict)  # component path -> FMU
    systems: set[str] = field(default_factory=set)
    kinds: dict[Node, str] = field(default_factory=dict)
    units: dict[Node, DeclaredUnit] = field(default_factory=dict)
    hops: dict[Node, Hop] = field(default_factory=dict)
    arrays: set[Node] = field(default_factory=set)
    bindings: list[Binding] = field(default_factory=list)  # innermost first
    known_units: dict[str, DeclaredUnit] = field(default_factory=dict)
    start: float | None = None
    stop: float | None = None
    suggestion: Suggestion = Suggestion()  # noqa: RUF009  frozen
    roots: list[tuple[Location, Element]] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    def connectors(self, owner: str, *kinds: str) -> list[Node]:
        """Connectors of one component or system, of some kinds."""
        return [n for n, kind in self.kinds.items() if n.owner == owner and kind in kinds]


def read_ssd(file: Location) -> Flat:
    """Read a .ssd file and every system inside it."""
    root = parse(file, "SystemStructureDescription")
    flat = Flat(root.get("name") or "system", file)
    if not (root.get("version") or "").startswith(("1.", "2.")):
        flat.notes.append(f"{file}: SSP version {root.get('version')} is read as version 2.0")
    experiment = child(root, "DefaultExperiment")
    if experiment is not None:
        flat.start = number(file, experiment, "startTime") if "startTime" in experiment.attrib else None
        flat.stop = number(file, experiment, "stopTime") if "stopTime" in experiment.attrib else None
    _read_root(flat, file, root, "", ())
    flat.suggestion = read_suggestion(flat.roots, flat.sources)
    flat.notes += left_out(flat.roots)
    return flat


def _read_root(flat: Flat, file: Location, root: Element, path: str, around: tuple[Location, ...]) -> None:
    """A file as the system `path`; `around` it are those that include it, one in the other."""
    flat.roots.append((file, root))
    flat.known_units |= units(file, root)
    system = child(root, "System")
    if system is None:
        raise Problem(f"{file}: expected a System inside {local(root)}, got none")
    _Reader(flat, file, (*around, _same(file))).system(system, path, {})


class _Reader:
    """Walks the elements of one .ssd file."""

    def __init__(self, flat: Flat, file: Location, open: tuple[Location, ...]) -> None:
        self._flat, self._file, self._open = flat, file, open

    def system(self, element: Element, path: str, dictionaries: Mapping[str, str]) -> None:
        """A system: its elements first, so that bindings come innermost first."""
        self._flat.systems.add(path)
        self._connectors(element, path)
        inner = {
            required(self._file, d, "name"): _join(path, required(self._file, d, "name"))
            for d in children(element, "SignalDictionaries", "SignalDictionary")
        }
        known = {**dictionaries, **inner}
        owners: dict[str, str] = {}
        for part in children(element, "Elements"):
            for e in part:
                if local(e):
                    name = self._name(e, path, owners)
                    owners[name] = self._element(e, path, known)
        for c in children(element, "Connections", "Connection"):
            self._connection(c, path, owners)
        self._bindings(element, path)

    def _name(self, element: Element, path: str, owners: Mapping[str, str]) -> str:
        """The name of an element; no other has the same, as connections and start values find it by that."""
        name = required(self._file, element, "name")
        full = _join(path, name)
        if not name:
            raise self._problem(element, "expected a name, got an empty one")
        if name in owners or full in self._flat.sources or full in self._flat.systems:
            raise self._problem(element, f"expected a name of its own, {full} is there already")
        return name

    def _problem(self, element: Element, text: str) -> Problem:
        return Problem(f"{self._file}: line {element.sourceline}: {local(element)}: {text}")

    def _element(self, element: Element, path: str, dictionaries: Mapping[str, str]) -> str:
        """One element of a system; returns the owner of its connectors."""
        kind, name = local(element), required(self._file, element, "name")
        full = _join(path, name)
        if kind == "System":
            self.system(element, full, dictionaries)
        elif kind == "Component":
            self._component(element, full)
        elif kind == "SignalDictionaryReference":
            dictionary = element.get("dictionary")
            if dictionary not in dictionaries:
                raise Problem(f"{self._file}: {full}: no signal dictionary named {dictionary!r}")
            return f"{dictionaries[dictionary]}()"  # no component has such a name
        else:
            raise self._problem(element, f"{full}: expected Component, System or SignalDictionaryReference")
        return full

    def _component(self, element: Element, full: str) -> None:
        kind = element.get("type") or FMU
        source = self._file.beside(required(self._file, element, "source"))
        implementation = element.get("implementation") or "any"
        if implementation not in ("any", "CoSimulation"):
            raise Problem(f"{self._file}: component {full}: expected CoSimulation, got {implementation}")
        if kind == FMU:
            self._flat.sources[full] = source
        elif kind in (SSD, SSP):
            self._inner(element, full, source if kind == SSD else source.member("SystemStructure.ssd"))
        else:
            raise Problem(f"{self._file}: component {full}: expected an FMU, got type {kind}")
        self._connectors(element, full)
        self._bindings(element, full)

    def _inner(self, element: Element, full: str, file: Location) -> None:
        """The system of another file, as a component."""
        root = parse(file, "SystemStructureDescription")
        if _same(file) in self._open:
            raise self._problem(element, f"{full}: expected another file, {file} includes itself")
        _read_root(self._flat, file, root, full, self._open)

    def _connectors(self, element: Element, owner: str) -> None:
        seen = set[Node]()
        for connector in children(element, "Connectors", "Connector"):
            node = Node(owner, required(self._file, connector, "name"))
            if node in seen:
                raise self._problem(connector, f"expected a name of its own, {node} is there already")
            seen.add(node)
            self._flat.kinds[node] = connector.get("kind")
            if child(connector, "Dimension") is not None:
                self._flat.arrays.add(node)
            for name in (e.get("unit") for e in connector if local(e) in FLOATS):
                if name:
                    self._flat.units[node] = self._flat.known_units.get(name, DeclaredUnit(name))

    def _bindings(self, element: Element, owner: str) -> None:
        for binding in children(element, "ParameterBindings", "ParameterBinding"):
            self._flat.bindings.append(Binding(owner, binding, self._file))

    def _connection(self, element: Element, path: str, owners: Mapping[str, str]) -> None:
        """One connection; its direction follows from the kinds of the connectors, not from start and end."""
        ends = [self._end(element, side, path, owners) for side in ("start", "end")]
        (start, first), (end, last) = ends
        where = f"{self._file}: connection {start} -> {end}"
        if first is not None and first == last:
            raise Problem(f"{where}: expected one source and one sink, got two connectors of kind {first}")
        if first == SINK or last == SOURCE:
            start, end = end, start
        if end in self._flat.hops:
            raise Problem(f"{where}: {end} is fed twice, also by {self._flat.hops[end].source}")
        linear, table = transformation(self._file, element)
        if table:
            linear = _as_linear(table, where)
        self._flat.hops[end] = Hop(start, linear, truth(self._file, element, "suppressUnitConversion"))

    def _end(
        self, element: Element, side: str, path: str, owners: Mapping[str, str]
    ) -> tuple[Node, str | None]:
        """One end of a connection and its role there."""
        # some tools write an empty name for a connector of the system itself
        name = element.get(f"{side}Element") or None
        connector = required(self._file, element, f"{side}Connector")
        if name is not None and name not in owners:
            raise Problem(
                f"{self._file}: connection to {name}.{connector}: no element {name!r}{suggest(name, owners)}"
            )
        node = Node(path if name is None else owners[name], connector)
        if node in self._flat.arrays or element.get(f"{side}Indices"):
            raise Problem(f"{self._file}: connection to {node}: expected a scalar, arrays are not supported")
        kind = self._flat.kinds.get(node)
        if kind is None and node.owner in self._flat.systems:
            known = [n.connector for n in self._flat.kinds if n.owner == node.owner]
            label = node.owner or self._flat.name
            raise Problem(f"{self._file}: {label} has no connector {connector!r}{suggest(connector, known)}")
        if kind not in (*SOURCES, *SINKS):
            return node, None
        return node, SOURCE if (kind in SOURCES) != (name is None) else SINK


def _same(file: Location) -> Location:
    """One name for a file, however a source spells its path."""
    return Location(file.path.resolve(), file.inside)


def _join(path: str, name: str) -> str:
    return f"{path}.{name}" if path else name


def _as_linear(table: Mapping[str, str], where: str) -> Linear:
    """A mapping of boolean or integer values on a connection, where it is a straight line."""
    words = {"true": "1", "false": "0"}
    try:
        points = sorted({(finite(words.get(a, a)), finite(words.get(b, b))) for a, b in table.items()})
    except ValueError:
        points = []
    for (x, _), (other, _) in pairwise(points):
        if x == other:
            raise Problem(f"{where}: this mapping gives two values for {x:g}, expected one")
    if len(points) == 1:
        return Linear(0.0, points[0][1])
    if len(points) >= 2:
        (x0, y0), (x1, y1) = points[0], points[1]
        line = Linear((y1 - y0) / (x1 - x0), y0 - (y1 - y0) / (x1 - x0) * x0)
        if all(line(x) == y for x, y in points):
            return line
    raise Problem(f"{where}: this mapping of values is not supported on a connection")


@dataclass(frozen=True)
class Wire:
    """The way from `nodes[0]` to the component connector `nodes[-1]`; hops[i] leads to nodes[i + 1]."""

    nodes: tuple[Node, ...]
    hops: tuple[Hop, ...]

    @property
    def source(self) -> Port:
        return Port(*self.nodes[0])

    @property
    def target(self) -> Port:
        return Port(*self.nodes[-1])

    def map(self, flat: Flat, system: System, notes: list[str]) -> Linear:
        """The map over the whole way, unit conversions included."""
        first = self.nodes[0]
        start = flat.units.get(first)
        if first.owner not in flat.sources:
            return self.map_from(flat, system, first, start, notes)
        unit = system.variable(Port(*first)).unit
        linear, note = conversion(unit, start, str(first))
        notes.extend([note] if note else [])
        return linear.then(self.map_from(flat, system, first, start or unit, notes))

    def map_from(
        self, flat: Flat, system: System, node: Node, unit: DeclaredUnit | None, notes: list[str]
    ) -> Linear:
        """The map from a connector on the way, whose value is in `unit`, to the variable at the end."""
        at = self.nodes.index(node)
        own = system.variable(self.target).unit if self.nodes[-1].owner in flat.sources else None
        where = f"{self._label(flat, system, 0)} -> {self._label(flat, system, -1)}"
        linear = IDENTITY
        for hop, after in zip(self.hops[at:], self.nodes[at + 1 :], strict=True):
            declared = flat.units.get(after) or (own if after == self.nodes[-1] else None)
            if not hop.suppressed:
                linear = linear.then(_noted(unit, declared, where, notes))
            unit = declared or unit
            linear = linear.then(hop.map)
        return linear.then(_noted(flat.units.get(self.nodes[-1]), own, where, notes))

    def _label(self, flat: Flat, system: System, which: int) -> str:
        node = self.nodes[which]
        unit = flat.units.get(node)
        if node.owner in flat.sources:
            unit = system.variable(Port(*node)).unit
        return f"{node} {unit}" if unit else str(node)


def _noted(source: DeclaredUnit | None, target: DeclaredUnit | None, where: str, notes: list[str]) -> Linear:
    linear, note = conversion(source, target, where)
    notes.extend([note] if note else [])
    return linear


def find_wires(flat: Flat, system: System) -> list[Wire]:
    """The way to every fed component connector, and to every output of the outermost system."""
    ends = [n for n in flat.hops if n.owner in flat.sources]
    ends += [n for n in flat.connectors("", "output", "calculatedParameter") if n in flat.hops]
    wires = [_follow(flat, end) for end in ends]
    for node in dict.fromkeys(n for wire in wires for n in wire.nodes):
        _check(flat, system, node)
    return wires


def _follow(flat: Flat, end: Node) -> Wire:
    nodes, hops = [end], list[Hop]()
    while nodes[0] in flat.hops:
        hops.insert(0, flat.hops[nodes[0]])
        if hops[0].source in nodes:
            raise Problem(f"connection to {end}: the connectors form a circle at {hops[0].source}")
        nodes.insert(0, hops[0].source)
    return Wire(tuple(nodes), tuple(hops))


def _check(flat: Flat, system: System, node: Node) -> None:
    """A connector of a component must be a variable of its FMU."""
    if node.owner not in flat.sources:
        return
    interface = system.components[node.owner].interface
    interface.allow(node.connector, f"connection to {node}")
    variables = interface.variables
    if node.connector not in variables:
        fmu = flat.sources[node.owner]
        close = suggest(node.connector, variables)
        raise Problem(f"connection to {node}: {fmu} has no variable {node.connector!r}{close}")
