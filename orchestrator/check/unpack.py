"""Unpack an archive that may be anything; what is wrong with it becomes findings."""

from __future__ import annotations

import shutil
import zipfile
import zlib
from collections.abc import Iterator
from pathlib import Path, PurePosixPath

from orchestrator.check.finding import Finding

DESCRIPTION = "modelDescription.xml"
MOST_BYTES = 2 << 30  # a description of half a million variables and five binaries stay far below
MOST_MEMBERS = 50_000
METHODS = {zipfile.ZIP_STORED: "store", zipfile.ZIP_DEFLATED: "deflate"}
LINK = 0o120000


def unpack(path: Path, folder: Path) -> tuple[tuple[str, ...], tuple[Finding, ...]]:
    """Names of all members, and what is wrong; members that are safe to write are in `folder` afterwards."""
    try:
        with zipfile.ZipFile(path) as archive:
            members = archive.infolist()
            faults = [*_faults(members), *_written(archive, folder)]
    except (zipfile.BadZipFile, OSError, ValueError, NotImplementedError) as problem:
        return (), (
            _error("archive.zip", f"{path.name}: expected a zip archive, got {_kind(path)}: {problem}"),
        )
    return tuple(m.orig_filename for m in members), tuple(faults)


def _kind(path: Path) -> str:
    """What the file seems to be."""
    with path.open("rb") as file:
        head = file.read(64)
    if not head:
        return "an empty file"
    if head.startswith(b"version https://git-lfs"):
        return "a Git LFS pointer, fetch the file itself"
    known = {b"PK": "a damaged archive", b"<": "XML", b"7z": "a 7z archive", b"\x1f\x8b": "a gzip file"}
    return next((what for start, what in known.items() if head.startswith(start)), "something else")


def _error(rule: str, text: str) -> Finding:
    return Finding(rule, "error", text)


def _faults(members: list[zipfile.ZipInfo]) -> Iterator[Finding]:
    """What the directory of the archive shows."""
    for member in members:
        name = member.orig_filename
        why = unsafe(name)
        if why:
            yield _error(
                "archive.name", f"member {name!r} {why}; expected a relative path with forward slashes"
            )
        if member.external_attr >> 16 & 0o170000 == LINK:
            yield _error("archive.link", f"member {name!r} is a symbolic link, expected a file")
        if member.compress_type not in METHODS:
            method = zipfile.compressor_names.get(member.compress_type, str(member.compress_type))  # type: ignore[attr-defined]
            yield _error(
                "archive.method", f"member {name!r} is compressed with {method}, expected deflate or store"
            )
        elif member.compress_type == zipfile.ZIP_STORED and member.flag_bits & 8 and member.file_size:
            yield _error("archive.method", f"member {name!r} is stored with a data descriptor, expected none")
        if member.flag_bits & 1:
            yield _error("archive.method", f"member {name!r} is encrypted, expected no encryption")
    yield from _same(members)


def _same(members: list[zipfile.ZipInfo]) -> Iterator[Finding]:
    """Members that overwrite each other, on some machines at least."""
    seen: dict[str, str] = {}
    for name in (m.filename for m in members):
        other = seen.setdefault(name.casefold(), name)
        if other is name:
            continue
        what = "is there twice" if other == name else f"differs from {other!r} only by case"
        yield _error("archive.twice", f"member {name!r} {what}")


def unsafe(name: str) -> str:
    """Why a member must not be written under its name; empty when it may be."""
    if "\\" in name:
        return "has a backslash"
    if name.startswith("/") or name[1:2] == ":":
        return "has an absolute path"
    if ".." in PurePosixPath(name).parts:
        return "leads out of the archive"
    return "has a control character" if any(ord(c) < 32 for c in name) else ""


def _written(archive: zipfile.ZipFile, folder: Path) -> Iterator[Finding]:
    """Write all members that may be written."""
    total = 0
    for count, member in enumerate(archive.infolist()):
        total += member.file_size
        if total > MOST_BYTES or count >= MOST_MEMBERS:
            yield _error(
                "archive.size",
                f"more than {MOST_BYTES >> 20} MB or {MOST_MEMBERS} members; the rest is not checked",
            )
            return
        if unsafe(member.orig_filename) or member.is_dir():
            continue
        try:
            _write(archive, member, folder / member.filename)
        except (
            zipfile.BadZipFile,
            zlib.error,
            OSError,
            RuntimeError,
            NotImplementedError,
            EOFError,
        ) as problem:
            yield _error("archive.zip", f"member {member.filename!r} cannot be unpacked: {problem}")


def _write(archive: zipfile.ZipFile, member: zipfile.ZipInfo, target: Path) -> None:
    target.parent.mkdir(parents=True, exist_ok=True)
    with archive.open(member) as source, target.open("wb") as file:
        shutil.copyfileobj(source, file)
