"""Files that come with the package: data, and in the wheel the built FMUs and systems.

The wheel contains the FMUs of all platforms and both versions of FMI in one archive, `built.tar.xz`. The FMUs
share most of their content, so together they are compressed to a fifth. A member of the archive is a member
of an FMU or SSP, as FILE/MEMBER. A link stands for a copy: FMUs in an SSP, and default variants.

On first use the files are restored, with the same bytes, in the user's cache.
"""

import hashlib
import lzma
import platform
import shutil
import sys
import tarfile
import tempfile
import zipfile
from collections.abc import Iterator, Sequence
from functools import cache
from io import BytesIO
from itertools import groupby
from pathlib import Path, PurePosixPath

from orchestrator.base.compiler import note_generated, private_cache, process_folder
from orchestrator.base.errors import Problem
from orchestrator.base.files import CHECKOUT, FMI3, write_whole, zip_bytes
from orchestrator.base.progress import doing
from orchestrator.base.xml import package_version

PACKAGE = Path(__file__).parent
BUILT = PACKAGE / "built.tar.xz"  # what `harvester build --platform all` makes; only in the wheel
ZIPS = (".fmu", ".ssp")
NAMED = ("data/scenarios", "data/reference", "examples/swing_peaks")  # folders of files that have names
SUBFOLDERS = {2: "", 3: FMI3}  # version of FMI -> folder of the FMUs
OF_FMI3 = f"{FMI3}/"  # prefix of the last members of the archive


def project_file(name: str) -> Path | None:
    """A file by its path in a checkout, such as data/x.csv; an installed package contains a copy."""
    return next((folder / name for folder in (PACKAGE.parent, PACKAGE) if (folder / name).is_file()), None)


def data(name: str) -> Path:
    """A file in the folder data of the project."""
    path = project_file(f"data/{name}")
    if path is None:
        raise Problem(f"data/{name} is missing, expected next to or inside the package fmus")
    return path


def files(name: str, suffixes: tuple[str, ...]) -> dict[str, Path]:
    """The files that a user may name, by their paths in a checkout; built FMUs and systems only in the wheel.

    name   that is looked for, as FMUs of FMI 3.0 are unpacked only if it has their folder
    """
    found = {
        path.relative_to(root).as_posix(): path
        for root in (PACKAGE, PACKAGE.parent)
        for folder in NAMED
        for path in sorted((root / folder).glob("*"))
    }
    if BUILT.is_file() and set(suffixes) & set(ZIPS):
        built = shipped_folder(fmi3=OF_FMI3 in name)
        inner = sorted(built.rglob("*"), key=lambda p: (len(p.parts), p))  # a plain name is the healthy part
        found |= {f"build/{p.relative_to(built).as_posix()}": p for p in inner}
    return {key: path for key, path in found.items() if path.suffix in suffixes}


def copy_shipped(folder: Path, versions: Sequence[int] = (2,)) -> list[Path]:
    """Copy the FMUs and systems that the package contains, for all platforms; the copies."""
    built, paths = shipped_folder(fmi3=3 in versions), []
    for source in sorted(p for p in built.rglob("*") if p.is_file()):
        name = source.relative_to(built).as_posix()
        if (3 if name.startswith(OF_FMI3) else 2) in versions:
            paths.append(Path(folder) / name)
            write_whole(paths[-1], source.read_bytes())
    return paths


def shipped_folder(fmi3: bool = True) -> Path:
    """The folder of the FMUs and systems that the package contains, as `harvester build` arranges them.

    fmi3   whether FMUs of FMI 3.0 are needed, too
    """
    if not BUILT.is_file():
        raise Problem(f"{BUILT}: no such file: only the wheel of harvester-cosim contains built FMUs")
    name = f"fmus-{_digest(BUILT)}{'-fmi3' if fmi3 else ''}"
    try:
        folder = private_cache()
        if folder is not None:
            return _unpacked(folder / name, fmi3)
    except OSError:  # the cache is not writable
        pass
    return _unpacked(process_folder() / name, fmi3)


@cache
def _digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()[:16]


