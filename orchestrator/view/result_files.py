"""Access to result files by name from a page: to those that lie in the open folders, and to nothing else."""

import csv
from collections.abc import Iterator, Sequence
from pathlib import Path

from orchestrator.base.errors import Problem
from orchestrator.base.files import Location
from orchestrator.data.matlab import foreign

LONGEST = 2**20  # characters of the header line; that of a run with all signals has some thousand
SUFFIXES = (".csv", ".parquet")
LARGEST = 2 * 10**9  # bytes; a run of an hour with all signals has about 0.5e9 as CSV
MOST = 1000  # listed files


def list_results(folders: Sequence[Path]) -> dict[str, Path]:
    """The result files in the folders by name, at most `MOST`, without huge ones."""
    files = dict[str, Path]()
    for path in _files(folders):
        if len(files) < MOST and path.stat().st_size <= LARGEST:
            files.setdefault(path.name, path)
    return files


def find_result(name: object, folders: Sequence[Path]) -> Path:
    """The file of this name in one of the folders; raises `Problem` if there is none, or a huge one."""
    path = next((path for path in _files(folders) if path.name == name), None)
    quoted = ascii(str(name)[:60])
    if path is None:
        raise Problem(f"file {quoted}: no such result file in the open folders")
    if (size := path.stat().st_size) > LARGEST:
        raise Problem(f"file {quoted}: expected at most {LARGEST / 1e9:g} GB, found {size / 1e9:.3g} GB")
    return path


def _files(folders: Sequence[Path]) -> Iterator[Path]:
    """Regular files with the suffix of a result, without links that lead out of their folder."""
    for folder in (one.resolve() for one in folders if one.is_dir()):
        for path in sorted(folder.iterdir()):
            if path.suffix.lower() in SUFFIXES and path.is_file():
                real = path.resolve()
                if real.is_relative_to(folder) and real.suffix.lower() in SUFFIXES:
                    yield path


def columns_of(path: Path) -> list[str]:
    """Names of the columns; empty if the file cannot be read."""
    try:
        if path.suffix.lower() == ".parquet":
            return _columns_of_parquet(path)
        with Location(path).opened() as file:
            header = file.readline(LONGEST).decode("utf-8-sig")
    except (Problem, ValueError):
        return []
    return [name.strip() for name in next(csv.reader([header]), [])]


def _columns_of_parquet(path: Path) -> list[str]:
    """Names of the columns; empty if the package that reads the file is not installed."""
    try:
        import pyarrow.parquet as pq
    except ModuleNotFoundError:
        return []
    with foreign(path, "a Parquet"):
        return list(pq.read_schema(path).names)
