"""Columns of a MATLAB file: vectors, fields of structs ("run.pressure"), of a matrix "data(:,2)".

Versions 4 to 7.2 are read by scipy, version 7.3 is an HDF5 file and read by h5py.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import scipy.io
from numpy.typing import NDArray

from fmus.contract import ModelError
from fmus.identification.recordings.columns import Table, finite, near

MOST_COLUMNS = 256  # of a matrix that are listed one by one


def read_mat(path: Path, names: Collection[str]) -> Table:
    """Columns of a MATLAB file by name, all of one length."""
    there = dict(_flat("", _variables(path)))
    for name in names:
        if name not in there:
            raise ModelError(f"{path}: column {name!r} expected, found {near(name, list(there))}")
    columns = {name: _numbers(there[name], path, name) for name in sorted(names)}
    sizes = {name: len(values) for name, values in columns.items()}
    if len(set(sizes.values())) > 1:
        found = ", ".join(f"{name} {size}" for name, size in sizes.items())
        raise ModelError(f"{path}: expected columns of one length, found {found}")
    if min(sizes.values()) < 2:
        raise ModelError(f"{path}: expected two or more samples, found {min(sizes.values())}")
    rows = np.arange(1, 1 + min(sizes.values()))
    for name, values in columns.items():
        finite(values, rows, f"{path}: row {{}}: column {name!r}")
    return Table(columns, rows)


def _variables(path: Path) -> dict[str, Any]:
    """Arrays by name, structs as dictionaries, whichever version."""
    if not path.is_file():
        raise ModelError(f"{path}: expected a MATLAB file, found no such file")
    try:
        if h5py.is_hdf5(path):
            with h5py.File(path, "r") as file:
                return _group(file)
        return dict(scipy.io.loadmat(path, simplify_cells=True))
    except (ValueError, TypeError, OSError, NotImplementedError, scipy.io.matlab.MatReadError) as error:
        first = str(error).strip().splitlines()[0] if str(error).strip() else type(error).__name__
        raise ModelError(f"{path}: expected a MATLAB file, found {first}") from None


def _group(group: Any) -> dict[str, Any]:
    """A group of HDF5, which is a struct; text becomes a string, references (cells, objects) are left out."""
    result: dict[str, Any] = {}
    for name, item in group.items():
        if name.startswith("#"):
            continue
        if isinstance(item, h5py.Group):
            result[name] = _group(item)
        elif item.attrs.get("MATLAB_class") == b"char":
            result[name] = "".join(map(chr, np.asarray(item).T.ravel()))
        elif item.dtype.kind in "fiub" and not item.attrs.get("MATLAB_empty", 0):
            result[name] = np.asarray(item).T  # HDF5 counts dimensions the other way round
    return result


def _flat(prefix: str, struct: dict[str, Any]) -> Iterator[tuple[str, Any]]:
    """Names and contents of what could be a column."""
    for key, item in struct.items():
        name = f"{prefix}{key}"
        if name.startswith("__"):
            continue
        if isinstance(item, dict):
            yield from _flat(f"{name}.", item)
        elif isinstance(item, str):
            yield name, item
        else:
            yield from _columns(name, np.asarray(item))


def _columns(name: str, array: NDArray[Any]) -> Iterator[tuple[str, Any]]:
    """A vector by its name, a matrix by "name(:,1)", "name(:,2)", ...; a wide one by "name(1,:)", ..."""
    array = np.squeeze(array)
    if array.ndim < 2:
        yield name, np.atleast_1d(array)
    elif array.ndim == 2 and array.shape[1] <= MOST_COLUMNS:
        for i in range(array.shape[1]):
            yield f"{name}(:,{i + 1})", array[:, i]
    elif array.ndim == 2 and array.shape[0] <= MOST_COLUMNS:  # one signal per row, as is usual for data sets
        for i in range(array.shape[0]):
            yield f"{name}({i + 1},:)", array[i]


def _numbers(values: Any, path: Path, name: str) -> NDArray[np.float64]:
    """Real numbers; text and complex numbers are refused."""
    if isinstance(values, str) or values.dtype.kind not in "fiub":
        found = repr(values[:40]) if isinstance(values, str) else f"{values.dtype} such as {values[0]!r}"
        raise ModelError(f"{path}: row 1: column {name!r}: expected numbers, found {found}")
    numbers: NDArray[np.float64] = values.astype(np.float64)
    return numbers
