"""Number columns of a CSV file as people and loggers write them."""

from __future__ import annotations

import csv
from collections.abc import Collection
from difflib import get_close_matches
from math import isfinite
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from orchestrator.errors import Problem


def read_columns(
    path: Path, names: Collection[str], delimiter: str = ",", decimal: str = ".", skip_lines: int = 0
) -> dict[str, NDArray[np.float64]]:
    """The named columns, each of shape (n,).

    skip_lines   lines before the row of column names
    decimal      "." or ","
    """
    try:
        text = path.read_text(encoding="utf-8-sig")
    except FileNotFoundError:
        raise Problem(f"{path}: expected a CSV file, got no such file") from None
    except UnicodeDecodeError as error:
        raise Problem(f"{path}: expected text in UTF-8, got {error}") from None
    if len(delimiter) != 1 or decimal not in (".", ",") or delimiter == decimal:
        raise Problem(
            f"{path}: expected a one-character delimiter and decimal . or ,, got {delimiter!r}, {decimal!r}"
        )
    rows = csv.reader(text.splitlines()[skip_lines:], delimiter=delimiter)
    header = [name.strip() for name in next(rows, [])]
    places = {name: _place(name, header, path) for name in sorted(names)}
    cells: dict[str, list[float]] = {name: [] for name in places}
    for number, row in enumerate(rows, skip_lines + 2):
        if not any(cell.strip() for cell in row):
            continue
        if len(row) != len(header):
            raise Problem(f"{path}: line {number}: expected {len(header)} cells, got {len(row)}")
        for name, place in places.items():
            cells[name].append(_number(row[place], decimal, f"{path}: line {number}: column {name!r}"))
    if any(len(column) < 2 for column in cells.values()):
        raise Problem(f"{path}: expected two or more rows of numbers, got {max(map(len, cells.values()))}")
    return {name: np.array(column) for name, column in cells.items()}


def _place(name: str, header: list[str], path: Path) -> int:
    if header.count(name) == 1:
        return header.index(name)
    if name in header:
        raise Problem(f"{path}: column {name!r} expected once, got it {header.count(name)} times")
    near = get_close_matches(name, header, 3) or header[:8]
    raise Problem(f"{path}: column {name!r} expected, got {', '.join(near) or 'no header'}")


def _number(cell: str, decimal: str, where: str) -> float:
    try:
        value = float(cell.replace(decimal, ".") if decimal != "." else cell)
    except ValueError:
        raise Problem(f"{where}: expected a number, got {cell!r}") from None
    if not isfinite(value):
        raise Problem(f"{where}: expected a finite number, got {cell!r}")
    return value
