"""Writes the Modelica package: blocks, models with flanges, connected systems, and the FMUs as resources."""

import json
import re
import tempfile
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path, PurePosixPath

from orchestrator.base.errors import Problem, suggest
from orchestrator.base.files import Location
from orchestrator.base.text import rendered
from orchestrator.base.units import IDENTITY, LinearTransformation
from orchestrator.fmi.description import FmuVariable
from orchestrator.fmi.interface import MODEL_EXCHANGE
from orchestrator.modelica.block import FmuBlock, attributes, connectors, fmu_block, positions
from orchestrator.modelica.flanges import model_with_flanges
from orchestrator.modelica.syntax import PLAIN, RESERVED, Scope, class_name, literal, number, quoted
from orchestrator.ssp.load import load
from orchestrator.ssp.system import Component, Port, System

TEMPLATES = Path(__file__).with_name("templates")
CHECKSUMS = "Resources/written.json"  # SHA-256 of each file of the package


@dataclass
class PackageBlocks:
    """The blocks of a package; FMUs with the same model description share a block, which gets several names.

    constant_inputs, levers   as of `write_package`
    blocks                    by the bytes of modelDescription.xml
    names                     class name and block by the file name of the FMU
    """

    constant_inputs: Collection[str]
    levers: Collection[str]
    blocks: dict[bytes, FmuBlock] = field(default_factory=dict)
    names: dict[str, tuple[str, FmuBlock]] = field(default_factory=dict)
    classes: Scope = field(default_factory=Scope)
    folders: set[str] = field(default_factory=set)

    def add(self, component: Component) -> FmuBlock:
        """The block of a component."""
        assert component.source is not None  # components come from files
        members, path = component.source.members, component.source.path
        stem = (PurePosixPath(members[-1]) if members else path).name.removesuffix(".fmu")
        key = component.source.member("modelDescription.xml").read()
        block = self.blocks.get(key)
        if stem in self.names and self.names[stem][1] is not block:
            raise Problem(f"{component.source}: another FMU named {stem} is in the package already")
        name = self.names[stem][0] if stem in self.names else self.classes.add(class_name(stem))
        if block is None:
            fmu = replace(component, name=stem, start={})
            chosen = self.constant_inputs, self.levers
            block = self.blocks[key] = fmu_block(name, self._folder(stem), fmu, *chosen)
        self.names[stem] = name, block
        return block

    def _folder(self, stem: str) -> str:
        """A unique folder for the FMU, with characters that are allowed in all file systems and URIs."""
        folder = re.sub(r"[^A-Za-z0-9_-]", "_", stem)
        while folder.lower() in self.folders:
            folder += "_"
        self.folders.add(folder.lower())
        return folder

    @property
    def aliases(self) -> list[str]:
        """Declarations of further names of the blocks."""
        return [f"  block {name} = {b.name};\n" for name, b in self.names.values() if name != b.name]


def write_package(
    systems: Sequence[str | Path],
    out: str | Path,
    name: str = "Harvester",
    constant_inputs: Collection[str] = (),
    levers: Collection[str] = (),
) -> Path:
    """Write the package `name` into the folder `out`; returns the path of its package.mo.

    systems           .ssp files, with their FMUs and connections, and .fmu files; FMI 2.0 for Model Exchange
    constant_inputs   inputs that have their start value if they are not connected
    levers            inputs that have their start value unless a connection or a modifier gives another

    An earlier package with this name is replaced, unless files in it were added or changed by hand.
    """
    if not re.fullmatch(PLAIN, name) or name in RESERVED:
        raise Problem(f"package name {name!r}: expected letters, digits and _, such as Harvester")
    loaded = [load(path).in_kind(MODEL_EXCHANGE) for path in systems]
    blocks = PackageBlocks(constant_inputs, levers)
    parts = [{c.name: blocks.add(c) for c in system.components.values()} for system in loaded]
    inputs = {v.name for block in blocks.blocks.values() for v in block.inputs}
    for unknown in (n for n in constant_inputs if n not in inputs):
        raise Problem(f"no FMU has an input {unknown!r}{suggest(unknown, sorted(inputs))}")
    text = _package(name, blocks, list(zip(loaded, parts, strict=True)))
    folder = (Path(out) / name).resolve()
    _check_unchanged(folder)
    folder.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=folder.parent, prefix=f".{name}-") as temporary:
        _write(Path(temporary) / name, name, text, blocks)
        if folder.exists():
            folder.rename(Path(temporary) / "old")
        (Path(temporary) / name).rename(folder)
    return Path(out) / name / "package.mo"


