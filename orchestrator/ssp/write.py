"""Writes a system as an .ssp: SSP 1.0, or 2.0 for FMUs of FMI 3.0.

The archive holds the structure with a diagram, the FMUs, parameter sets, and a signal dictionary with every
output.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from urllib.parse import quote

from orchestrator.base.errors import Problem
from orchestrator.base.files import write_zip
from orchestrator.base.units import IDENTITY, DeclaredUnit, LinearTransformation
from orchestrator.base.xml import Element
from orchestrator.fmi.description import FmuVariable, Value
from orchestrator.ssp.annotations import VENDOR_NAMESPACES, write_suggestion
from orchestrator.ssp.common import TYPES, add, generation_tool, new_root, write_units, xml_text
from orchestrator.ssp.diagram import Box, Diagram, Point
from orchestrator.ssp.system import Component, Inlet, Port, System
from orchestrator.ssp.system_structure import DEFINITION, FMU

Values = Mapping[str, tuple[FmuVariable, Value]]  # name of a parameter -> the variable it sets, and its value
NAME, FILE = "signals", "signals.ssb"  # of the signal dictionary


def write_ssp(
    system: System,
    path: str | Path,
    sets: Mapping[str, Mapping[str, float]] | None = None,
    bound: Sequence[str] = (),
    columns: Sequence[Sequence[str]] = (),
    resources: Mapping[str, bytes] | None = None,
    version: str | None = None,
) -> Path:
    """Write a system to `path` and return that; `load` reads the same system from there.

    sets         name of a parameter set -> its values by "component.variable"
    bound        names of the sets that hold where nobody chooses others
    columns      components of the diagram, column by column from the left
    resources    name under resources/ -> content of a further file
    version      of SSP, 1.0 or 2.0; default: 2.0 for FMUs of FMI 3.0, else 1.0
    """
    if version is None:
        version = "2.0" if any(c.interface.fmi == 3 for c in system.components.values()) else "1.0"
    if version not in TYPES:
        raise Problem(f"{system.name}: SSP version {version!r}, expected one of {', '.join(TYPES)}")
    sets = sets or {}
    for name in bound:
        if name not in sets:
            raise Problem(f"{system.name}: {name} is bound, expected one of the sets {', '.join(sets)}")
    writer = _Writer(system, version)
    content = {DEFINITION: writer.structure(bound, columns), f"resources/{FILE}": writer.signal_dictionary()}
    content |= {f"resources/{n}": data for n, data in (resources or {}).items()}
    for name, c in system.components.items():
        if c.source is None:
            raise Problem(f"{system.name}: component {name} has no file to put into {path}")
        content[f"resources/{name}.fmu"] = c.source.read()
    for name, values in sets.items():
        try:
            ports = [(port, system.port(port), value) for port, value in values.items()]
        except Problem as problem:
            raise Problem(f"{system.name}: set {name}: {problem}") from None
        known = {port: (system.variable(of), value) for port, of, value in ports}
        content[f"resources/{name}.ssv"] = parameter_set(name, known, version, generation_tool())
    write_zip(Path(path), content)
    return Path(path)


def parameter_set(name: str, values: Values, version: str = "1.0", tool: str | None = None) -> bytes:
    """The content of an .ssv file; `tool` is what made it."""
    root = new_root("ssv:ParameterSet", version=version, name=name, generationTool=tool)
    _write_parameters(root, version, values)
    write_units(root, "ssv", (variable.unit for variable, _ in values.values()))
    return xml_text(root)


def _write_parameters(parent: Element, version: str, values: Values) -> None:
    parameters = add(parent, "ssv:Parameters")
    for name, (variable, value) in values.items():
        parameter = add(parameters, "ssv:Parameter", name=name)
        given = float(value) if variable.is_real else value
        add(parameter, f"ssv:{_type(variable, version)}", value=given, unit=_name(variable.unit))


def _type(variable: FmuVariable, version: str) -> str:
    """The name of a variable's type; for values of enumerations that of integers, which are their values."""
    return TYPES[version]["Integer" if variable.kind == "Enumeration" else variable.kind]


