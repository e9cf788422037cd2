"""Reads .ssd files: components, connectors, connections and parameter bindings of all nested systems.

The structure is flat. Components and systems have their path as name, such as "arm.drive"; the path of the
outermost system is empty. `SignalPaths` are the chains of connections through nested systems, and the linear
map over each of them.
"""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import NamedTuple
from urllib.parse import unquote

from orchestrator.base.errors import Problem, suggest
from orchestrator.base.files import Location
from orchestrator.base.text import first_names, grouped
from orchestrator.base.units import IDENTITY, DeclaredUnit, LinearTransformation, conversion, differences
from orchestrator.base.xml import XmlElement, local_name, read_xml
from orchestrator.fmi.description import FLOATS, TYPES, FmuVariable
from orchestrator.fmi.interface import CO_SIMULATION, MODEL_EXCHANGE
from orchestrator.ssp.common_elements import (
    MAPPINGS,
    Items,
    Transformation,
    read_enumerations,
    read_transformation,
    read_units,
)
from orchestrator.ssp.system import Port, System, check_map

DEFINITION = "SystemStructure.ssd"
SOURCES = ("output", "calculatedParameter", "local", "constant")  # kinds with a value for others
SINKS = ("input", "parameter", "structuralParameter")
FMU, SSD, PACKAGE = (
    f"application/x-{kind}" for kind in ("fmu-sharedlibrary", "ssp-definition", "ssp-package")
)
SOURCE, SINK = "source", "sink"
INFORMATIVE = ("MetaData", "Signature")
OPAQUE = {"Annotation", *INFORMATIVE}  # with elements of others inside
INOUT = "inout"
NAMES = """
    SystemStructureDescription System Elements Component SignalDictionaryReference Connectors Connector
    Dimension Connections Connection ElementGeometry ConnectorGeometry ConnectionGeometry SystemGeometry
    LinearTransformation EnumerationMappingTransformation MapEntry ParameterBindings ParameterBinding
    ParameterValues ParameterMapping MappingEntry ParameterSet Parameters Parameter Value Units Unit BaseUnit
    Enumerations Enumeration Item SignalDictionaries SignalDictionary DictionaryEntry DefaultExperiment
    GraphicalElements Note Annotations"""
KNOWN = {"", *NAMES.split(), *TYPES, *MAPPINGS, *OPAQUE}
# The largest systems in use have 1000 components and 5 levels. Files that include others can have any number.
MAX_PARTS, MAX_DEPTH = 10_000, 50


class ConnectorType(NamedTuple):
    """The declaration of a connector in a file; shape: sizes of an array; items: of an enumeration."""

    kind: str | None = None
    unit: DeclaredUnit | None = None
    shape: tuple[str | None, ...] = ()
    type: str = ""
    items: Items = MappingProxyType({})


class IncomingConnection(NamedTuple):
    """The connection that feeds a connector; suppressed: its unit is not converted."""

    source: Port
    transformation: Transformation = Transformation()
    suppressed: bool = False


class ParameterBinding(NamedTuple):
    """A parameter binding of the component or system at `owner`, with the units that its file defines."""

    owner: str
    element: XmlElement
    units: Mapping[str, DeclaredUnit]


@dataclass
class FlatStructure:
    """All systems of an SSP.

    sources    path of a component -> its FMU
    kinds      path of a component -> the kind that the file asks for, or ""
    incoming   connector -> connection that feeds it
    bindings   parameter bindings, innermost first
    roots      root elements of all .ssd files, outermost first
    """

    name: str
    sources: dict[str, Location] = field(default_factory=dict)
    kinds: dict[str, str] = field(default_factory=dict)
    systems: set[str] = field(default_factory=set)
    connectors: dict[Port, ConnectorType] = field(default_factory=dict)
    incoming: dict[Port, IncomingConnection] = field(default_factory=dict)
    bindings: list[ParameterBinding] = field(default_factory=list)
    start: float | None = None
    stop: float | None = None
    roots: list[XmlElement] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    def declared(self, connector: Port) -> ConnectorType:
        """What a file declares of a connector, or of the array that an element belongs to."""
        return self.connectors.get(connector) or self.connectors.get(whole_of(connector), ConnectorType())

    def feeding(self, connector: Port) -> IncomingConnection | None:
        """The connection that feeds a connector, or an element by a connection of its whole array."""
        if (found := self.incoming.get(connector)) or not connector.variable.endswith("]"):
            return found
        whole, indices = whole_of(connector), connector.variable.rpartition("[")[2]
        found = self.incoming.get(whole)
        return found and found._replace(source=_element(found.source, indices))

    def connect(self, target: Port, incoming: IncomingConnection, where: str = "") -> None:
        """Feed a connector, which must have no other source."""
        if other := self.incoming.get(target):
            got = f"{other.source} and {incoming.source}"
            raise Problem(f"{where}{target}: expected one source, got {got}")
        self.incoming[target] = incoming

    def of_kind(self, owner: str, *kinds: str) -> list[Port]:
        """Connectors of one component or system, of some kinds."""
        return [
            c for c, declared in self.connectors.items() if c.component == owner and declared.kind in kinds
        ]