def _write(folder: Path, name: str, text: str, blocks: PackageBlocks) -> None:
    include = folder / "Resources" / "Include"
    include.mkdir(parents=True)
    # functions need different names if a model uses two packages
    header = re.sub(r"\b(?=fmu_|Fmu|FMU_)", f"{name}_", (TEMPLATES / "fmu.h").read_text(encoding="utf-8"))
    (include / f"{name}.h").write_text(header, encoding="utf-8", newline="\n")
    for block in blocks.blocks.values():
        assert block.component.source is not None
        block.component.source.extract(folder / "Resources" / "FMUs" / block.folder)
    (folder / "package.mo").write_text(text, encoding="utf-8", newline="\n")
    (folder / CHECKSUMS).write_text(json.dumps(_checksums(folder), indent=1), encoding="utf-8")


def _checksums(folder: Path) -> dict[str, str]:
    """SHA-256 by path of all files except the list of checksums."""
    files_ = sorted(p for p in folder.rglob("*") if p.is_file() and p != folder / CHECKSUMS)
    return {p.relative_to(folder).as_posix(): Location(p).sha256 for p in files_}


def _check_unchanged(folder: Path) -> None:
    """Raise Problem if the folder exists and is not an unchanged package, because it will be replaced."""
    if not folder.exists():
        return
    try:
        checksums = json.loads(Location(folder / CHECKSUMS).text())
    except (Problem, ValueError, RecursionError):
        found = "the folder exists, but is not a package that this command wrote"
        raise Problem(f"{folder}: {found}: choose another --out or --name") from None
    for path, checksum in _checksums(folder).items():
        if checksums.get(path) != checksum:
            change = "changed" if path in checksums else "added"
            raise Problem(f"{folder / path} was {change} by hand: move the package, or choose another name")


def _package(name: str, blocks: PackageBlocks, systems: Sequence[tuple[System, dict[str, FmuBlock]]]) -> str:
    connected = {c.source.variable for system, _ in systems for c in system.connections}
    fmus, scope = list(blocks.blocks.values()), Scope()
    internal = (TEMPLATES / "Internal.mo").read_text(encoding="utf-8")
    wired = [(s, parts) for s, parts in systems if s.connections]
    return rendered(
        TEMPLATES / "package.mo.j2",
        name=name,
        blocks=fmus,
        aliases=blocks.aliases,
        models=[m for block in fmus if (m := model_with_flanges(block, connected))],
        systems=[ConnectedSystem(s, parts, scope.add(class_name(s.name))) for s, parts in wired],
        flanges=(TEMPLATES / "Flanges.mo").read_text(encoding="utf-8"),
        internal=internal.replace("@PACKAGE@", name),
        attributes=attributes,
        connectors=connectors,
        literal=literal,
        number=number,
        positions=positions,
        quoted=quoted,
    )