def _name(unit: DeclaredUnit | None) -> str | None:
    return unit.name if unit else None


@dataclass(frozen=True)
class _Writer:
    """Writes the files that describe a system, in a version of SSP."""

    system: System
    version: str

    def structure(self, bound: Sequence[str], columns: Sequence[Sequence[str]]) -> bytes:
        """SystemStructure.ssd."""
        s = self.system
        about = {"version": self.version, "name": s.name, "generationTool": generation_tool()}
        root = new_root("ssd:SystemStructureDescription", VENDOR_NAMESPACES, **about)
        system = add(root, "ssd:System", name=s.name)
        self._system_connectors(system)
        self._system_bindings(system, bound)
        connectors = {name: self._connectors(c) for name, c in s.components.items()}
        diagram = Diagram(connectors, [(c.source, c.target) for c in s.connections], columns)
        elements = add(system, "ssd:Elements")
        for name, c in s.components.items():
            self._component(elements, c, connectors[name], diagram.boxes[name])
        self._connections(system, diagram)
        if self.version != "1.0":  # OMSimulator 3.0 opens no SSP 1.0 with a SignalDictionary
            dictionaries = add(system, "ssd:SignalDictionaries")
            add(dictionaries, "ssd:SignalDictionary", name=NAME, source=f"resources/{FILE}")
        units = [v.unit for c in s.components.values() for v in c.interface.variables.values()]
        units += [i.unit for i in s.inputs.values()] + [o.unit for o in s.outputs.values()]
        write_units(root, "ssd", units)
        times = {"startTime": 0.0 if s.start is None else s.start, "stopTime": s.stop}
        write_suggestion(system, add(root, "ssd:DefaultExperiment", **times), s.suggestion)
        return xml_text(root)

    def signal_dictionary(self) -> bytes:
        """A file with one entry per output of a component, by its name in a trace."""
        root = new_root("ssb:SignalDictionary", version=self.version, generationTool=generation_tool())
        outputs = [(c.name, v) for c in self.system.components.values() for v in c.interface.of("output")]
        for component, v in outputs:
            entry = add(
                root, "ssb:DictionaryEntry", name=f"{component}.{v.name}", description=v.description or None
            )
            add(entry, f"ssc:{_type(v, self.version)}", unit=_name(v.unit))
        write_units(root, "ssb", (v.unit for _, v in outputs))
        return xml_text(root)

    def _connectors(self, component: Component) -> tuple[list[str], list[str]]:
        """Connected inputs (the others keep their start value) and all outputs, in the order of the FMU."""
        s = self.system
        fed = {c.target for c in s.connections} | {p for i in s.inputs.values() for p, _ in i.targets}
        read = {c.source for c in s.connections} | {o.source for o in s.outputs.values()}
        ports = [(Port(component.name, v.name), v) for v in component.interface.variables.values()]
        inputs = [v.name for port, v in ports if port in fed]
        return inputs, [v.name for port, v in ports if v.causality == "output" or port in read]

    def _system_connectors(self, system: Element) -> None:
        """Inputs of the whole system on the left side, outputs on the right one."""
        inputs, outputs = self.system.inputs.values(), self.system.outputs.values()
        holder = add(system, "ssd:Connectors") if inputs or outputs else None
        for n, i in enumerate(inputs, start=1):
            variable = self.system.variable(i.targets[0][0]) if i.targets else FmuVariable(i.name)
            self._connector(holder, i.name, "input", variable, i.unit, (0.0, n / (len(inputs) + 1)))
        for n, o in enumerate(outputs, start=1):
            variable = self.system.variable(o.source)
            self._connector(holder, o.name, "output", variable, o.unit, (1.0, n / (len(outputs) + 1)))

    def _connector(
        self,
        parent: Element,
        name: str,
        kind: str,
        variable: FmuVariable,
        unit: DeclaredUnit | None,
        place: Point,
    ) -> None:
        connector = add(parent, "ssd:Connector", name=name, kind=kind)
        add(connector, f"ssc:{_type(variable, self.version)}", unit=_name(unit))
        add(connector, "ssd:ConnectorGeometry", x=place[0], y=place[1])

    def _system_bindings(self, system: Element, bound: Sequence[str]) -> None:
        """Start values of the inputs, because some tools feed zeros without them, and the bound sets."""
        values = {name: start for name, inlet in self.system.inputs.items() if (start := self._start(inlet))}
        if not values and not bound:
            return
        holder = add(system, "ssd:ParameterBindings")
        if values:
            self._inline(holder, self.system.name, values)
        for name in bound:
            add(holder, "ssd:ParameterBinding", source=f"resources/{quote(name)}.ssv")

    def _start(self, inlet: Inlet) -> tuple[FmuVariable, Value] | None:
        """The start value of the first input that an input of the system feeds, in the unit of the latter."""
        for port, linear in inlet.targets[:1]:
            variable = replace(self.system.variable(port), unit=inlet.unit)
            value = self.system.components[port.component].value(port.variable)
            if linear == IDENTITY and value == value:  # not NaN: there is a start value
                return variable, value
            if linear.factor and value == value:
                return variable, (float(value) - linear.offset) / linear.factor
        return None

    def _inline(self, bindings: Element, name: str, values: Values) -> None:
        """A binding with its values inside."""
        holder = add(add(bindings, "ssd:ParameterBinding"), "ssd:ParameterValues")
        inside = add(holder, "ssv:ParameterSet", version=self.version, name=f"{name}_start")
        _write_parameters(inside, self.version, values)

    def _component(
        self, parent: Element, component: Component, connectors: tuple[list[str], list[str]], box: Box
    ) -> None:
        variables = component.interface.variables
        element = add(
            parent,
            "ssd:Component",
            name=component.name,
            type=FMU,
            source=f"resources/{quote(component.name)}.fmu",
            implementation="CoSimulation",
            description=component.interface.description or None,
        )
        if any(connectors):
            holder = add(element, "ssd:Connectors")
            for v in (variables[name] for names in connectors for name in names):
                self._connector(holder, v.name, v.causality, v, v.unit, box.connector(v.name))
        add(element, "ssd:ElementGeometry", **dict(zip(("x1", "y1", "x2", "y2"), box.corners, strict=True)))
        if component.start:
            values = {name: (variables[name], value) for name, value in component.start.items()}
            self._inline(add(element, "ssd:ParameterBindings"), component.name, values)

    def _connections(self, system: Element, diagram: Diagram) -> None:
        """Connections between components, then those of inputs and outputs of the whole system."""
        s = self.system
        of = {i.name: i.unit for i in s.inputs.values()} | {o.name: o.unit for o in s.outputs.values()}
        ends = [(c.source, c.target, c.map) for c in s.connections]
        ends += [(Port("", i.name), p, linear) for i in s.inputs.values() for p, linear in i.targets]
        ends += [(o.source, Port("", o.name), o.map) for o in s.outputs.values()]
        holder = add(system, "ssd:Connections") if ends else None
        for source, target, linear in ends:
            units = [s.variable(p).unit if p.component else of[p.variable] for p in (source, target)]
            self._connection(holder, source, target, linear, units, diagram.bends.get((source, target)))

    def _connection(
        self,
        parent: Element,
        source: Port,
        target: Port,
        linear: LinearTransformation,
        units: Sequence[DeclaredUnit | None],
        bends: Sequence[Point] | None,
    ) -> None:
        """One connection. `linear` holds the conversion of the unit, which is suppressed then."""
        converted = linear != IDENTITY or (units[0] != units[1] and None not in units)
        connection = add(
            parent,
            "ssd:Connection",
            startElement=source.component or None,
            startConnector=source.variable,
            endElement=target.component or None,
            endConnector=target.variable,
            suppressUnitConversion="true" if converted else None,
        )
        if linear != IDENTITY:
            add(connection, "ssc:LinearTransformation", factor=linear.factor, offset=linear.offset)
        if bends:
            xs, ys = (" ".join(f"{p[i]:.6g}" for p in bends) for i in (0, 1))
            add(connection, "ssd:ConnectionGeometry", pointsX=xs, pointsY=ys)
