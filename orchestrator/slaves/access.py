"""One FMI call that reads or sets a row of variables, to be made from Python or from C."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orchestrator.errors import Problem
from orchestrator.slaves.calls import Bound
from orchestrator.slaves.slave import Buffer

OUT_OF_RANGE = -1  # as a status: a whole number that the other type cannot hold


@dataclass(frozen=True)
class Access:
    """A call of fmiXGet..., fmiXSet... or one of their kin, with all its arguments fixed.

    call         makes the call from Python and judges its status
    address      of the FMI function, for C
    component    the instance
    fmi          2 or 3: whether the number of values is an argument too
    references   value references, shape (n,)
    orders       of derivatives, shape (n,); None for values
    own          what the FMU reads or writes, shape (n,)
    values       where the run keeps it, shape (n,); `own` itself where the types agree
    sets         True when the FMU takes the values
    names        of the variables
    """

    call: Bound
    address: int
    component: int
    fmi: int
    references: NDArray[np.uint32]
    orders: NDArray[np.int32] | None
    own: Buffer
    values: Buffer
    sets: bool
    names: Sequence[str]

    def __call__(self) -> None:
        if self.own.dtype == self.values.dtype:
            self.call()
        elif self.sets:
            with np.errstate(over="ignore"):  # what is too large in single precision becomes infinite
                self.own[:] = self.values
            check(self.values, self.own, self.names)
            self.call()
        else:
            self.call()
            self.values[:] = self.own
            check(self.own, self.values, self.names)

    def judge(self, status: int) -> None:
        """Raise what the call from Python would raise; after a call from C, which does not judge."""
        if status == OUT_OF_RANGE:
            if self.sets:
                self.own[:] = self.values
                check(self.values, self.own, self.names)
            self.values[:] = self.own
            check(self.own, self.values, self.names)
        self.call.judge(status)


@dataclass(frozen=True)
class Derivative:
    """A call of fmiXGetDirectionalDerivative with all its arguments fixed.

    call, address, component, fmi   as in `Access`
    of, by                          value references of outputs, shape (m,), and of inputs, shape (n,)
    seed, into                      the direction in which the inputs move, and how the outputs change
    """

    call: Bound
    address: int
    component: int
    fmi: int
    of: NDArray[np.uint32]
    by: NDArray[np.uint32]
    seed: Buffer
    into: Buffer

    def __call__(self) -> None:
        self.call()

    def judge(self, status: int) -> None:
        """Raise what the call from Python would raise; after a call from C, which does not judge."""
        self.call.judge(status)


@dataclass(frozen=True)
class Stepping:
    """What it takes to step an instance, and to save and restore its state, from C.

    do_step, get_state, set_state   addresses of the FMI functions; 0 for those that are not needed
    results                         addresses of what FMI 3.0 says of a step: event, terminate, early, last
    flags                           address of the first three of them together; 0 in FMI 2.0
    judge, judge_get, judge_set     raise what each of the three, called from Python, would for a status
    clock                           where the time is noted for messages, see `Log.clock`
    """

    component: int
    fmi: int
    do_step: int
    get_state: int
    set_state: int
    results: tuple[int, ...]
    flags: int
    judge: Callable[[int], None]
    judge_get: Callable[[int], None]
    judge_set: Callable[[int], None]
    clock: NDArray[np.float64]


def fitting(values: Buffer, count: int, kind: Any) -> Buffer:
    """`values` itself where an FMU of this ctypes kind can use it directly, else an array that it can use."""
    if len(values) < count or not values.flags.c_contiguous or values.dtype not in (np.float64, np.int32):
        raise ValueError(f"expected {count} contiguous values, got shape {values.shape} of {values.dtype}")
    return values[:count] if values.dtype == np.dtype(kind) else np.zeros(count, kind)


def check(before: Buffer, after: Buffer, names: Sequence[str]) -> None:
    """Refuse whole numbers that the other type cannot hold; real ones may be rounded."""
    if after.dtype.kind in "iu" and not np.array_equal(before, after):
        at = int(np.flatnonzero(before != after)[0])
        raise Problem(f"{names[at]}: {before[at]} does not fit into {after.dtype}")