class ConnectedSystem:
    """The model of a system; blocks: by name of the component.

    An unconnected input becomes a variable of the model with its start value. A user may replace the value:
    extends Harvester(controller_speed = sin(time)).
    """

    def __init__(self, system: System, blocks: Mapping[str, FmuBlock], name: str) -> None:
        self.system, self.name, self._blocks, self._scope = system, name, blocks, Scope()
        self._connected = system.fed
        self._names = {component: self._scope.add(component) for component in system.components}
        self.declarations: list[str] = []
        self.equations: list[str] = []
        self._modifiers: dict[str, list[str]] = {component: [] for component in system.components}
        self._connections()
        self._unconnected_inputs()
        self.declarations[:0] = [self._component(c) for c in system.components.values()]

    def _in_block(self, port: Port) -> bool:
        """False for an input that Model Exchange does not need, the rate of another input."""
        return port.variable in self._blocks[port.component].names

    def _port_name(self, port: Port) -> str:
        """A port in the equations."""
        return f"{self._names[port.component]}.{self._blocks[port.component].names[port.variable]}"

    def _component(self, component: Component) -> str:
        """Declaration of a component with the values that differ from those of its FMU."""
        block, changed = self._blocks[component.name], self._modifiers[component.name]
        for p in block.parameters:
            if (value := component.value(p.variable.name)) != p.value:
                changed.append(f"{p.name} = {literal(value)}")
        for variable, optional in block.optional.items():
            start = float(component.value(variable))
            if Port(component.name, variable) in self._connected:
                changed.append(f"{optional.use} = true")
            elif start != optional.value:
                changed.append(f"{optional.constant} = {number(start)}")
        modified = f"({', '.join(changed)})" if changed else ""
        return f"FMUs.{block.name} {self._names[component.name]}{modified}"

    def _connections(self) -> None:
        for c in self.system.connections:
            target = self.system.variable(c.target)
            if target.causality != "input":
                raise Problem(f"{c}: {c.target}: expected an input, got a {target.causality}")
            if not self._in_block(c.target):
                continue
            if not self._in_block(c.source):
                raise Problem(f"{c}: {c.source} is not an output in Model Exchange")
            if c.map.table:
                raise Problem(f"{c}: expected a linear transformation, got a mapping of values")
            if c.map == IDENTITY:
                self.equations.append(f"connect({self._port_name(c.source)}, {self._port_name(c.target)})")
            else:
                self._equation(c.target, self._port_name(c.source), c.map)

    def _equation(self, target: Port, source: str, linear: LinearTransformation) -> None:
        mapped = f"{number(linear.factor)} * {source} + {number(linear.offset)}"
        value = source if linear == IDENTITY else mapped
        block = self._blocks[target.component]
        if target.variable in block.levers:  # an equation could not replace their start value
            self._modifiers[target.component].append(f"{block.names[target.variable]} = {value}")
        else:
            self.equations.append(f"{self._port_name(target)} = {value}")

    def _unconnected_inputs(self) -> None:
        """Variables for the inputs of the system and for unconnected inputs of components."""
        for system_input in self.system.inputs.values():
            targets = [(port, linear) for port, linear in system_input.targets if self._in_block(port)]
            if targets:
                port, linear = targets[0]
                start = (self._start(port) - linear.offset) / linear.factor
                unit = f"(unit = {quoted(system_input.unit.name)})" if system_input.unit else ""
                name = self._declare(system_input.name, unit, start, self.system.variable(port))
                for port, linear in targets:
                    self._equation(port, name, linear)
        for component, block in self._blocks.items():
            for v in block.inputs:
                port = Port(component, v.name)
                if port not in self._connected and v.name not in block.optional:
                    name = self._declare(f"{component}_{v.name}", attributes(v), self._start(port), v)
                    self._equation(port, name, IDENTITY)

    def _declare(self, name: str, unit: str, value: float, v: FmuVariable) -> str:
        """Declare a variable of the model for the input `v`; returns its identifier."""
        identifier = self._scope.add(name)
        start = f"{number(value)} {quoted(v.description)}"
        self.declarations.append(f"Real {identifier}{unit} = {start} annotation(Dialog)")
        return identifier

    def _start(self, port: Port) -> float:
        return float(self.system.components[port.component].value(port.variable))
