"""Values on their way between the arrays of a network and the arguments of an FMI call."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from typing import Any

import numpy as np

from orchestrator.errors import Problem
from orchestrator.slaves.slave import Buffer, Call
from orchestrator.system.interface import Value, Variable


def pointer(values: Buffer, count: int) -> ctypes.c_void_p:
    """The address of a contiguous slice of at least `count` elements; the caller keeps the array alive."""
    if len(values) < count or not values.flags.c_contiguous or values.dtype not in (np.float64, np.int32):
        raise ValueError(f"expected {count} contiguous values, got shape {values.shape} of {values.dtype}")
    return address(values)


def address(values: Buffer) -> ctypes.c_void_p:
    """Where an array begins; the caller keeps it alive."""
    return ctypes.c_void_p(values.ctypes.data)


def fitting(values: Buffer, count: int, kind: Any) -> Buffer:
    """`values` itself where an FMU of this ctypes kind can use it directly, else an array that it can use."""
    pointer(values, count)
    return values if values.dtype == np.dtype(kind) else np.zeros(count, kind)


def converted(read: Call, own: Buffer, into: Buffer, names: Sequence[str]) -> Call:
    """Read into `own`, then carry over to the network's array."""
    into = into[: len(own)]

    def call() -> None:
        read()
        into[:] = own
        check(own, into, names)

    return call


def prepared(write: Call, own: Buffer, values: Buffer, names: Sequence[str]) -> Call:
    """Carry over from the network's array to `own`, then write."""
    values = values[: len(own)]

    def call() -> None:
        own[:] = values
        check(values, own, names)
        write()

    return call


def check(before: Buffer, after: Buffer, names: Sequence[str]) -> None:
    """Refuse whole numbers that the other type cannot hold; real ones may be rounded."""
    if after.dtype.kind in "iu" and not np.array_equal(before, after):
        at = int(np.flatnonzero(before != after)[0])
        raise Problem(f"{names[at]}: {before[at]} does not fit into {after.dtype}")


def packed(variable: Variable, kind: Any, value: Value) -> Any:
    """One value as a ctypes object."""
    if variable.kind == "String":
        return ctypes.c_char_p(str(value).encode())
    if variable.is_real:
        return kind(float(value))
    cell = kind(int(value))
    if cell.value != int(value) and variable.kind != "Boolean":
        raise Problem(f"{variable.name}: {value} does not fit into {variable.word or variable.kind}")
    return cell


def unpacked(variable: Variable, cell: Any) -> Value:
    """The value in a ctypes object."""
    if variable.kind == "String":
        return (cell.value or b"").decode(errors="replace")
    value: Value = cell.value
    return bool(value) if variable.kind == "Boolean" else value