def read_structure(file: Location) -> FlatStructure:
    """Read a .ssd file and every system inside it."""
    root = read_xml(file, "SystemStructureDescription")
    flat = FlatStructure(root.get("name") or "system")
    if not (root.get("version") or "").startswith(("1.", "2.")):
        flat.notes.append(f"{file}: SSP version {root.get('version')} is read as version 2.0")
    experiment = root.child("DefaultExperiment")
    if experiment is not None:
        flat.start = experiment.number("startTime") if experiment.get("startTime") is not None else None
        flat.stop = experiment.number("stopTime") if experiment.get("stopTime") is not None else None
    _SsdReader(flat, root, (), {}).read("")
    if both := [str(c) for c, declared in flat.connectors.items() if declared.kind == INOUT]:
        flat.notes.append(f"{first_names(both)}: of kind {INOUT}, the connections tell the direction")
    return flat


class _SsdReader:
    """Reads the elements of one .ssd file into a flat structure.

    including   the chain of files that include this one
    units       units defined in this file and in the files that include it
    """

    def __init__(
        self,
        flat: FlatStructure,
        root: XmlElement,
        including: tuple[Location, ...],
        units: Mapping[str, DeclaredUnit],
    ) -> None:
        self._flat, self._root, self._including = flat, root, including
        self._units, self._enumerations = {**units, **read_units(root)}, read_enumerations(root)

    def read(self, path: str) -> None:
        """Read the system of the file, with this path."""
        self._flat.roots.append(self._root)
        informative = set[str]()
        for e in self._root.element.iter():
            if OPAQUE.isdisjoint(map(local_name, e.iterancestors())):
                element = XmlElement(self._root.file, e)
                if element.name in INFORMATIVE:
                    informative.add(element.name)
                elif element.name not in KNOWN:
                    self._flat.notes.append(str(element.problem("left out, no element of SSP")))
        for name in sorted(informative):
            self._flat.notes.append(f"{self._root.file}: {name}: left out, it does not affect a run")
        system = self._root.child("System")
        if system is None:
            raise Problem(f"{self._root.file}: expected a System inside {self._root.name}, got none")
        self._system(system, path, {})

    def _system(self, element: XmlElement, path: str, dictionaries: Mapping[str, str]) -> None:
        """Read a system: first its elements, so that inner bindings precede outer ones."""
        self._flat.systems.add(path)
        self._connectors(element, path)
        inner = [d.required("name") for d in element.children("SignalDictionaries", "SignalDictionary")]
        visible = {**dictionaries, **{name: str(Port(path, name)) for name in inner}}
        owners: dict[str, str] = {}  # name of an element -> owner of its connectors
        for part in element.children("Elements"):
            for e in part.children():
                name = self._name(e, path, owners)
                owners[name] = self._element(e, path, visible)
        for c in element.children("Connections", "Connection"):
            self._connection(c, path, owners)
        self._bindings(element, path)

    def _name(self, element: XmlElement, path: str, owners: Mapping[str, str]) -> str:
        """The name of an element, which must be unique in its system."""
        name = element.required("name")
        full = str(Port(path, name))
        if not name:
            raise element.problem("expected a name, got an empty one")
        if len(self._flat.sources) + len(self._flat.systems) > MAX_PARTS:
            raise element.problem(f"expected at most {MAX_PARTS} components and systems")
        if full.count(".") > MAX_DEPTH:
            raise element.problem(f"expected at most {MAX_DEPTH} systems inside each other")
        if name in owners or full in self._flat.sources or full in self._flat.systems:
            raise element.problem(f"expected a unique name, got {full} twice")
        return name

    def _element(self, element: XmlElement, path: str, dictionaries: Mapping[str, str]) -> str:
        """Read one element of a system; returns the owner of its connectors."""
        full = str(Port(path, element.required("name")))
        if element.name == "System":
            self._system(element, full, dictionaries)
        elif element.name == "Component":
            self._component(element, full)
        elif element.name == "SignalDictionaryReference":
            dictionary = element.get("dictionary") or ""
            if dictionary not in dictionaries:
                raise element.problem(f"{full}: no signal dictionary named {dictionary!r}")
            return f"{dictionaries[dictionary]}()"  # not a valid name of a component
        else:
            raise element.problem(f"{full}: expected Component, System or SignalDictionaryReference")
        return full

    def _component(self, element: XmlElement, full: str) -> None:
        mime_type = element.get("type") or FMU
        uri, variant = element.required("source"), ""
        if mime_type == PACKAGE:  # the fragment names a variant in it
            uri, _, variant = uri.partition("#")
        source = element.file.resolve(uri)
        implementation = element.get("implementation") or "any"
        if implementation not in ("any", CO_SIMULATION, MODEL_EXCHANGE):
            expected = f"expected {CO_SIMULATION} or {MODEL_EXCHANGE}, got {implementation}"
            raise Problem(f"{element.location}: component {full}: {expected}")
        if mime_type == FMU:
            self._flat.sources[full] = source
            self._flat.kinds[full] = implementation.removeprefix("any")
        elif mime_type in (SSD, PACKAGE):
            file = source if mime_type == SSD else source.member(unquote(variant) or DEFINITION)
            self._inner_file(element, full, file)
        else:
            raise Problem(f"{element.location}: component {full}: expected an FMU, got type {mime_type}")
        self._connectors(element, full)
        self._bindings(element, full)

    def _inner_file(self, element: XmlElement, full: str, file: Location) -> None:
        """Read the system of another file as a component."""
        root = read_xml(file, "SystemStructureDescription")
        including = (*self._including, _resolved(element.file))
        if _resolved(file) in including:
            raise element.problem(f"{full}: expected another file, {file} includes itself")
        _SsdReader(self._flat, root, including, self._units).read(full)

    def _connectors(self, element: XmlElement, owner: str) -> None:
        connectors = set[Port]()
        for e in element.children("Connectors", "Connector"):
            connector = Port(owner, e.required("name"))
            if connector in connectors:
                raise e.problem(f"expected a unique name, got {connector} twice")
            connectors.add(connector)
            typed = next((t for t in e.children() if t.name in TYPES), None)
            kind, name = (typed.name, typed.get("unit")) if typed else ("", None)
            unit = self._units.get(name, DeclaredUnit(name)) if name and kind in FLOATS else None
            items = self._enumerations.get(typed.get("name") or "", {}) if typed else {}
            shape = tuple(d.get("size") for d in e.children("Dimension"))
            if inner := self._flat.connectors.get(connector):  # the file of the component declares it too
                unit, shape, items = unit or inner.unit, shape or inner.shape, items or inner.items
                kind = kind or inner.type
            self._flat.connectors[connector] = ConnectorType(e.get("kind"), unit, shape, kind, items)

    def _bindings(self, element: XmlElement, owner: str) -> None:
        for e in element.children("ParameterBindings", "ParameterBinding"):
            self._flat.bindings.append(ParameterBinding(owner, e, self._units))

    def _connection(self, element: XmlElement, path: str, owners: Mapping[str, str]) -> None:
        """Read one connection; the kinds of its connectors, not start and end, determine its direction.

        Both may be inputs if the first one is a clock that ticks by time.
        """
        ends = [self._end(element, side, path, owners) for side in ("start", "end")]
        (start, start_role), (end, end_role) = ends
        context = f"{element.file}: connection {start} -> {end}"
        clocks = {self._flat.declared(c).type or "Clock" for c in (start, end)} == {"Clock"}
        if start_role == end_role and start_role and not (clocks and end_role == SINK):
            raise Problem(f"{context}: expected one source and one sink, got two {start_role}s")
        if start_role != end_role and (start_role == SINK or end_role == SOURCE):
            start, end = end, start
        suppressed = element.boolean("suppressUnitConversion")
        incoming = IncomingConnection(start, read_transformation(element), suppressed)
        self._flat.connect(end, incoming, f"{context}: ")

    def _end(
        self, element: XmlElement, side: str, path: str, owners: Mapping[str, str]
    ) -> tuple[Port, str | None]:
        """One end of a connection: its connector, and SOURCE, SINK or None (not declared in the file)."""
        # some tools write an empty name for a connector of the system itself
        name, connector = element.get(f"{side}Element") or None, element.required(f"{side}Connector")
        context = f"{element.file}: connection to"
        if name is not None and name not in owners:
            raise Problem(f"{context} {name}.{connector}: no element {name!r}{suggest(name, owners)}")
        end = Port(path if name is None else owners[name], connector)
        if indices := element.get(f"{side}Indices"):
            end = _element(end, f"{','.join(indices.replace(',', ' ').split())}]")
        declared = self._flat.declared(end)
        if declared.kind is None and end.component in self._flat.systems:
            names = [c.variable for c in self._flat.connectors if c.component == end.component]
            got = f"{end.component or self._flat.name} has no connector {connector!r}"
            raise Problem(f"{element.file}: {got}{suggest(connector, names)}")
        if declared.kind not in (*SOURCES, *SINKS):
            return end, None
        return end, SOURCE if (declared.kind in SOURCES) != (name is None) else SINK


