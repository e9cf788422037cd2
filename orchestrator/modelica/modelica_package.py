"""The package: blocks, models with flanges, connected systems, and the FMUs as resources."""

from __future__ import annotations

import hashlib
import json
import re
import tempfile
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field, replace
from importlib.resources import files
from pathlib import Path, PurePosixPath

from orchestrator.base.errors import Problem, suggest
from orchestrator.base.files import Location
from orchestrator.modelica.block import FmuBlock, fmu_block
from orchestrator.modelica.connected_system import connected_system
from orchestrator.modelica.flanges import with_flanges
from orchestrator.modelica.syntax import PLAIN, RESERVED, Scope, class_name
from orchestrator.ssp.load import load
from orchestrator.ssp.system import Component, System

TEMPLATES = files("orchestrator.modelica") / "templates"
WRITTEN = "Resources/written.json"  # SHA-256 of each file of a package


@dataclass
class Blocks:
    """The FMUs of a package: those with equal model descriptions are one block, with other names for it.

    models   by the bytes of modelDescription.xml
    names    class names by the FMU's file name
    """

    held: Collection[str]
    models: dict[bytes, FmuBlock] = field(default_factory=dict)
    names: dict[str, tuple[str, FmuBlock]] = field(default_factory=dict)
    classes: Scope = field(default_factory=Scope)
    folders: set[str] = field(default_factory=set)

    def add(self, component: Component) -> FmuBlock:
        """The block of a component."""
        assert component.source is not None  # components come from files
        stem = _stem(component.source)
        key = component.source.member("modelDescription.xml").read()
        found = self.models.get(key)
        if stem in self.names and self.names[stem][1] is not found:
            raise Problem(f"{component.source}: another FMU named {stem} is in the package already")
        name = self.names[stem][0] if stem in self.names else self.classes.add(class_name(stem))
        if found is None:
            own = replace(component, name=stem, start={})
            found = self.models[key] = fmu_block(name, self._folder(stem), own, self.held)
        self.names[stem] = name, found
        return found

    def _folder(self, stem: str) -> str:
        """A folder for the FMU, of letters that every file system and address takes."""
        folder = re.sub(r"[^A-Za-z0-9_-]", "_", stem)
        while folder.lower() in self.folders:
            folder += "_"
        self.folders.add(folder.lower())
        return folder

    @property
    def aliases(self) -> list[str]:
        """Other names of a block."""
        return [f"  block {name} = {m.name};\n" for name, m in self.names.values() if name != m.name]


def write_package(
    systems: Sequence[str | Path], out: str | Path, name: str = "Harvester", held: Collection[str] = ()
) -> Path:
    """Write the package `name` into the folder `out`; the path of its package.mo.

    systems   .ssp files, whose FMUs and connections go into it, and .fmu files; FMI 2.0 for Model Exchange
    held      inputs that are their start value where nothing is connected

    An earlier package of this name is replaced, unless there are files that were added or changed by hand.
    """
    if not re.fullmatch(PLAIN, name) or name in RESERVED:
        raise Problem(f"package name {name!r}: expected letters, digits and _, such as Harvester")
    loaded = [load(path, exchange=True) for path in systems]
    blocks = Blocks(held)
    parts = [{c.name: blocks.add(c) for c in system.components.values()} for system in loaded]
    _check_held(held, blocks)
    text = _package(name, blocks, list(zip(loaded, parts, strict=True)))
    folder = (Path(out) / name).resolve()
    _check_place(folder)
    folder.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=folder.parent, prefix=f".{name}-") as made:
        _write(Path(made) / name, name, text, blocks)
        if folder.exists():
            folder.rename(Path(made) / "old")
        (Path(made) / name).rename(folder)
    return Path(out) / name / "package.mo"


def _stem(source: Location) -> str:
    """Name of an FMU's file without .fmu."""
    name = PurePosixPath(source.members[-1]).name if source.members else source.path.name
    return name.removesuffix(".fmu")


def _check_held(held: Collection[str], blocks: Blocks) -> None:
    inputs = {v.name for m in blocks.models.values() for v in m.inputs}
    for name in held:
        if name not in inputs:
            raise Problem(f"no FMU has an input {name!r}{suggest(name, sorted(inputs))}")


def _write(folder: Path, name: str, text: str, blocks: Blocks) -> None:
    include = folder / "Resources" / "Include"
    include.mkdir(parents=True)
    # two packages in one model need functions of different names
    header = re.sub(r"\b(?=fmu_|Fmu|FMU_)", f"{name}_", _template("fmu.h"))
    (include / f"{name}.h").write_text(header, encoding="utf-8", newline="\n")
    for m in blocks.models.values():
        assert m.component.source is not None
        m.component.source.extract(folder / "Resources" / "FMUs" / m.folder)
    (folder / "package.mo").write_text(text, encoding="utf-8", newline="\n")
    (folder / WRITTEN).write_text(json.dumps(_sums(folder), indent=1), encoding="utf-8")


def _sums(folder: Path) -> dict[str, str]:
    """SHA-256 by path of all files but the list itself."""
    there = sorted(p for p in folder.rglob("*") if p.is_file() and p != folder / WRITTEN)
    return {p.relative_to(folder).as_posix(): hashlib.sha256(p.read_bytes()).hexdigest() for p in there}


def _check_place(folder: Path) -> None:
    """There is nothing, or a package that is as it was written: what else there is would be lost."""
    if not folder.exists():
        return
    try:
        written = json.loads((folder / WRITTEN).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        raise Problem(f"{folder}: expected no such folder, or a package that this command wrote") from None
    for path, found in _sums(folder).items():
        if written.get(path) != found:
            what = "was changed" if path in written else "was added"
            raise Problem(f"{folder / path} {what} by hand: move the package, or choose another name")


def _template(name: str) -> str:
    return (TEMPLATES / name).read_text(encoding="utf-8")


def _indented(text: str, depth: int = 1) -> str:
    return "".join("  " * depth + line if line.strip() else line for line in text.splitlines(keepends=True))


def _package(name: str, blocks: Blocks, systems: Sequence[tuple[System, dict[str, FmuBlock]]]) -> str:
    read = {c.source.variable for system, _ in systems for c in system.connections}
    mechanical = [found for m in blocks.models.values() if (found := with_flanges(m, read))]
    scope = Scope()
    wired = [
        connected_system(system, parts, scope.add(class_name(system.name)))
        for system, parts in systems
        if system.connections
    ]
    fmus = [*(m.text(name) for m in blocks.models.values()), *blocks.aliases]
    parts = [
        f'package {name} "FMUs for Model Exchange as blocks, written by harvester modelica"\n',
        "  extends Modelica.Icons.Package;\n\n",
        _sub("FMUs", "One block for each FMU", "Package", fmus),
        _sub("WithFlanges", "The same with mechanical flanges", "Package", mechanical) if mechanical else "",
        _sub("Systems", "Connected as in their SSP", "ExamplesPackage", wired) if wired else "",
        _indented(_template("Flanges.mo")) + "\n",
        _indented(_template("Internal.mo").replace("@PACKAGE@", name)) + "\n",
        '  annotation(uses(Modelica(version = "4.0.0")));\n',
        f"end {name};\n",
    ]
    return "".join(parts)


def _sub(name: str, text: str, icon: str, members: Sequence[str]) -> str:
    inside = "\n".join(_indented(m, 2) for m in members)
    return f'  package {name} "{text}"\n    extends Modelica.Icons.{icon};\n\n{inside}  end {name};\n\n'
