"""The columns of a data file, whichever kind it is."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

from fmus.identification.recordings.columns import Table
from fmus.identification.recordings.matlab import read_mat
from fmus.identification.recordings.parquet import read_parquet
from fmus.identification.recordings.text import read_text

DATA = (".csv", ".parquet", ".mat")


def read_table(data: Path, names: Collection[str], file: Mapping[str, Any]) -> Table:
    """Columns by name; `file` is the table [file] of the meta file, for text."""
    kind = data.suffix.lower()
    if kind == ".parquet":
        return read_parquet(data, names)
    if kind == ".mat":
        return read_mat(data, names)
    return read_text(data, names, file.get("delimiter"), file.get("decimal"), file.get("skip_lines", 0))
