"""Access to result files by name from a page, restricted to the open folders."""

import csv
import os
import stat
from collections.abc import Sequence
from pathlib import Path, PurePosixPath

from orchestrator.base.errors import Problem

LONGEST = 2**20  # characters of the header line; that of a run with all signals has some thousand
SUFFIXES = (".csv", ".parquet")
LARGEST = 2 * 10**9  # bytes; a run of an hour with all signals has about 0.5e9 as CSV
MOST = 1000  # listed files
# names that mean devices on Windows, with any suffix
DEVICES = {"con", "prn", "aux", "nul", *(f"{port}{n}" for port in ("com", "lpt") for n in range(1, 10))}


def list_results(folders: Sequence[Path]) -> list[str]:
    """Names of the result files in the folders, for `find_result`: relative, with forward slashes."""
    names = []
    for folder in folders:
        for path in sorted(folder.iterdir()) if folder.is_dir() else ():
            try:
                names.append(_inside(folder, path.name).relative_to(folder.resolve()).as_posix())
            except Problem:
                continue
    return list(dict.fromkeys(names))[:MOST]


def find_result(name: object, folders: Sequence[Path]) -> Path:
    """Path of the file of this name in one of the folders. Raises `Problem` if it is refused."""
    relative = _relative(name)
    problem = Problem(f"file {_quoted(relative)}: no folder of results is open")
    for folder in folders:
        try:
            return _inside(folder, relative)
        except Problem as error:
            problem = error
    raise problem


def _relative(name: object) -> str:
    """Check that the name is a relative path on every operating system, before any file is accessed."""
    if not isinstance(name, str) or not 0 < len(name) <= 255:
        raise Problem(f"file: expected a name of 1 to 255 characters, found {_quoted(name)}")
    if not name.isprintable() or any(c in name for c in '\\:*?"<>|'):
        raise Problem(f"file: expected plain characters and forward slashes, found {_quoted(name)}")
    path = PurePosixPath(name)
    if path.is_absolute() or ".." in path.parts:
        raise Problem(f"file: expected a path in the folder of results, found {_quoted(name)}")
    if any(part.partition(".")[0].strip().lower() in DEVICES for part in path.parts):
        raise Problem(f"file: expected a file, found the name of a device, {_quoted(name)}")
    if path.suffix.lower() not in SUFFIXES:
        raise Problem(f"file: expected a name ending in {' or '.join(SUFFIXES)}, found {_quoted(name)}")
    return name


def _inside(folder: Path, name: str) -> Path:
    """Path of a file in the folder, after links are resolved."""
    root, relative = folder.resolve(), _relative(name)
    try:
        path = (root / relative).resolve(strict=True)
        status = os.stat(path)
    except (OSError, RuntimeError, ValueError) as error:
        raise Problem(f"file {_quoted(relative)}: no such result file") from error
    if not path.is_relative_to(root):
        raise Problem(
            f"file {_quoted(relative)}: expected a file in the folder of results, found a link out of it"
        )
    if not stat.S_ISREG(status.st_mode) or path.suffix.lower() not in SUFFIXES:
        raise Problem(f"file {_quoted(relative)}: expected a result file, found something else")
    if (gigabytes := status.st_size / 1e9) > LARGEST / 1e9:
        raise Problem(
            f"file {_quoted(relative)}: expected at most {LARGEST / 1e9:g} GB, found {gigabytes:.3g} GB"
        )
    return path


def _quoted(name: object) -> str:
    text = ascii(name)
    return text if len(text) <= 80 else f"{text[:77]}..."


def columns_of(path: Path) -> list[str]:
    """Names of the columns; empty if the file cannot be read."""
    try:
        if path.suffix.lower() == ".parquet":
            return _columns_of_parquet(path)
        with path.open(encoding="utf-8-sig", newline="") as file:
            header = file.readline(LONGEST)
    except (OSError, ValueError):
        return []
    return [name.strip() for name in next(csv.reader([header]), [])]


def _columns_of_parquet(path: Path) -> list[str]:
    """Names of the columns; empty if the package that reads the file is not installed."""
    try:
        import pyarrow as pa
        import pyarrow.parquet as pq
    except ModuleNotFoundError:
        return []
    try:
        return list(pq.read_schema(path).names)
    except pa.ArrowException:
        return []
