"""Builds FMUs with C code: generates the files, compiles them, writes the archives.

Equal subsystems with equal values give equal bytes.
"""

from __future__ import annotations

import os
import uuid
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path

from fmus import parameters
from fmus.contract import Subsystem
from fmus.export.c_code import main_source, printed_equations, sources
from fmus.export.compile import WASM, binaries, shared_library
from fmus.export.documentation import page
from fmus.export.interface import Interface, interface_of
from fmus.export.model_description import (
    build_description,
    ls_ref_files,
    model_description,
    terminals,
    unknowns,
)
from fmus.package_files import project_file
from fmus.parameters import Values
from orchestrator.base.compiler import host, note_generated
from orchestrator.base.files import write_zip
from orchestrator.base.options import seconds

PLACEHOLDER = "{00000000-0000-0000-0000-000000000000}"  # replaced by the GUID
VERSIONS = (2, 3)  # supported versions of FMI
SOURCES = "sources/"  # folder of the C files in an FMU
Files = dict[str, bytes]  # path in the archive -> content
Libraries = dict[str, Future[bytes]]  # by platform
_NAMESPACE = uuid.uuid5(uuid.NAMESPACE_URL, "harvester-cosim")


def packages(
    sub: Subsystem, step: float, stop: float, values: Values | None = None, versions: Sequence[int] = VERSIONS
) -> dict[int, Files]:
    """FMI version -> files of the FMU without binaries, by path; step, stop: default experiment [s]."""
    interface = interface_of(sub, values or parameters.values(sub, derive=False))
    step = min(step, sub.step)
    compiled = [main_source(sub.name)]
    printed, structure = printed_equations(interface), unknowns(interface)
    drafts: dict[int, dict[str, str]] = {}  # both versions have one GUID, which depends on these files
    for version in VERSIONS:
        code = sources(interface, PLACEHOLDER, version, printed)
        description = model_description(
            interface, version, PLACEHOLDER, step, stop, compiled, structure=structure
        )
        drafts[version] = {f"{SOURCES}{name}": text for name, text in code.items()}
        drafts[version]["modelDescription.xml"] = description.decode()
    guid = guid_of(drafts.values())
    result = {}
    for fmi in versions:
        content = {path: text.replace(PLACEHOLDER, guid).encode() for path, text in drafts[fmi].items()}
        if fmi == 3:
            content["sources/buildDescription.xml"] = build_description(sub.name, compiled)
        content["terminalsAndIcons/terminalsAndIcons.xml"] = terminals(sub, interface)  # FMI 2: since 2.0.4
        result[fmi] = content | common_files(sub, interface, fmi, step, stop)
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


def build(
    sub: Subsystem,
    out_dir: Path,
    step: float | str = 1e-3,
    stop: float | str = 10.0,
    values: Values | None = None,
    fmi: int = 2,
    platforms: Sequence[str] | None = None,
) -> Path:
    """Write `<sub.name>.fmu` to `out_dir` and return its path.

    step, stop   default experiment [s], or with a unit, such as "1 ms"
    values       parameter and start values; default: those of the subsystem's parameters.toml
    fmi          2 or 3
    platforms    names of `compile.TARGETS`; default: the platform that this program runs on
    """
    experiment = seconds(step, "step") or 0.0, seconds(stop, "stop") or 0.0
    return build_all([sub], {fmi: Path(out_dir)}, *experiment, platforms, values=values)[fmi][0]


def build_all(
    subs: Sequence[Subsystem],
    folders: Mapping[int, Path],
    step: float = 1e-3,
    stop: float = 10.0,
    platforms: Sequence[str] | None = None,
    subfolders: Mapping[str, str] | None = None,
    progress: Callable[[str], None] = lambda _: None,
    wasm: Sequence[str] = (),
    values: Values | None = None,
) -> dict[int, list[Path]]:
    """Build several FMUs of one or both FMI versions; returns version -> paths, in the order of `subs`.

    All FMUs are compiled in parallel, while code of others is generated; no file is written before all are
    compiled.

    folders      FMI version -> output folder
    subfolders   name of a subsystem -> folder inside the output folder
    progress     called with what is done now, such as "generating C code, 3 of 17: supply"
    wasm         names of subsystems whose FMU of FMI 3.0 gets a WebAssembly module in addition
    values       parameter and start values; default: those of each subsystem's parameters.toml
    """
    names, targets = tuple(platforms or (host(),)), list[tuple[Path, int, Files, Libraries]]()
    compilers = ThreadPoolExecutor(os.cpu_count())
    try:
        for number, sub in enumerate(subs, 1):
            progress(f"generating C code, {number} of {len(subs)}: {sub.name}")
            for fmi, files in packages(sub, step, stop, values, list(folders)).items():
                folder = Path(folders[fmi]) / (subfolders or {}).get(sub.name, "")
                module = (WASM,) if fmi == 3 and sub.name in wasm else ()
                code = {p.removeprefix(SOURCES): text for p, text in files.items() if p.startswith(SOURCES)}
                source = sub.name, code, [main_source(sub.name)]
                libraries = {
                    n: compilers.submit(shared_library, *source, n) for n in dict.fromkeys((*names, *module))
                }
                targets.append((folder / f"{sub.name}.fmu", fmi, files, libraries))
        compiled = [library for *_, libraries in targets for library in libraries.values()]
        for number, library in enumerate(compiled, 1):
            progress(f"compiling, {number} of {len(compiled)}")
            library.result()
    finally:
        compilers.shutdown(cancel_futures=True)
    for path, fmi, files, libraries in targets:
        by_platform = {name: library.result() for name, library in libraries.items()}
        note_generated(files)
        write_zip(path, files | binaries(path.stem, fmi, by_platform))
    paths = [path for path, *_ in targets]
    return {fmi: paths[n :: len(folders)] for n, fmi in enumerate(folders)}
