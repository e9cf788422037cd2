"""One instance of an FMU through its C interface, FMI 2 and FMI 3 alike."""

from __future__ import annotations

import ctypes
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from orchestrator.check.child.binary import Binary, Refused

SPELLING = {  # FMI 3 name -> FMI 2 name
    "GetFMUState": "GetFMUstate",
    "SetFMUState": "SetFMUstate",
    "FreeFMUState": "FreeFMUstate",
    "SerializedFMUStateSize": "SerializedFMUstateSize",
    "SerializeFMUState": "SerializeFMUstate",
    "DeserializeFMUState": "DeSerializeFMUstate",
    "GetContinuousStateDerivatives": "GetDerivatives",
    "GetOutputDerivatives": "GetRealOutputDerivatives",
}
_made = 0  # instances of this process
GUARD = 64  # bytes behind a serialised state that the FMU must leave alone


class Spent(Exception):
    """This process has had its one instance of an FMU that declares that it can be made only once."""


class Functions2(ctypes.Structure):
    """fmi2CallbackFunctions."""

    _fields_ = [(n, ctypes.c_void_p) for n in ("logger", "allocate", "free", "finished", "environment")]


class EventInfo(ctypes.Structure):
    """fmi2EventInfo."""

    _fields_ = [
        *((n, ctypes.c_int) for n in ("needed", "terminate", "nominals", "values", "defined")),
        ("next", ctypes.c_double),
    ]


def _memory() -> tuple[int, int]:
    """Addresses of the C library's calloc and free."""
    library = ctypes.CDLL("msvcrt" if ctypes.sizeof(ctypes.c_wchar) == 2 else None)
    return tuple(ctypes.cast(library[n], ctypes.c_void_p).value or 0 for n in ("calloc", "free"))  # type: ignore[return-value]


