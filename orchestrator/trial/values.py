"""Some numeric variables of an instance, read and set together."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from typing import Any

from orchestrator.trial.declared import FLOATS, Variable
from orchestrator.trial.instance import Instance

C2: dict[str, Any] = {"Real": ctypes.c_double, "Integer": ctypes.c_int, "Boolean": ctypes.c_int}
C3: dict[str, Any] = {
    "Float64": ctypes.c_double,
    "Float32": ctypes.c_float,
    "Boolean": ctypes.c_bool,
    **{f"{u}Int{n}": getattr(ctypes, f"c_{u.lower()}int{n}") for u in ("", "U") for n in (8, 16, 32, 64)},
}


class Values:
    """Some numeric variables of an instance, read and set together; arrays lie flat."""

    def __init__(self, instance: Instance, variables: Sequence[Variable]) -> None:
        self.instance, self.variables = instance, list(variables)
        self.names = scalars(variables)
        self._groups = [self._group(kind) for kind in dict.fromkeys(_access(instance, v) for v in variables)]

    def _group(self, kind: str) -> tuple[str, Any, Any, list[int]]:
        """Name of the type, value references, buffer, and the places of its scalars among all."""
        places: list[int] = []
        members: list[Variable] = []
        position = 0
        for v in self.variables:
            if _access(self.instance, v) == kind:
                members.append(v)
                places += range(position, position + v.size)
            position += v.size
        kinds = C2 if self.instance.declared.major == 2 else C3
        references = (ctypes.c_uint * len(members))(*[v.reference for v in members])
        return kind, references, (kinds[kind] * len(places))(), places

    def _arguments(self, references: Any, buffer: Any) -> list[Any]:
        n = ctypes.c_size_t(len(references))
        extra = [ctypes.c_size_t(len(buffer))] if self.instance.declared.major == 3 else []
        return [references, n, buffer, *extra]

    def get(self) -> list[float]:
        """Values in the order of the variables."""
        result = [0.0] * len(self.names)
        for kind, references, buffer, places in self._groups:
            self.instance.call(f"Get{kind}", *self._arguments(references, buffer))
            for place, value in zip(places, buffer, strict=True):
                result[place] = float(value)
        return result

    def set(self, values: Sequence[float]) -> None:
        """Set all; whole numbers and booleans are rounded."""
        shown = zip(self.names, values, strict=True)
        self.instance.binary.beacon.inputs(", ".join(f"{n} = {x:.6g}" for n, x in shown))
        for kind, references, buffer, places in self._groups:
            real = kind in FLOATS
            for i, place in enumerate(places):
                buffer[i] = values[place] if real else int(values[place])
            self.instance.call(f"Set{kind}", *self._arguments(references, buffer))


def scalars(variables: Sequence[Variable]) -> list[str]:
    """Names of the scalars of some variables."""
    return [v.name if v.size == 1 else f"{v.name}[{i}]" for v in variables for i in range(v.size)]


def _access(instance: Instance, v: Variable) -> str:
    """The word in the names of the functions: enumerations are read as whole numbers."""
    if v.kind == "Enumeration":
        return "Integer" if instance.declared.major == 2 else "Int64"
    return v.kind
