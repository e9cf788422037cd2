"""Number columns of a Parquet file. A null is a gap."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow
import pyarrow.parquet
from numpy.typing import NDArray

from fmus.contract import ModelError
from fmus.identification.recordings.columns import Table, finite, first_line, place
from fmus.identification.recordings.recording import Array
from fmus.identification.recordings.text import numbers


def read_parquet(path: Path, names: Collection[str]) -> Table:
    """Columns of a Parquet file by name."""
    try:
        with pyarrow.parquet.ParquetFile(path) as file:
            header = file.schema_arrow.names
            for name in names:
                place(name, header, path)
            table = file.read(columns=sorted(names))
    except (pyarrow.ArrowInvalid, OSError) as error:
        raise ModelError(f"{path}: expected a Parquet file, found {first_line(error)}") from None
    rows = np.arange(1, table.num_rows + 1)
    columns = {name: _arrow(table.column(name), rows, path, name) for name in sorted(names)}
    return Table(columns, rows)


def _arrow(column: Any, rows: NDArray[np.int64], path: Path, name: str) -> Array:
    """A column of Parquet as numbers; a column of text too if all of it is numbers."""
    where = f"{path}: row {{}}: column {name!r}"
    kind = column.type
    if pyarrow.types.is_integer(kind) or pyarrow.types.is_floating(kind) or pyarrow.types.is_decimal(kind):
        return finite(column.cast(pyarrow.float64()).to_pandas().to_numpy(np.float64), rows, where)
    if pyarrow.types.is_string(kind) or pyarrow.types.is_large_string(kind):
        return numbers(np.array([v or "" for v in column.to_pylist()], object), rows, ".", where)
    raise ModelError(f"{path}: row 1: column {name!r}: expected numbers, found {kind}")
