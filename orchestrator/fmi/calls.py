"""How a master uses a running component, and FMI calls with fixed arguments, made from Python or from C.

A call reads or sets a row of variables. It is bound once to value references and a slice of a NumPy array, so
making it is a single call into the FMU without any allocation. Types other than
Float64 and Int32 are converted.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from orchestrator.base.errors import Problem
from orchestrator.fmi.description import FmuInterface, FmuVariable, Value
from orchestrator.fmi.instance import BoundCall
from orchestrator.fmi.messages import Log

Buffer = NDArray[Any]  # float64 for Real, int32 for all whole numbers, Enumeration and Boolean
Call = Callable[[], None]


class Slave(Protocol):
    """What a master needs of a component. All variables of one reader or writer have the same `access`.

    busy      time that its steps took so far [s]
    follows   the highest degree of a polynomial, up to `degree`, that an input can be given: 0, 1 or 3
    tells     those of the outputs whose first time derivatives it tells
    step      raises Discarded when the FMU did only part of the step, Ended when it asks to end the run
    resume    the last step is going to be repeated from a saved state, as if it had not been tried
    save      a snapshot of the state; given an earlier one, that is overwritten
    """

    name: str
    interface: FmuInterface
    log: Log
    busy: float

    def setup(self, start: float, stop: float, tolerance: float | None) -> None: ...
    def enter(self) -> None: ...
    def exit(self) -> None: ...
    def get(self, variable: str) -> Value: ...
    def set(self, variable: str, value: Value) -> None: ...
    def reader(self, variables: Sequence[str], into: Buffer) -> Call: ...
    def writer(self, variables: Sequence[str], values: Buffer) -> Call: ...
    def output_derivative_reader(self, variables: Sequence[str], into: Buffer) -> Call: ...
    def input_derivative_writer(
        self, variables: Sequence[str], slopes: Buffer, orders: Sequence[int] = ()
    ) -> Call: ...
    def directional_derivative(
        self, of: Sequence[str], by: Sequence[str], seed: Buffer, into: Buffer
    ) -> Call: ...
    def input_degree(self, variable: str, degree: int) -> int: ...
    def outputs_with_derivatives(self, outputs: Sequence[str]) -> Sequence[str]: ...
    def step(self, t: float, h: float) -> None: ...
    def after_rollback(self) -> None: ...
    def save(self, state: Any = None) -> Any: ...
    def restore(self, state: Any) -> None: ...
    def free_state(self, state: Any) -> None: ...
    def serialize(self, state: Any) -> bytes: ...
    def deserialize(self, data: bytes) -> Any: ...
    def close(self) -> None: ...


def function_type(variable: FmuVariable) -> str:
    """The word in the FMI function that reads or writes this variable."""
    return variable.fmi_type or ("Integer" if variable.kind == "Enumeration" else variable.kind)


def address(values: Buffer) -> ctypes.c_void_p:
    """Where an array begins; the caller keeps it alive."""
    return ctypes.c_void_p(values.ctypes.data)


def to_ctypes(variable: FmuVariable, kind: Any, value: Value) -> Any:
    """One value as a ctypes object."""
    if variable.kind == "String":
        return ctypes.c_char_p(str(value).encode())
    if variable.is_real:
        return kind(float(value))
    cell = kind(int(value))
    if cell.value != int(value) and variable.kind != "Boolean":
        raise Problem(f"{variable.name}: {value} does not fit into {variable.fmi_type or variable.kind}")
    return cell


def from_ctypes(variable: FmuVariable, cell: Any) -> Value:
    """The value in a ctypes object."""
    if variable.kind == "String":
        return (cell.value or b"").decode(errors="replace")
    value: Value = cell.value
    return bool(value) if variable.kind == "Boolean" else value


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

    call: BoundCall
    address: int
    component: int
    fmi: int
    references: NDArray[np.uint32]
    orders: NDArray[np.int32] | None
    fmu_values: Buffer
    values: Buffer
    sets: bool
    names: Sequence[str]

    def __call__(self) -> None:
        if self.fmu_values.dtype == self.values.dtype:
            self.call()
        elif self.sets:
            with np.errstate(over="ignore"):  # what is too large in single precision becomes infinite
                self.fmu_values[:] = self.values
            check_range(self.values, self.fmu_values, self.names)
            self.call()
        else:
            self.call()
            self.values[:] = self.fmu_values
            check_range(self.fmu_values, self.values, self.names)

    def check_status(self, status: int) -> None:
        """Raise what the call from Python would raise; after a call from C, which does not judge."""
        if status == OUT_OF_RANGE:
            if self.sets:
                self.fmu_values[:] = self.values
                check_range(self.values, self.fmu_values, self.names)
            self.values[:] = self.fmu_values
            check_range(self.fmu_values, self.values, self.names)
        self.call.check_status(status)


@dataclass(frozen=True)
class DirectionalDerivative:
    """A call of fmiXGetDirectionalDerivative with all its arguments fixed.

    call, address, component, fmi   as in `Access`
    of, by                          value references of outputs, shape (m,), and of inputs, shape (n,)
    seed, into                      the direction in which the inputs move, and how the outputs change
    """

    call: BoundCall
    address: int
    component: int
    fmi: int
    unknowns: NDArray[np.uint32]
    knowns: NDArray[np.uint32]
    seed: Buffer
    sensitivity: Buffer

    def __call__(self) -> None:
        self.call()

    def check_status(self, status: int) -> None:
        """Raise what the call from Python would raise; after a call from C, which does not judge."""
        self.call.check_status(status)


@dataclass(frozen=True)
class StepCalls:
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
    check_step: Callable[[int], None]
    check_get: Callable[[int], None]
    check_set: Callable[[int], None]
    clock: NDArray[np.float64]


def compatible_buffer(values: Buffer, count: int, kind: Any) -> Buffer:
    """`values` itself where an FMU of this ctypes kind can use it directly, else an array that it can use."""
    if len(values) < count or not values.flags.c_contiguous or values.dtype not in (np.float64, np.int32):
        raise ValueError(f"expected {count} contiguous values, got shape {values.shape} of {values.dtype}")
    return values[:count] if values.dtype == np.dtype(kind) else np.zeros(count, kind)


def check_range(before: Buffer, after: Buffer, names: Sequence[str]) -> None:
    """Refuse whole numbers that the other type cannot hold; real ones may be rounded."""
    if after.dtype.kind in "iu" and not np.array_equal(before, after):
        at = int(np.flatnonzero(before != after)[0])
        raise Problem(f"{names[at]}: {before[at]} does not fit into {after.dtype}")