def _unpacked(folder: Path, fmi3: bool) -> Path:
    """The folder with the files of the archive; made in one step, so that it is complete if it exists."""
    if folder.is_dir():
        return folder
    versions = "FMI 2.0 and 3.0" if fmi3 else "FMI 2.0"  # each is unpacked when a command first needs it
    with doing(f"unpacking the FMUs of {versions} in the package"):
        temporary = Path(tempfile.mkdtemp(dir=folder.parent))
        try:
            for name, content in unpack(BUILT, fmi3):
                (temporary / name).parent.mkdir(parents=True, exist_ok=True)
                (temporary / name).write_bytes(content)
                if name.endswith(".fmu"):
                    with zipfile.ZipFile(BytesIO(content)) as fmu:
                        note_generated({member: fmu.read(member) for member in fmu.namelist()})
            try:
                temporary.replace(folder)
            except OSError:  # another process has made it meanwhile
                if not folder.is_dir():
                    raise
        finally:
            shutil.rmtree(temporary, ignore_errors=True)
    return folder


def pack(folder: Path, archive: Path, preset: int = 9) -> None:
    """Write the FMUs and systems of a folder to an archive; equal files give equal bytes.

    preset   of xz, 0 (fast) to 9 (small)
    """
    files = sorted(p.relative_to(folder).as_posix() for p in folder.rglob("*") if p.suffix in ZIPS)
    # systems after the FMUs that they contain, FMI 3.0 after FMI 2.0
    files.sort(key=lambda name: (name.startswith(OF_FMI3), name.endswith(".ssp"), name.count("/"), name))
    known: dict[bytes, str] = {}
    with lzma.open(archive, "wb", preset=preset) as stream, tarfile.open(fileobj=stream, mode="w") as tar:
        for name in files:
            content = (folder / name).read_bytes()
            if not _add(tar, name, content, known):
                with zipfile.ZipFile(BytesIO(content)) as opened:
                    for member in sorted(opened.namelist()):
                        _add(tar, f"{name}/{member}", opened.read(member), known, always=True)
            known.setdefault(content, name)


def _add(
    tar: tarfile.TarFile, name: str, content: bytes, known: dict[bytes, str], always: bool = False
) -> bool:
    """Add a link to a file with the same content if there is one, else the content if `always`."""
    entry = tarfile.TarInfo(name)
    if content in known:
        entry.type, entry.linkname = tarfile.LNKTYPE, known[content]
        tar.addfile(entry)
    elif always:
        entry.size = len(content)
        tar.addfile(entry, BytesIO(content))
    return content in known or always


def unpack(archive: Path, fmi3: bool = True) -> Iterator[tuple[str, bytes]]:
    """Names and contents of the FMUs and systems in an archive."""
    made: dict[str, bytes] = {}
    with tarfile.open(archive, "r:xz") as tar:
        for name, entries in groupby(tar, lambda entry: _file_of(entry.name)):
            if name.startswith(OF_FMI3) and not fmi3:
                return
            content: dict[str, bytes] = {}
            for entry in entries:
                member = entry.name[len(name) + 1 :]
                stream = None if entry.islnk() else tar.extractfile(entry)
                content[member] = made[entry.linkname] if stream is None else stream.read()
            made[name] = content[""] if "" in content else zip_bytes(content)
            yield name, made[name]


def _file_of(name: str) -> str:
    """The FMU or system that an entry belongs to: variants/a.fmu for variants/a.fmu/model.png."""
    path = PurePosixPath(name)
    return next(str(p) for p in (*reversed(path.parents), path) if p.suffix in ZIPS)


def version_text(build: Path) -> str:
    """Versions of harvester-cosim and Python, the platform, and the FMUs that commands take.

    build   folder of FMUs that were built, which commands prefer to those in the package
    """
    if built := [folder for folder in (build, CHECKOUT) if (folder / "harvester.ssp").exists()]:
        origin = f"built, in {built[0].resolve()}"
    else:
        origin = f"those in the package, {BUILT}" if BUILT.is_file() else "none; harvester build makes them"
    return "\n".join(
        [
            f"harvester-cosim {package_version()}",
            f"Python {platform.python_version()} in {sys.prefix}",
            f"platform: {platform.machine()} {platform.platform(terse=True)}",
            f"FMUs: {origin}",
        ]
    )