def _element(array: Port, indices: str) -> Port:
    """An element of an array; indices: with the closing bracket."""
    return Port(array.component, f"{array.variable}[{indices}")


def whole_of(element: Port) -> Port:
    """The array of an element."""
    return Port(element.component, element.variable.rpartition("[")[0])


def _resolved(file: Location) -> Location:
    """The absolute location of a file, so that different paths to it compare equal."""
    return Location(file.path.resolve(), file.members)


# ---- signal paths


@dataclass(frozen=True)
class SignalPath:
    """A chain of connections; connections[i] leads from connectors[i] to connectors[i + 1]."""

    connectors: tuple[Port, ...]
    connections: tuple[IncomingConnection, ...]

    @property
    def source(self) -> Port:
        return self.connectors[0]

    @property
    def target(self) -> Port:
        return self.connectors[-1]


@dataclass(frozen=True)
class SignalPaths:
    """All paths to connectors of components and to outputs of the outermost system.

    notes   remarks on unit conversions, which are appended here
    sizes   only paths to structural parameters: the sizes of arrays are not known yet
    """

    flat: FlatStructure
    system: System
    notes: list[str]
    paths: tuple[SignalPath, ...]
    sizes: bool = False

    def map(self, path: SignalPath) -> LinearTransformation:
        """The map over the whole path, with unit conversions; raises Problem if its end cannot take it."""
        unit = self.unit(path, path.source)
        first = conversion(self._own_unit(path.source), unit, str(path.source), self.notes)
        linear = first.then(self.map_from(path, path.source, unit))
        if variable := self._variable(path.target) or self._variable(path.source):
            check_map(self._context(path), variable, linear)
        return linear

    def map_from(self, path: SignalPath, connector: Port, unit: DeclaredUnit | None) -> LinearTransformation:
        """The map from a connector of the path, whose value is in `unit`, to the variable at the end."""
        start, context = path.connectors.index(connector), self._context(path)
        linear, items = IDENTITY, self.items(connector)
        for connection, end in zip(path.connections[start:], path.connectors[start + 1 :], strict=True):
            declared, before, items = self.unit(path, end), items, self.items(end) or items
            if not connection.suppressed:
                linear = linear.then(conversion(unit, declared, context, self.notes))
            unit = declared or unit
            linear = linear.then(connection.transformation.between(before, items, context))
        ends = self.unit(path, path.target), self._own_unit(path.target)
        return linear.then(conversion(*ends, context, self.notes))

    def unit(self, path: SignalPath, connector: Port) -> DeclaredUnit | None:
        """The unit of values at a connector of a path: that of its file, else that of its variable."""
        unit, own = self.flat.declared(connector).unit, self._own_unit(connector)
        if unit is None or (own and unit.exponents is None and unit.name == own.name):
            unit = own
        ends = map(self._own_unit, (path.source, path.target))
        relative = differences(self._context(path), *ends)
        return replace(unit, relative=relative) if unit else None

    def items(self, connector: Port) -> Items:
        """The items of the enumeration at a connector."""
        variable = self._variable(connector)
        return variable.items if variable else self.flat.declared(connector).items

    def _variable(self, connector: Port) -> FmuVariable | None:
        """The variable of a connector of a component."""
        return self.system.variable(connector) if connector.component in self.flat.sources else None

    def _own_unit(self, connector: Port) -> DeclaredUnit | None:
        """The unit of the variable of a connector of a component."""
        variable = self._variable(connector)
        return variable.unit if variable else None

    def _context(self, path: SignalPath) -> str:
        units = [(c, self._own_unit(c) or self.flat.declared(c).unit) for c in (path.source, path.target)]
        return " -> ".join(f"{connector} {unit}" if unit else str(connector) for connector, unit in units)


