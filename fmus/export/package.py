"""The content of an FMU but its binaries."""

from __future__ import annotations

import uuid
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from fmus.contract import Subsystem
from fmus.export.c_code import main_source, sources
from fmus.export.documentation import page, shipped
from fmus.export.interface import Interface, interface
from fmus.export.model_description import build_description, model_description, model_description3, terminals
from fmus.export.reference_experiment import proof
from fmus.parameters import Values, document, values
from fmus.parameters import numbers as numbers_of

PLACEHOLDER = "{00000000-0000-0000-0000-000000000000}"
VERSIONS = (2, 3)  # of FMI
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
    face = interface(sub, numbers or values(sub, derive=False))
    drafts = {version: _drafts(face, version, step, stop) for version in VERSIONS}
    token = fingerprint_of(drafts.values())
    content = {path: text.replace(PLACEHOLDER, token).encode() for path, text in drafts[fmi].items()}
    if fmi == 3:
        content["sources/buildDescription.xml"] = build_description(sub.name, [main_source(sub.name)])
        content["terminalsAndIcons/terminalsAndIcons.xml"] = terminals(sub, face)
    return Package(
        sub.name, fmi, content | shown(sub, face, fmi, step, stop) | proof(sub), [main_source(sub.name)]
    )


def _drafts(face: Interface, fmi: int, step: float, stop: float) -> dict[str, str]:
    """The files that carry the GUID or instantiation token, or that it stands for, with a placeholder."""
    files = {f"sources/{name}": text for name, text in sources(face, PLACEHOLDER, fmi).items()}
    if fmi == 2:
        description = model_description(face, PLACEHOLDER, [main_source(face.name)], step, stop)
    else:
        description = model_description3(face, PLACEHOLDER, step, stop)
    return files | {"modelDescription.xml": description.decode()}


def fingerprint_of(drafts: Iterable[Mapping[str, str]]) -> str:
    """The GUID of all versions of an FMU: another one for another description or other code."""
    text = "\n".join(files[path] for files in drafts for path in sorted(files))
    return f"{{{uuid.uuid5(_NAMESPACE, text)}}}"


def shown(sub: Subsystem, face: Interface, fmi: int, step: float, stop: float) -> dict[str, bytes]:
    """What a person reads: icon, documentation, licence, numbers with their sources."""
    picture, licence = sub.folder / "icon.png", shipped("LICENSE")
    icon = picture.read_bytes() if picture.is_file() else None
    content = {"documentation/index.html": page(sub, face, fmi, step, stop, icon).encode()}
    if icon is not None:
        content["model.png" if fmi == 2 else "terminalsAndIcons/icon.png"] = icon
    if licence is not None:
        content["documentation/licenses/license.txt"] = licence.read_bytes()
    if sub.numbers is not None:
        content["resources/parameters.toml"] = document(sub.numbers).encode()
    elif sub.values is None or sub.values.is_file():
        content["resources/parameters.toml"] = document(numbers_of(sub)).encode()
    return content
