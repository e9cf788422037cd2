"""Single values on their way to and from the arguments of an FMI call."""

from __future__ import annotations

import ctypes
from typing import Any

from orchestrator.errors import Problem
from orchestrator.slaves.slave import Buffer
from orchestrator.system.interface import Value, Variable


def address(values: Buffer) -> ctypes.c_void_p:
    """Where an array begins; the caller keeps it alive."""
    return ctypes.c_void_p(values.ctypes.data)


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
