"""Content of an FMU with C code, except its binaries; and the files that FMUs in Python have as well."""

import uuid
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from fmus import parameters
from fmus.contract import Subsystem
from fmus.export.c_code import main_source, printed_equations, sources
from fmus.export.documentation import page
from fmus.export.interface import Interface, interface_of
from fmus.export.ls_ref import ls_ref_files
from fmus.export.model_description import build_description, model_description, terminals, unknowns
from fmus.package_files import project_file
from fmus.parameters import Values

PLACEHOLDER = "{00000000-0000-0000-0000-000000000000}"  # replaced by the GUID
VERSIONS = (2, 3)  # supported versions of FMI
_NAMESPACE = uuid.uuid5(uuid.NAMESPACE_URL, "harvester-cosim")


@dataclass(frozen=True)
class Package:
    """An FMU without binaries.

    files      path in the archive -> content
    compiled   names of the source files to compile
    """

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


def packages(
    sub: Subsystem, step: float, stop: float, values: Values | None = None, versions: Sequence[int] = VERSIONS
) -> dict[int, Package]:
    """The files of an FMU by version, 2 and 3; step and stop are the default experiment [s]."""
    interface = interface_of(sub, values or parameters.values(sub, derive=False))
    compiled = [main_source(sub.name)]
    printed, structure = printed_equations(interface), unknowns(interface)
    drafts: dict[int, dict[str, str]] = {}  # both versions have one GUID, which depends on these files
    for version in VERSIONS:
        code = sources(interface, PLACEHOLDER, version, printed)
        description = model_description(
            interface, version, PLACEHOLDER, step, stop, compiled, structure=structure
        )
        drafts[version] = {f"sources/{name}": text for name, text in code.items()}
        drafts[version]["modelDescription.xml"] = description.decode()
    guid = guid_of(drafts.values())
    result = {}
    for fmi in versions:
        content = {path: text.replace(PLACEHOLDER, guid).encode() for path, text in drafts[fmi].items()}
        if fmi == 3:
            content["sources/buildDescription.xml"] = build_description(sub.name, compiled)
        content["terminalsAndIcons/terminalsAndIcons.xml"] = terminals(sub, interface)  # FMI 2: since 2.0.4
        content |= common_files(sub, interface, fmi, step, stop)
        result[fmi] = Package(sub.name, fmi, content, compiled)
    return result


def guid_of(drafts: Iterable[Mapping[str, str]]) -> str:
    """The GUID of an FMU with these files, by path; different content gives a different GUID."""
    text = "\n".join(files[path] for files in drafts for path in sorted(files))
    return f"{{{uuid.uuid5(_NAMESPACE, text)}}}"


def common_files(
    sub: Subsystem, interface: Interface, fmi: int, step: float, stop: float
) -> dict[str, bytes]:
    """Documentation, icon, licences, parameter values with sources, view.toml, reference experiment."""
    icon_file, view = sub.folder / "icon.png", sub.folder / "view.toml"
    icon = icon_file.read_bytes() if icon_file.is_file() else None
    content = {"documentation/index.html": page(sub, interface, fmi, step, stop, icon).encode()}
    if icon is not None:
        content["terminalsAndIcons/icon.png"] = icon
        if fmi == 2:
            content["model.png"] = icon
    for name, file in (("license.txt", "LICENSE"), ("notices.md", "NOTICES.md")):
        if (path := project_file(file)) is not None:
            content[f"documentation/licenses/{name}"] = path.read_bytes()
    if view.is_file():
        content["resources/view.toml"] = view.read_bytes()
    if sub.numbers is not None or sub.values is None or sub.values.is_file():
        content["resources/parameters.toml"] = parameters.document(parameters.numbers(sub)).encode()
    return content | ls_ref_files(sub)
