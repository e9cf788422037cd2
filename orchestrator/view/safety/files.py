"""Which result files a browser may name: those that lie in the allowed folders, and nothing else."""

from __future__ import annotations

import os
import stat
from collections.abc import Sequence
from pathlib import Path, PurePosixPath

from orchestrator.errors import Problem

SUFFIXES = (".csv", ".parquet")
LARGEST = 2 * 10**9  # bytes; a run of an hour with all signals has about 0.5e9 as CSV
MOST = 1000  # files that are listed
# names that Windows takes for devices, with any suffix
DEVICES = {"con", "prn", "aux", "nul", *(f"{port}{n}" for port in ("com", "lpt") for n in range(1, 10))}


def listed(folders: Sequence[Path]) -> list[str]:
    """Names of the result files in the folders, as `resolved` takes them: relative, with forward slashes."""
    found = []
    for folder in folders:
        for path in sorted(folder.iterdir()) if folder.is_dir() else ():
            try:
                found.append(_checked(folder, path.name).relative_to(folder.resolve()).as_posix())
            except Problem:
                continue
    return list(dict.fromkeys(found))[:MOST]


def resolved(name: object, folders: Sequence[Path]) -> Path:
    """The file of this name in one of the folders; Problem tells in one line what is refused."""
    text = _plain(name)
    problem = Problem(f"file: no folder with results is open, asked for {_shown(text)}")
    for folder in folders:
        try:
            return _checked(folder, text)
        except Problem as error:
            problem = error
    raise problem


def _plain(name: object) -> str:
    """The name, if it is a relative path on every system: checked as text, before any file is touched."""
    if not isinstance(name, str) or not 0 < len(name) <= 255:
        raise Problem(f"file: expected a name of 1 to 255 characters, found {_shown(name)}")
    if not name.isprintable() or any(c in name for c in '\\:*?"<>|'):
        raise Problem(f"file: expected plain characters and forward slashes, found {_shown(name)}")
    path = PurePosixPath(name)
    if path.is_absolute() or ".." in path.parts:
        raise Problem(f"file: expected a path inside the folder of results, found {_shown(name)}")
    if any(part.partition(".")[0].strip().lower() in DEVICES for part in path.parts):
        raise Problem(f"file: expected a file, found the name of a device, {_shown(name)}")
    if path.suffix.lower() not in SUFFIXES:
        raise Problem(f"file: expected a name ending in {' or '.join(SUFFIXES)}, found {_shown(name)}")
    return name


def _checked(folder: Path, name: str) -> Path:
    """Links are followed first and judged by where they end."""
    root, text = folder.resolve(), _plain(name)
    try:
        path = (root / text).resolve(strict=True)
        about = os.stat(path)
    except (OSError, RuntimeError, ValueError) as error:
        raise Problem(f"file: no such result file, {_shown(text)}") from error
    if not path.is_relative_to(root):
        raise Problem(f"file: expected a file inside the folder of results, found a link out, {_shown(text)}")
    if not stat.S_ISREG(about.st_mode) or path.suffix.lower() not in SUFFIXES:
        raise Problem(f"file: expected a result file, found something else, {_shown(text)}")
    if about.st_size > LARGEST:
        raise Problem(
            f"file: expected at most {LARGEST / 1e9:g} GB, found {about.st_size / 1e9:.3g}, {_shown(text)}"
        )
    return path


def _shown(name: object) -> str:
    text = ascii(name)
    return text if len(text) <= 80 else f"{text[:77]}..."