def signal_paths(flat: FlatStructure, system: System, notes: list[str], sizes: bool = False) -> SignalPaths:
    """The paths of a flat structure; connectors of components must be variables of their FMUs.

    There is a path to each element of an array. sizes: see `SignalPaths`
    """
    ends = [c for c in flat.incoming if c.component in flat.sources]
    if sizes:
        ends = [*system.sizes({str(c): c for c in ends})[0].values()]
    else:
        fed = grouped(flat.incoming, lambda c: c if c in flat.connectors else whole_of(c))
        ends += [e for c in flat.of_kind("", *SOURCES) for e in fed.get(c, ())]
        ends = [e for end in ends for e in _elements(flat, system, end)]
    for end, count in Counter(ends).most_common(1):
        if count > 1:
            raise Problem(f"connection to {end}: expected one source, got {count}")
    paths = tuple(_path_to(flat, end) for end in ends)
    for connector in dict.fromkeys(c for path in paths for c in path.connectors):
        if connector.component in flat.sources:
            _check_variable(flat, system, connector)
    return SignalPaths(flat, system, notes, paths, sizes)


def _elements(flat: FlatStructure, system: System, end: Port) -> list[Port]:
    """The elements of an array at the end of connections, whose other end and connectors have its shape."""
    path = _path_to(flat, end).connectors
    declared = {str(c): flat.declared(c).shape for c in path if not c.variable.endswith("]")}
    array = system.array(str(path[0])) or system.array(str(end))
    if not array:
        return [end]
    shape, elements = array
    if end.component in flat.sources and path[0].component in flat.sources:
        system.pairs(str(path[0]), str(end))  # raises if they differ
    for connector, sizes in declared.items():
        fit = all(a in (None, str(b)) for a, b in zip(sizes, shape, strict=False))
        if sizes and (len(sizes) != len(shape) or not fit):
            got = f"({', '.join(a or '?' for a in sizes)}) and ({', '.join(map(str, shape))})"
            raise Problem(f"{connector}: expected a Dimension for each size of the array, got {got}")
    return [_element(end, e.variable.rpartition("[")[2]) for e in elements]


def _path_to(flat: FlatStructure, end: Port) -> SignalPath:
    connectors, connections = [end], list[IncomingConnection]()
    while incoming := flat.feeding(connectors[0]):
        if incoming.source in connectors:
            raise Problem(f"connection to {end}: the connectors form a cycle at {incoming.source}")
        connections.insert(0, incoming)
        connectors.insert(0, incoming.source)
    return SignalPath(tuple(connectors), tuple(connections))


def _check_variable(flat: FlatStructure, system: System, connector: Port) -> None:
    interface = system.components[connector.component].interface
    interface.check_supported(connector.variable, f"connection to {connector}")
    if connector.variable not in interface.variables:
        fmu, suggestion = flat.sources[connector.component], suggest(connector.variable, interface.variables)
        raise Problem(f"connection to {connector}: {fmu} has no variable {connector.variable!r}{suggestion}")
