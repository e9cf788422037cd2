"""The content of an FMU except its binaries."""

from __future__ import annotations

import uuid
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from fmus.contract import Subsystem
from fmus.export.c_code import main_source, sources
from fmus.export.documentation import page, shipped
from fmus.export.interface import Interface, interface_of
from fmus.export.ls_ref import ls_ref_files
from fmus.export.model_description import build_description, model_description, terminals
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
    interface = interface_of(sub, numbers or values(sub, derive=False))
    compiled = [main_source(sub.name)]
    drafts = {version: dict[str, str]() for version in VERSIONS}  # the files that the GUID depends on
    for version, draft in drafts.items():
        code = sources(interface, PLACEHOLDER, version)
        about = model_description(interface, version, PLACEHOLDER, step, stop, compiled)
        draft |= {f"sources/{name}": text for name, text in code.items()}
        draft["modelDescription.xml"] = about.decode()
    token = fingerprint_of(drafts.values())
    content = {path: text.replace(PLACEHOLDER, token).encode() for path, text in drafts[fmi].items()}
    if fmi == 3:
        content["sources/buildDescription.xml"] = build_description(sub.name, compiled)
        content["terminalsAndIcons/terminalsAndIcons.xml"] = terminals(sub, interface)
    content |= readable_files(sub, interface, fmi, step, stop)
    return Package(sub.name, fmi, content, compiled)


def fingerprint_of(drafts: Iterable[Mapping[str, str]]) -> str:
    """The GUID of all versions of an FMU: another one for another description or other code."""
    text = "\n".join(files[path] for files in drafts for path in sorted(files))
    return f"{{{uuid.uuid5(_NAMESPACE, text)}}}"


def readable_files(
    sub: Subsystem, interface: Interface, fmi: int, step: float, stop: float
) -> dict[str, bytes]:
    """Icon, documentation, licence, numbers with their sources, what the view shows, reference experiment."""
    picture, licence = sub.folder / "icon.png", shipped("LICENSE")
    icon = picture.read_bytes() if picture.is_file() else None
    content = {"documentation/index.html": page(sub, interface, fmi, step, stop, icon).encode()}
    if icon is not None:
        content["model.png" if fmi == 2 else "terminalsAndIcons/icon.png"] = icon
    if licence is not None:
        content["documentation/licenses/license.txt"] = licence.read_bytes()
    seen = sub.folder / "view.toml"
    if seen.is_file():
        content["resources/view.toml"] = seen.read_bytes()
    if sub.numbers is not None:
        content["resources/parameters.toml"] = document(sub.numbers).encode()
    elif sub.values is None or sub.values.is_file():
        content["resources/parameters.toml"] = document(numbers_of(sub)).encode()
    return content | ls_ref_files(sub)
