"""Writes a system as an .ssp file: SSP 1.0, or 2.0 for FMUs of FMI 3.0.

The archive contains the system structure with a diagram, the FMUs, parameter sets, a signal dictionary of all
outputs, and the other resources of the SSP that the system was loaded from.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from urllib.parse import quote

from orchestrator.base.errors import Problem
from orchestrator.base.files import write_zip
from orchestrator.base.units import IDENTITY, DeclaredUnit, LinearTransformation
from orchestrator.base.xml import Element, generation_tool, xml_text
from orchestrator.fmi.description import FmuVariable, Value
from orchestrator.ssp.annotations import VENDOR_NAMESPACES, write_shared, write_suggestion
from orchestrator.ssp.common_elements import TYPES, add, new_root, write_units
from orchestrator.ssp.diagram import Box, Diagram, Point
from orchestrator.ssp.system import RESOURCES, Component, Inlet, Port, System
from orchestrator.ssp.system_structure import DEFINITION, FMU

Values = Mapping[str, tuple[FmuVariable, Value]]  # name of a parameter -> the variable it sets, and its value
DICTIONARY, DICTIONARY_FILE = "signals", "signals.ssb"
DESCRIPTION = "modelDescription.xml"
# files of components: FMUs are written anew, nested systems are flattened
NOT_COPIED = (".fmu", ".ssp", ".ssd")


def write_ssp(
    system: System,
    path: str | Path,
    sets: Mapping[str, Mapping[str, float]] | None = None,
    bound: Sequence[str] = (),
    columns: Sequence[Sequence[str]] = (),
    resources: Mapping[str, bytes] | None = None,
    version: str | None = None,
) -> Path:
    """Write a system to `path` and return `path`; `load` reads the same system from there.

    sets         name of a parameter set -> its values by "component.variable"
    bound        names of the sets that are bound to the system, so that they are its default values
    columns      components of the diagram, column by column from the left
    resources    name under resources/ -> content of a further file; resources of the SSP that the system was
                 loaded from, such as view.toml and parameter sets, are written too
    version      version of SSP, 1.0 or 2.0; default: 2.0 for FMUs of FMI 3.0, else 1.0
    """
    if version is None:
        version = "2.0" if any(c.interface.fmi == 3 for c in system.components.values()) else "1.0"
    if version not in TYPES:
        raise Problem(f"{system.name}: SSP version: expected one of {', '.join(TYPES)}, got {version!r}")
    sets = sets or {}
    for name in bound:
        if name not in sets:
            raise Problem(f"{system.name}: bound set {name}: expected one of the sets {', '.join(sets)}")
    writer = _Writer(system, version)
    files = _other_resources(system) | {DICTIONARY_FILE: writer.signal_dictionary()} | dict(resources or {})
    for name, c in system.components.items():
        if c.source is None:
            raise Problem(
                f"{system.name}: component {name}: expected an FMU file to write into {path}, got none"
            )
        files[f"{name}.fmu"] = c.source.read()
    for name, values in sets.items():
        try:
            ports = [(port, system.port(port), value) for port, value in values.items()]
        except Problem as problem:
            raise Problem(f"{system.name}: set {name}: {problem}") from None
        parameters = {port: (system.variable(of), value) for port, of, value in ports}
        files[f"{name}.ssv"] = parameter_set(name, parameters, version, generation_tool())
    content = {DEFINITION: writer.structure(bound, columns)}
    write_zip(Path(path), content | {f"{RESOURCES}/{name}": data for name, data in files.items()})
    return Path(path)


def _other_resources(system: System) -> dict[str, bytes]:
    """Resources of the system's SSP that are not files of components."""
    unpacked = [n.removesuffix(DESCRIPTION) for n in system.resources if n.endswith(f"/{DESCRIPTION}")]
    return {
        name: file.read()
        for name, file in system.resources.items()
        if not name.endswith(NOT_COPIED) and not name.startswith(tuple(unpacked))
    }


def parameter_set(name: str, values: Values, version: str = "1.0", tool: str | None = None) -> bytes:
    """The content of an .ssv file; tool: for the attribute generationTool."""
    root = new_root("ssv:ParameterSet", version=version, name=name, generationTool=tool)
    _write_parameters(root, version, values)
    write_units(root, "ssv", (variable.unit for variable, _ in values.values()))
    return xml_text(root)


