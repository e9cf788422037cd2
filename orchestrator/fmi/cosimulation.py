"""A running co-simulation FMU, FMI 2.0 or 3.0: how it steps and goes back, and what it is able to."""

from __future__ import annotations

import ctypes
from collections.abc import Mapping, Sequence
from contextlib import nullcontext, suppress
from functools import partial
from time import perf_counter

import numpy as np

from orchestrator.base.errors import Problem
from orchestrator.base.files import Location
from orchestrator.fmi.calls import Stepping
from orchestrator.fmi.description import Interface, Value
from orchestrator.fmi.instance import BoundInstance, Rehearsal
from orchestrator.fmi.library import ERROR, FATAL, WARNING


class FmuSlave(BoundInstance):
    """One instance of a co-simulation FMU, as masters use it."""

    def __init__(
        self, name: str, interface: Interface, fmu: Location, start: Mapping[str, Value] | None = None
    ) -> None:
        """start: values for instances that only try what the FMU does; this one gets its own by `set`."""
        self._source, self._start = fmu, start or {}
        self._rehearsal = Rehearsal(self._another)
        self._cubic: bool | None = None
        self._final = 1  # no step will be repeated
        self.busy = 0.0
        super().__init__(name, interface, fmu)

    def _open(self, fmu: Location) -> None:
        super()._open(fmu)
        self._step = self.calls.function("DoStep")
        self._flags, self._results = self._fmi.flags, self._fmi.results

    def setup(self, start: float, stop: float, tolerance: float | None) -> None:
        """Announce the experiment; times in [s]."""
        self._rehearsal.end()
        super().setup(start, stop, tolerance)

    def close(self) -> None:
        """Terminate and free the instance, unload the library, remove the unpacked files. May be repeated."""
        self._rehearsal.end()
        super().close()

    # ---- what it is able to

    def follows(self, variable: str, degree: int) -> int:
        """The highest degree of a polynomial, up to `degree`, that an input can be given: 0, 1 or 3."""
        if variable not in self.interface.sloped or degree == 0:
            return 0
        if degree == 1 or not self.interface.interpolates:
            return 1
        if self._cubic is None:  # FMI 2.0 has no declaration for it
            ask = partial(
                FmuSlave.slope_writer, variables=[variable] * 3, slopes=np.zeros(3), orders=[1, 2, 3]
            )
            self._cubic = self._rehearsal.passes(ask) or False
        return 3 if self._cubic else 1

    def tells(self, outputs: Sequence[str]) -> Sequence[str]:
        """Those of the outputs whose first time derivatives the FMU tells; some tell only those of states."""
        if self.interface.slopes < 1:
            return []

        def refused(names: Sequence[str]) -> bool:
            ask = partial(FmuSlave.slope_reader, variables=names, into=np.zeros(len(names)))
            return self._rehearsal.passes(ask) is False

        return [y for y in outputs if not refused([y])] if refused(outputs) else outputs

    def _another(self) -> FmuSlave:
        """One more instance, ready for its first step."""
        if self.interface.only_one:
            raise Problem(f"{self._label}: the FMU can be instantiated only once per process")
        other = FmuSlave(self.name, self.interface, self._source)
        try:
            other.setup(0.0, 1.0, None)
            for variable, value in self._start.items():
                other.set(variable, value)
            other.enter()
            other.exit()
        except Problem:
            other.close()
            raise
        return other

    # ---- steps

    def step(self, t: float, h: float) -> None:
        """Advance from t to t + h [s]; raises Discarded and Ended, which say how far it got."""
        self.log.begin_step(t)
        began = perf_counter()
        status = self._step(ctypes.c_double(t), ctypes.c_double(h), self._final, *self._results)
        self.busy += perf_counter() - began
        if status or self._flags.value:
            self._fmi.stepped(self.calls, status)

    def stepping(self, rolls: bool) -> Stepping:
        """What it takes to step from C; rolls: the state is to be saved and restored, too."""
        state, prefix = self._fmi.state, self._fmi.prefix
        return Stepping(
            component=self.calls.handle.value or 0,
            fmi=self.interface.fmi,
            do_step=self.calls.address("DoStep"),
            get_state=self.calls.address(f"Get{state}") if rolls else 0,
            set_state=self.calls.address(f"Set{state}") if rolls else 0,
            results=self._fmi.places,
            flags=ctypes.addressof(self._flags) if self._fmi.places else 0,
            judge=lambda status: self._fmi.stepped(self.calls, status),
            judge_get=lambda status: self.calls.judge(status, f"{prefix}Get{state}"),
            judge_set=lambda status: self.calls.judge(status, f"{prefix}Set{state}"),
            clock=self.log.clock,
        )

    # ---- rollback

    def save(self, state: ctypes.c_void_p | None = None) -> ctypes.c_void_p:
        """A snapshot of the FMU's state, written over an earlier one if given; give it back with `forget`."""
        self._final = 0
        state = ctypes.c_void_p() if state is None else state
        self.calls.call(f"Get{self._fmi.state}", ctypes.byref(state))
        return state

    def restore(self, state: ctypes.c_void_p) -> None:
        """Go back to a snapshot."""
        self.calls.call(f"Set{self._fmi.state}", state)

    def resume(self) -> None:
        """Forget what the FMU said and returned in a step that is going to be repeated from a saved state."""
        self.log.withdraw()
        if self.calls.worst < FATAL:
            self.calls.worst = min(self.calls.worst, WARNING)

    def forget(self, state: ctypes.c_void_p) -> None:
        """Free a snapshot; after an error it is only tried."""
        free = self.calls.bound(f"Free{self._fmi.state}", ctypes.byref(state))
        with suppress(Problem) if self.calls.worst >= ERROR else nullcontext():
            self.calls.unless_fatal(free)

    def pack(self, state: ctypes.c_void_p) -> bytes:
        """A snapshot as bytes, for another process."""
        size = ctypes.c_size_t()
        self.calls.call(f"Serialized{self._fmi.state}Size", state, ctypes.byref(size))
        room = (ctypes.c_ubyte * size.value)()
        self.calls.call(f"Serialize{self._fmi.state}", state, room, size)
        return bytes(room)

    def unpack(self, data: bytes) -> ctypes.c_void_p:
        """The snapshot in bytes that `pack` made; give it back with `forget`."""
        state, room = ctypes.c_void_p(), (ctypes.c_ubyte * len(data))(*data)
        size = ctypes.c_size_t(len(data))
        self.calls.call(f"{self._fmi.thaw}{self._fmi.state}", room, size, ctypes.byref(state))
        return state
