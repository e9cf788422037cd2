"""Signal paths: chains of connections through nested systems, and the linear map over each of them."""

from __future__ import annotations

from dataclasses import dataclass

from orchestrator.base.errors import Problem, suggest
from orchestrator.base.units import IDENTITY, DeclaredUnit, LinearTransformation, conversion
from orchestrator.ssp.system import Port, System
from orchestrator.ssp.system_structure import Connector, FlatStructure, IncomingConnection


@dataclass(frozen=True)
class SignalPath:
    """A chain of connections; connections[i] leads from connectors[i] to connectors[i + 1]."""

    connectors: tuple[Connector, ...]
    connections: tuple[IncomingConnection, ...]

    @property
    def source(self) -> Connector:
        return self.connectors[0]

    @property
    def target(self) -> Connector:
        return self.connectors[-1]


@dataclass(frozen=True)
class SignalPaths:
    """All paths to connectors of components and to outputs of the outermost system.

    notes   remarks on unit conversions, which are appended here
    """

    flat: FlatStructure
    system: System
    notes: list[str]
    paths: tuple[SignalPath, ...]

    def map(self, path: SignalPath) -> LinearTransformation:
        """The map over the whole path, with unit conversions."""
        declared = self.flat.unit(path.source)
        if path.source.owner not in self.flat.sources:
            return self.map_from(path, path.source, declared)
        unit = self.system.variable(Port(*path.source)).unit
        first = self._conversion(unit, declared, str(path.source))
        return first.then(self.map_from(path, path.source, declared or unit))

    def map_from(
        self, path: SignalPath, connector: Connector, unit: DeclaredUnit | None
    ) -> LinearTransformation:
        """The map from a connector of the path, whose value is in `unit`, to the variable at the end."""
        start, last = path.connectors.index(connector), path.target
        target_unit = self.system.variable(Port(*last)).unit if last.owner in self.flat.sources else None
        context = f"{self._label(path.source)} -> {self._label(last)}"
        linear = IDENTITY
        for connection, end in zip(path.connections[start:], path.connectors[start + 1 :], strict=True):
            declared = self.flat.unit(end) or (target_unit if end == last else None)
            if not connection.suppressed:
                linear = linear.then(self._conversion(unit, declared, context))
            unit = declared or unit
            linear = linear.then(connection.transformation)
        return linear.then(self._conversion(self.flat.unit(last), target_unit, context))

    def _conversion(
        self, source: DeclaredUnit | None, target: DeclaredUnit | None, context: str
    ) -> LinearTransformation:
        linear, note = conversion(source, target, context)
        self.notes.extend([note] if note else [])
        return linear

    def _label(self, connector: Connector) -> str:
        """A connector with its unit."""
        of_component = connector.owner in self.flat.sources
        unit = self.system.variable(Port(*connector)).unit if of_component else self.flat.unit(connector)
        return f"{connector} {unit}" if unit else str(connector)


def signal_paths(flat: FlatStructure, system: System, notes: list[str]) -> SignalPaths:
    """The paths of a flat structure; connectors of components must be variables of their FMUs."""
    ends = [c for c in flat.incoming if c.owner in flat.sources]
    ends += [c for c in flat.of_kind("", "output", "calculatedParameter") if c in flat.incoming]
    paths = tuple(_path_to(flat, end) for end in ends)
    for connector in dict.fromkeys(c for path in paths for c in path.connectors):
        if connector.owner in flat.sources:
            _check_variable(flat, system, connector)
    return SignalPaths(flat, system, notes, paths)


def _path_to(flat: FlatStructure, end: Connector) -> SignalPath:
    connectors, connections = [end], list[IncomingConnection]()
    while incoming := flat.incoming.get(connectors[0]):
        if incoming.source in connectors:
            raise Problem(f"connection to {end}: the connectors form a cycle at {incoming.source}")
        connections.insert(0, incoming)
        connectors.insert(0, incoming.source)
    return SignalPath(tuple(connectors), tuple(connections))


def _check_variable(flat: FlatStructure, system: System, connector: Connector) -> None:
    interface = system.components[connector.owner].interface
    interface.check_supported(connector.name, f"connection to {connector}")
    if connector.name not in interface.variables:
        fmu, suggestion = flat.sources[connector.owner], suggest(connector.name, interface.variables)
        raise Problem(f"connection to {connector}: {fmu} has no variable {connector.name!r}{suggestion}")
