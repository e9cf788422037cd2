"""What a result file holds, by its header alone: a list of files must not read them all."""

from __future__ import annotations

import csv
from pathlib import Path

LONGEST = 2**20  # characters of the first line; a run of all signals has some thousand


def names(path: Path) -> list[str]:
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
