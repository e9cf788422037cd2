"""Result files that a page may name: those that lie in the open folders, and nothing else."""

from __future__ import annotations

import csv
import os
import stat
from collections.abc import Sequence
from pathlib import Path, PurePosixPath

from orchestrator.base.errors import Problem

LONGEST = 2**20  # characters of the first line; a run of all signals has some thousand
SUFFIXES = (".csv", ".parquet")
LARGEST = 2 * 10**9  # bytes; a run of an hour with all signals has about 0.5e9 as CSV
MOST = 1000  # files that are listed
# names that Windows takes for devices, with any suffix
DEVICES = {"con", "prn", "aux", "nul", *(f"{port}{n}" for port in ("com", "lpt") for n in range(1, 10))}


def list_results(folders: Sequence[Path]) -> list[str]:
    """Names of the result files in the folders as `find_result` takes them: relative, forward slashes."""
    found = []
    for folder in folders:
        for path in sorted(folder.iterdir()) if folder.is_dir() else ():
            try:
                found.append(_inside(folder, path.name).relative_to(folder.resolve()).as_posix())
            except Problem:
                continue
    return list(dict.fromkeys(found))[:MOST]


def find_result(name: object, folders: Sequence[Path]) -> Path:
    """The file of this name in one of the folders; Problem tells in one line what is refused."""
    text = _relative(name)
    problem = Problem(f"file: no folder with results is open, asked for {_shown(text)}")
    for folder in folders:
        try:
            return _inside(folder, text)
        except Problem as error:
            problem = error
    raise problem


def _relative(name: object) -> str:
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


def _inside(folder: Path, name: str) -> Path:
    """Links are followed first and judged by where they end."""
    root, text = folder.resolve(), _relative(name)
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


def columns_of(path: Path) -> list[str]:
    """The names of the columns; none if it is no such file."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        if path.suffix.lower() == ".parquet":
            return list(pq.read_schema(path).names)
        with path.open(encoding="utf-8-sig", newline="") as file:
            first = file.readline(LONGEST)
    except (OSError, ValueError, pa.ArrowException):
        return []
    return [name.strip() for name in next(csv.reader([first]), [])]
