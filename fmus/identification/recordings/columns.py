"""Number columns of a file, whichever kind it is: a sample that is not there is a gap, NaN."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from difflib import get_close_matches
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fmus.contract import ModelError
from fmus.identification.recordings.recording import Array


class Table(NamedTuple):
    """Columns of one file.

    row     line (text) or row (other files) of each sample, counted from 1
    rows    what that is called in a message
    """

    columns: Mapping[str, Array]
    row: NDArray[np.int64]
    rows: str = "row"


def finite(values: Array, rows: NDArray[np.int64], where: str) -> Array:
    """The values, which may be gaps but not infinite."""
    endless = np.flatnonzero(np.isinf(values))
    if len(endless):
        k = endless[0]
        raise ModelError(f"{where.format(rows[k])}: expected a finite number, found {values[k]:g}")
    return values


def place(name: str, header: Sequence[str], path: Path) -> int:
    """Where a column stands; it must be there once."""
    if list(header).count(name) == 1:
        return list(header).index(name)
    if name in header:
        raise ModelError(f"{path}: column {name!r} expected once, found {list(header).count(name)} times")
    raise ModelError(f"{path}: column {name!r} expected, found {near(name, header)}")


def near(name: str, names: Sequence[str]) -> str:
    """The names that come close to one that is missing, else the first ones."""
    close = get_close_matches(name, names, 3)
    first = [*names[:8], *(["..."] if len(names) > 8 else [])]
    return ", ".join(close or first) or "no names"


def first_line(error: Exception) -> str:
    """The first line of a library's message."""
    return str(error).strip().splitlines()[0]
