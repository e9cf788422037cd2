"""The package: blocks, models with flanges, connected systems, and the FMUs as resources."""

from __future__ import annotations

import shutil
from collections.abc import Collection, Sequence
from importlib.resources import files
from pathlib import Path

from orchestrator.errors import Problem
from orchestrator.modelica.block import Model, block, class_name, identifier, model, number
from orchestrator.modelica.flanges import with_flanges
from orchestrator.system.ssp import load
from orchestrator.system.system import System

TEMPLATES = files("orchestrator.modelica") / "templates"


def write_package(
    systems: Sequence[str | Path], out: str | Path, name: str = "Harvester", held: Collection[str] = ()
) -> Path:
    """Write the package `name` into the folder `out`; the path of its package.mo.

    systems   .ssp files, whose FMUs and connections go into it, and .fmu files
    held      inputs that are their start value where nothing is connected

    An FMU that is there several times is one block, with the values of the first; another one of the same
    name is refused.
    """
    if identifier(name) != name or not name.isidentifier():
        raise Problem(f"--name {name}: expected a name that Modelica takes, such as Harvester")
    folder = Path(out) / name
    loaded = [load(path) for path in systems]
    models: dict[str, Model] = {}
    there: set[str] = set()
    for system in loaded:
        for component in system.components.values():
            known = models.get(component.name)
            if known and known.face.guid != component.interface.guid:
                raise Problem(
                    f"{component.source}: another FMU named {component.name} is in the package already"
                )
            if known is None and (system.connections or component.interface.guid not in there):
                models[component.name] = model(class_name(component.name), component, held)
                there.add(component.interface.guid)
    text = _package(name, models, loaded)
    if folder.exists():
        _remove(folder, name)
    include = folder / "Resources" / "Include"
    include.mkdir(parents=True)
    (include / "fmu.h").write_text(_template("fmu.h"), encoding="utf-8")
    for m in models.values():
        assert m.component.source is not None
        m.component.source.extract(folder / "Resources" / "FMUs" / m.folder)
    path = folder / "package.mo"
    path.write_text(text, encoding="utf-8", newline="\n")
    return path


def _remove(folder: Path, name: str) -> None:
    """An earlier package goes; anything else stays."""
    first = folder / "package.mo"
    if not first.is_file() or not first.read_text(encoding="utf-8").startswith(_head(name)):
        raise Problem(f"{folder}: expected no such folder, or a package that this command wrote")
    shutil.rmtree(folder)


def _template(name: str) -> str:
    return (TEMPLATES / name).read_text(encoding="utf-8")


def _head(name: str) -> str:
    return f'package {name} "FMUs for Model Exchange as blocks, written by harvester modelica"\n'


def _indented(text: str, depth: int = 1) -> str:
    return "".join("  " * depth + line if line.strip() else line for line in text.splitlines(keepends=True))


def _package(name: str, models: dict[str, Model], systems: Sequence[System]) -> str:
    read = {c.source.variable for s in systems for c in s.connections}
    mechanical = [found for m in models.values() if (found := with_flanges(m, read))]
    connected = [_system(s, models) for s in systems if s.connections]
    parts = [
        _head(name),
        "  extends Modelica.Icons.Package;\n\n",
        _sub("FMUs", "One block for each FMU", "Package", [block(m, name) for m in models.values()]),
        _sub("WithFlanges", "The same with mechanical flanges", "Package", mechanical) if mechanical else "",
        _sub("Systems", "Connected as in their SSP", "ExamplesPackage", connected) if connected else "",
        _indented(_template("Flanges.mo")) + "\n",
        _indented(_template("Internal.mo").replace("@PACKAGE@", name)) + "\n",
        '  annotation(uses(Modelica(version = "4.0.0")));\n',
        f"end {name};\n",
    ]
    return "".join(parts)


def _sub(name: str, text: str, icon: str, members: Sequence[str]) -> str:
    inside = "\n".join(_indented(m, 2) for m in members)
    return f'  package {name} "{text}"\n    extends Modelica.Icons.{icon};\n\n{inside}  end {name};\n\n'


def _system(system: System, models: dict[str, Model]) -> str:
    """A model with the components and connections of a system."""
    fed = {c.target for c in system.connections}
    text = [f'model {class_name(system.name)} "{system.name}"\n  extends Modelica.Icons.Example;\n']
    for name in system.components:
        used = [f"use_{v}_in = true" for v in models[name].held if (name, v) in fed]
        modified = f"({', '.join(used)})" if used else ""
        text.append(f"  FMUs.{models[name].name} {identifier(name)}{modified};\n")
    text.append("equation\n")
    moving = {(n, v.name) for n, m in models.items() for v in m.moving}
    for c in system.connections:
        if tuple(c.target) not in moving:
            continue  # the rate of another input
        a = f"{identifier(c.source.component)}.{identifier(c.source.variable)}"
        b = f"{identifier(c.target.component)}.{identifier(c.target.variable)}"
        plain = (c.map.factor, c.map.offset) == (1.0, 0.0)
        text.append(
            f"  connect({a}, {b});\n"
            if plain
            else f"  {b} = {number(c.map.factor)} * {a} + {number(c.map.offset)};\n"
        )
    for name in system.components:
        for v in models[name].moving:
            if (name, v.name) not in fed and v.name not in models[name].held:
                start = models[name].component.value(v.name)
                text.append(f"  {identifier(name)}.{identifier(v.name)} = {number(float(start))};\n")
    stop = f"StopTime = {number(system.stop)}, " if system.stop else ""
    text.append(f"  annotation(experiment({stop}Interval = 0.02, Tolerance = 1e-8));\n")
    text.append(f"end {class_name(system.name)};\n")
    return "".join(text)