def _write_parameters(parent: Element, version: str, values: Values) -> None:
    parameters = add(parent, "ssv:Parameters")
    for name, (variable, value) in values.items():
        parameter = add(parameters, "ssv:Parameter", name=name)
        typed = float(value) if variable.is_real else value
        add(parameter, f"ssv:{_type(variable, version)}", value=typed, unit=_unit_name(variable.unit))


def _type(variable: FmuVariable, version: str) -> str:
    """The name of a variable's type; enumerations have the type of integers, which are their values."""
    return TYPES[version]["Integer" if variable.kind == "Enumeration" else variable.kind]


def _unit_name(unit: DeclaredUnit | None) -> str | None:
    return unit.name if unit else None


@dataclass(frozen=True)
class _Writer:
    """Writes the structure and the signal dictionary of a system, in a version of SSP."""

    system: System
    version: str

    def structure(self, bound: Sequence[str], columns: Sequence[Sequence[str]]) -> bytes:
        """The content of SystemStructure.ssd."""
        s = self.system
        attributes = {"version": self.version, "name": s.name, "generationTool": generation_tool()}
        root = new_root("ssd:SystemStructureDescription", VENDOR_NAMESPACES, **attributes)
        system = add(root, "ssd:System", name=s.name)
        self._system_connectors(system)
        self._system_bindings(system, bound)
        connectors = {name: self._connectors(c) for name, c in s.components.items()}
        diagram = Diagram(connectors, [(c.source, c.target) for c in s.connections], columns)
        elements = add(system, "ssd:Elements")
        for name, c in s.components.items():
            self._component(elements, c, connectors[name], diagram.boxes[name])
        self._connections(system, diagram)
        if self.version != "1.0":  # OMSimulator 3.0 cannot open an SSP 1.0 with a SignalDictionary
            dictionaries = add(system, "ssd:SignalDictionaries")
            add(
                dictionaries, "ssd:SignalDictionary", name=DICTIONARY, source=f"{RESOURCES}/{DICTIONARY_FILE}"
            )
        units = [v.unit for c in s.components.values() for v in c.interface.variables.values()]
        units += [i.unit for i in s.inputs.values()] + [o.unit for o in s.outputs.values()]
        write_units(root, "ssd", units)
        times = {"startTime": 0.0 if s.start is None else s.start, "stopTime": s.stop}
        experiment = add(root, "ssd:DefaultExperiment", **times)
        write_suggestion(system, experiment, s.suggestion)
        shared = {name: [port.component for port in s.sharing(name)] for name in s.shared}
        write_shared(experiment, {name: names for name, names in shared.items() if names})
        return xml_text(root)

    def signal_dictionary(self) -> bytes:
        """The content of the signal dictionary: one entry per output, with its name in a trace."""
        root = new_root("ssb:SignalDictionary", version=self.version, generationTool=generation_tool())
        outputs = [(c.name, v) for c in self.system.components.values() for v in c.interface.of("output")]
        for component, v in outputs:
            entry = add(
                root, "ssb:DictionaryEntry", name=f"{component}.{v.name}", description=v.description or None
            )
            add(entry, f"ssc:{_type(v, self.version)}", unit=_unit_name(v.unit))
        write_units(root, "ssb", (v.unit for _, v in outputs))
        return xml_text(root)

    def _connectors(self, component: Component) -> tuple[list[str], list[str]]:
        """Names of the connected inputs and of all outputs of a component, in the order of the FMU."""
        s = self.system
        fed = {c.target for c in s.connections} | {p for i in s.inputs.values() for p, _ in i.targets}
        read = {c.source for c in s.connections} | {o.source for o in s.outputs.values()}
        ports = [(Port(component.name, v.name), v) for v in component.interface.variables.values()]
        inputs = [v.name for port, v in ports if port in fed]
        return inputs, [v.name for port, v in ports if v.causality == "output" or port in read]

    def _system_connectors(self, system: Element) -> None:
        """Connectors of the system: inputs on the left side, outputs on the right side."""
        inputs, outputs = self.system.inputs.values(), self.system.outputs.values()
        connectors = add(system, "ssd:Connectors") if inputs or outputs else None
        for n, i in enumerate(inputs, start=1):
            variable = self.system.variable(i.targets[0][0]) if i.targets else FmuVariable(i.name)
            self._connector(connectors, i.name, "input", variable, i.unit, (0.0, n / (len(inputs) + 1)))
        for n, o in enumerate(outputs, start=1):
            variable = self.system.variable(o.source)
            self._connector(connectors, o.name, "output", variable, o.unit, (1.0, n / (len(outputs) + 1)))

    def _connector(
        self,
        parent: Element,
        name: str,
        kind: str,
        variable: FmuVariable,
        unit: DeclaredUnit | None,
        position: Point,
    ) -> None:
        connector = add(parent, "ssd:Connector", name=name, kind=kind)
        add(connector, f"ssc:{_type(variable, self.version)}", unit=_unit_name(unit))
        add(connector, "ssd:ConnectorGeometry", x=position[0], y=position[1])

    def _system_bindings(self, system: Element, bound: Sequence[str]) -> None:
        """Start values of the inputs (without them some tools set zero), and the bound sets."""
        values = {name: start for name, inlet in self.system.inputs.items() if (start := self._start(inlet))}
        if not values and not bound:
            return
        bindings = add(system, "ssd:ParameterBindings")
        if values:
            self._inline(bindings, self.system.name, values)
        for name in bound:
            add(bindings, "ssd:ParameterBinding", source=f"resources/{quote(name)}.ssv")

    def _start(self, inlet: Inlet) -> tuple[FmuVariable, Value] | None:
        """The start value of an input of the system, from the first component input that it feeds."""
        for port, linear in inlet.targets[:1]:
            variable = replace(self.system.variable(port), unit=inlet.unit)
            value = self.system.components[port.component].value(port.variable)
            if linear == IDENTITY and value == value:  # not NaN: there is a start value
                return variable, value
            if linear.factor and value == value:
                return variable, (float(value) - linear.offset) / linear.factor
        return None

    def _inline(self, bindings: Element, name: str, values: Values) -> None:
        """Write a parameter binding with its values inside."""
        parent = add(add(bindings, "ssd:ParameterBinding"), "ssd:ParameterValues")
        parameters = add(parent, "ssv:ParameterSet", version=self.version, name=f"{name}_start")
        _write_parameters(parameters, self.version, values)

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
            parent = add(element, "ssd:Connectors")
            for v in (variables[name] for names in connectors for name in names):
                self._connector(parent, v.name, v.causality, v, v.unit, box.connector(v.name))
        add(element, "ssd:ElementGeometry", **dict(zip(("x1", "y1", "x2", "y2"), box.corners, strict=True)))
        if component.start:
            values = {name: (variables[name], value) for name, value in component.start.items()}
            self._inline(add(element, "ssd:ParameterBindings"), component.name, values)

    def _connections(self, system: Element, diagram: Diagram) -> None:
        """Connections between components, then those of inputs and outputs of the system."""
        s = self.system
        system_units = {i.name: i.unit for i in s.inputs.values()} | {
            o.name: o.unit for o in s.outputs.values()
        }
        ends = [(c.source, c.target, c.map) for c in s.connections]
        ends += [(Port("", i.name), p, linear) for i in s.inputs.values() for p, linear in i.targets]
        ends += [(o.source, Port("", o.name), o.map) for o in s.outputs.values()]
        parent = add(system, "ssd:Connections") if ends else None
        for source, target, linear in ends:
            units = [
                s.variable(p).unit if p.component else system_units[p.variable] for p in (source, target)
            ]
            self._connection(parent, source, target, linear, units, diagram.bends.get((source, target)))

    def _connection(
        self,
        parent: Element,
        source: Port,
        target: Port,
        linear: LinearTransformation,
        units: Sequence[DeclaredUnit | None],
        bends: Sequence[Point] | None,
    ) -> None:
        """One connection; `linear` contains the unit conversion, so that the reader must suppress its own."""
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
