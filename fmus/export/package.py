"""The content of an FMU but its binaries, and the zip file."""

from __future__ import annotations

import os
import uuid
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from fmus.contract import Subsystem
from fmus.export.codegen import sources
from fmus.export.documentation import page
from fmus.export.interface import Interface, interface
from fmus.export.model_description import model_description
from fmus.export.model_description3 import build_description, model_description3
from fmus.export.terminals import terminals
from fmus.parameters import Values, document, values

_PLACEHOLDER = "{00000000-0000-0000-0000-000000000000}"
_COMPILED = ("all.c",)
_NAMESPACE = uuid.uuid5(uuid.NAMESPACE_URL, "harvester-cosim")


@dataclass(frozen=True)
class Package:
    """An FMU without binaries: its files by path in the archive, and which of the sources to compile."""

    name: str
    fmi: int
    files: Mapping[str, bytes]
    compiled: Sequence[str]

    @property
    def code(self) -> dict[str, bytes]:
        """The files under sources/ by name."""
        return {
            p.removeprefix("sources/"): data for p, data in self.files.items() if p.startswith("sources/")
        }


def package(sub: Subsystem, fmi: int, step: float, stop: float, numbers: Values | None = None) -> Package:
    """The files of an FMU of version 2 or 3; step and stop are the default experiment [s]."""
    face = interface(sub, numbers or values(sub))
    code = sources(face, _PLACEHOLDER, fmi)
    if fmi == 2:
        draft = model_description(face, _PLACEHOLDER, _COMPILED, step, stop).decode()
    else:
        draft = model_description3(face, _PLACEHOLDER, step, stop).decode()
    token = _fingerprint(draft, code)
    content = {f"sources/{name}": text.replace(_PLACEHOLDER, token).encode() for name, text in code.items()}
    content["modelDescription.xml"] = draft.replace(_PLACEHOLDER, token).encode()
    if fmi == 3:
        content["sources/buildDescription.xml"] = build_description(sub.name, _COMPILED)
        content["terminalsAndIcons/terminalsAndIcons.xml"] = terminals(sub, face)
    return Package(sub.name, fmi, content | _shown(sub, face), _COMPILED)


def _fingerprint(draft: str, code: Mapping[str, str]) -> str:
    """The GUID: another one for another description or other code."""
    text = "\n".join([draft, *(code[name] for name in sorted(code))])
    return f"{{{uuid.uuid5(_NAMESPACE, text)}}}"


def _shown(sub: Subsystem, face: Interface) -> dict[str, bytes]:
    """What a person reads: documentation, icon, numbers with their sources."""
    content = {"documentation/index.html": page(sub, face).encode()}
    if sub.numbers is not None:
        content["resources/parameters.toml"] = document(sub.numbers).encode()
    elif sub.values.is_file():  # provenance of the numbers
        content["resources/parameters.toml"] = sub.values.read_bytes()
    icon = sub.values.parent / "icon.png"
    if icon.is_file():
        content["model.png"] = icon.read_bytes()
    return content


def pack(path: Path, content: Mapping[str, bytes]) -> None:
    """A zip file with fixed times and order; there is the whole file or the one that was there before."""
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        with zipfile.ZipFile(part, "w", zipfile.ZIP_DEFLATED) as archive:
            for name in sorted(content):
                entry = zipfile.ZipInfo(name, date_time=(1980, 1, 1, 0, 0, 0))
                entry.compress_type = zipfile.ZIP_DEFLATED
                entry.create_system = 3
                entry.external_attr = 0o644 << 16
                archive.writestr(entry, content[name])
        part.replace(path)
    finally:
        part.unlink(missing_ok=True)