class Instance:
    """An instance; side is "cs" or "me". Raises Refused when the FMU gives none, Spent when none is left."""

    def __init__(
        self,
        binary: Binary,
        side: str,
        folder: Path,
        name: str = "probe",
        token: str | None = None,
        resources: str | None = None,
        logging: bool = False,
        update: Any = None,
        early: bool = False,
    ) -> None:
        self.binary, self.side, self.declared = binary, side, binary.declared
        self._update, self._early = update, early  # FMI 3: callback inside a step, it may end the step
        token = self.declared.token if token is None else token
        if resources is None:
            there = folder / "resources"
            resources = there.as_uri() if self.declared.major == 2 else f"{there}/"
        words = [w.encode() for w in (name, token, resources)]
        make = self._instantiate2 if self.declared.major == 2 else self._instantiate3
        global _made
        if _made and self.declared.can(side, "canBeInstantiatedOnlyOncePerProcess"):
            raise Spent
        handle = make(words, logging)
        if not handle:
            raise Refused(f"{binary.prefix}Instantiate", 3, binary.log.last())
        _made += 1
        self.handle = ctypes.c_void_p(handle)
        self.ended = False  # the FMU asked to end the simulation
        self.returned_early = False

    def _instantiate2(self, words: list[bytes], logging: bool) -> Any:
        allocate, free = _memory()
        logger = ctypes.cast(self.binary.logger, ctypes.c_void_p).value
        self._callbacks = Functions2(logger, allocate, free, None, None)
        name, token, resources = words
        kind = 1 if self.side == "cs" else 0
        return self.binary.raw(
            *("Instantiate", name, kind, token, resources, ctypes.byref(self._callbacks), 0, int(logging)),
            result=ctypes.c_void_p,
        )

    def _instantiate3(self, words: list[bytes], logging: bool) -> Any:
        b, none = ctypes.c_bool, ctypes.c_void_p(None)
        common = [*words, b(False), b(logging)]
        if self.side == "me":
            arguments = ["InstantiateModelExchange", *common, none, self.binary.logger]
        else:
            required = [v.reference for v in self.declared.of("output") if v.is_float]
            inner = (ctypes.c_uint * max(len(required), 1))(*required)
            count = ctypes.c_size_t(len(required) if self._update else 0)
            extra = [b(False), b(self._early), inner if self._update else none, count]
            last = [self.binary.logger, self._update or none]
            arguments = ["InstantiateCoSimulation", *common, *extra, none, *last]
        return self.binary.raw(*arguments, result=ctypes.c_void_p)

    # ---- calls

    def _name(self, name: str) -> str:
        return SPELLING.get(name, name) if self.declared.major == 2 else name

    def call(self, name: str, *arguments: Any) -> None:
        """Call a function by its FMI 3 name; raises Refused."""
        self.binary.call(self._name(name), self.handle, *arguments)

    def status(self, name: str, *arguments: Any) -> int:
        """The status that a function returns."""
        found: int = self.binary.raw(self._name(name), self.handle, *arguments)
        return found

    def flag(self, value: bool = False) -> Any:
        """A boolean of this version of FMI."""
        return ctypes.c_int(value) if self.declared.major == 2 else ctypes.c_bool(value)

    # ---- life

    def enter(self, start: float = 0.0, stop: float | None = None, tolerance: float | None = None) -> None:
        """Announce the experiment and enter initialisation mode."""
        self.binary.beacon.time = start
        d = ctypes.c_double
        experiment = [self.flag(tolerance is not None), d(tolerance or 0.0), d(start)]
        experiment += [self.flag(stop is not None), d(stop or 0.0)]
        if self.declared.major == 2:
            self.call("SetupExperiment", *experiment)
            experiment = []
        self.call("EnterInitializationMode", *experiment)

    def leave(self) -> None:
        """Leave initialisation mode."""
        self.call("ExitInitializationMode")

    def terminate(self) -> None:
        """End the simulation."""
        self.call("Terminate")

    def free(self) -> None:
        """Free the instance; may be repeated."""
        if self.handle:
            self.binary.raw("FreeInstance", self.handle, result=None)
            self.handle = ctypes.c_void_p(None)

    def step(self, time: float, length: float) -> float:
        """One communication step; returns the time reached."""
        d, beacon = ctypes.c_double, self.binary.beacon
        beacon.time = time
        if self.declared.major == 2:
            try:
                self.call("DoStep", d(time), d(length), 1)
            except Refused as refusal:
                if refusal.status != 2 or not self._terminated():
                    raise
                self.ended = True
            return time + length
        flags, last = [ctypes.c_bool(False) for _ in range(3)], d(math.nan)
        out = [ctypes.byref(x) for x in flags]
        self.call("DoStep", d(time), d(length), ctypes.c_bool(True), *out, ctypes.byref(last))
        self.ended, self.returned_early = flags[1].value, flags[2].value
        return last.value

    def _terminated(self) -> bool:
        answer = ctypes.c_int(0)
        return self.status("GetBooleanStatus", 3, ctypes.byref(answer)) == 0 and bool(answer.value)

    # ---- states of the FMU

    def save(self) -> Any:
        """A handle of the state."""
        state = ctypes.c_void_p(None)
        self.call("GetFMUState", ctypes.byref(state))
        return state

    def restore(self, state: Any) -> None:
        """Back to a saved state."""
        self.call("SetFMUState", state)

    def forget(self, state: Any) -> None:
        """Free a saved state."""
        self.call("FreeFMUState", ctypes.byref(state))

    def serialize(self, state: Any) -> bytes:
        """A saved state as bytes; raises ValueError when the FMU writes more than it announced."""
        size = ctypes.c_size_t(0)
        self.call("SerializedFMUStateSize", state, ctypes.byref(size))
        buffer = (ctypes.c_ubyte * (size.value + GUARD))(*[0] * size.value, *[0xA5] * GUARD)
        self.call("SerializeFMUState", state, buffer, size)
        if bytes(buffer[size.value :]) != b"\xa5" * GUARD:
            raise ValueError(f"more is written than the announced {size.value} bytes")
        return bytes(buffer[: size.value])

    def deserialize(self, data: bytes) -> Any:
        """A state from bytes."""
        state = ctypes.c_void_p(None)
        buffer = (ctypes.c_ubyte * max(len(data), 1)).from_buffer_copy(data or b"\0")
        self.call("DeserializeFMUState", buffer, ctypes.c_size_t(len(data)), ctypes.byref(state))
        return state

    # ---- derivatives

    def directional(self, unknowns: Sequence[int], known: int) -> list[float]:
        """Derivatives of the unknowns with respect to one known, by value references."""
        rows = (ctypes.c_uint * len(unknowns))(*unknowns)
        n, one = ctypes.c_size_t(len(unknowns)), ctypes.c_size_t(1)
        column, seed = (ctypes.c_uint * 1)(known), (ctypes.c_double * 1)(1.0)
        result = (ctypes.c_double * len(unknowns))()
        if self.declared.major == 2:
            self.call("GetDirectionalDerivative", rows, n, column, one, seed, result)
        else:
            self.call("GetDirectionalDerivative", rows, n, column, one, seed, one, result, n)
        return list(result)

    def adjoint(self, unknown: int, knowns: Sequence[int]) -> list[float]:
        """Derivatives of one unknown with respect to the knowns (FMI 3)."""
        row, seed = (ctypes.c_uint * 1)(unknown), (ctypes.c_double * 1)(1.0)
        columns, one = (ctypes.c_uint * len(knowns))(*knowns), ctypes.c_size_t(1)
        n, result = ctypes.c_size_t(len(knowns)), (ctypes.c_double * len(knowns))()
        self.call("GetAdjointDerivative", row, one, columns, n, seed, one, result, n)
        return list(result)

    def slopes(self, references: Sequence[int]) -> list[float]:
        """First time derivatives of outputs."""
        count = len(references)
        rows, orders = (ctypes.c_uint * count)(*references), (ctypes.c_int32 * count)(*[1] * count)
        result, n = (ctypes.c_double * count)(), ctypes.c_size_t(count)
        extra = [n] if self.declared.major == 3 else []
        self.call("GetOutputDerivatives", rows, n, orders, result, *extra)
        return list(result)
