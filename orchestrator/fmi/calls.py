"""Interface of a running component (`Slave`), and FMI calls with fixed arguments for Python and C.

A call gets or sets several variables of one type. It is bound once to value references and to a slice of a
NumPy array, so that each execution is a single call into the FMU without memory allocation. Types other than
Float64 and Int32 are converted.
"""

import ctypes
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from orchestrator.base.errors import Problem
from orchestrator.fmi.description import FmuVariable, Value
from orchestrator.fmi.instance import BoundCall
from orchestrator.fmi.interface import FmuInterface
from orchestrator.fmi.messages import Log
from orchestrator.worker.calls import CallSlot

Buffer = NDArray[Any]  # float64 for floating-point types; int64 for integers, Enumeration and Boolean
Call = Callable[[], None]


class Slave(Protocol):
    """Protocol of a running component, as masters use it: an FMU or a Python object.

    All variables of one reader or writer must have the same `function_type`.

    setup                     set up the experiment; times in [s]
    enter, exit               enter and leave initialisation mode
    set, configure            set a variable, or an array by all its values; set structural parameters
    reads                     has the component a function that gets a variable?
    reader, writer            calls that get variables into an array, or set them from an array
    output_derivative_reader, input_derivative_writer   the same for first time derivatives
    directional_derivative    call that computes the change of unknowns when knowns change along `seed`
    input_degree              highest degree (0, 1 or 3), up to `degree`, of a polynomial as input
    outputs_with_derivatives  those of the outputs whose first time derivatives are available
    step                      raises Discarded for an incomplete step, Ended if the FMU ends the simulation
    after_rollback            discard the messages and the status of a step that is repeated
    save                      save the state, in a new object or over an earlier one
    restore, free_state       restore a saved state, free it
    """

    name: str
    interface: FmuInterface
    log: Log

    def setup(self, start: float, stop: float, tolerance: float | None) -> None: ...
    def enter(self) -> None: ...
    def exit(self) -> None: ...
    def get(self, variable: str) -> Value: ...
    def reads(self, variable: FmuVariable) -> bool: ...
    def set(self, variable: str, value: Value | Sequence[Value]) -> None: ...
    def configure(self, sizes: Mapping[str, Any]) -> None: ...
    def reader(self, variables: Sequence[str], into: Buffer) -> Call: ...
    def writer(self, variables: Sequence[str], values: Buffer) -> Call: ...
    def output_derivative_reader(self, variables: Sequence[str], into: Buffer) -> Call: ...
    def input_derivative_writer(
        self, variables: Sequence[str], derivatives: Buffer, orders: Sequence[int] = ()
    ) -> Call: ...
    def directional_derivative(
        self, unknowns: Sequence[str], knowns: Sequence[str], seed: Buffer, into: Buffer
    ) -> Call: ...
    def input_degree(self, variable: str, degree: int) -> int: ...
    def outputs_with_derivatives(self, outputs: Sequence[str]) -> Sequence[str]: ...
    def step(self, t: float, h: float) -> None: ...
    def after_rollback(self) -> None: ...
    def save(self, state: Any = None) -> Any: ...
    def restore(self, state: Any) -> None: ...
    def free_state(self, state: Any) -> None: ...
    def close(self) -> None: ...


MakeCall = Callable[[Sequence[str], Buffer], Call]


def calls_by_type(slave: Slave, names: Sequence[str], values: Buffer, make: MakeCall) -> list[Call]:
    """Calls for `names`, one for each run of consecutive names of the same FMI type.

    values   shape (n,), in the order of the names
    """
    calls, first = list[Call](), 0
    for _, group in groupby(names, key=lambda name: slave.interface.variables[name].function_type):
        of_type = list(group)
        calls.append(make(of_type, values[first : first + len(of_type)]))
        first += len(of_type)
    return calls


def set_starts(slave: Slave, start: Mapping[str, Value]) -> None:
    """Set start values: structural parameters first, in one configuration mode; arrays whole.

    start   values of all elements of an array, or of none
    """
    variables = slave.interface.variables
    sizes = {n: v for n, v in start.items() if variables[n].causality == "structuralParameter"}
    if sizes:
        slave.configure(sizes)
    for name, value in start.items():
        array = variables[name].array
        if array is None and name not in sizes:
            slave.set(name, value)
        elif array and variables[name].position == 0:
            slave.set(array.name, [start[element] for element in array.elements])


def address(values: Buffer) -> ctypes.c_void_p:
    """Address of an array, which the caller must keep alive."""
    return ctypes.c_void_p(values.ctypes.data)


def to_ctypes(variable: FmuVariable, ctype: Any, value: Value) -> Any:
    """A value as an element of an array of a ctypes type."""
    if variable.kind in TEXTS:
        return str(value).encode()
    if variable.is_real:
        return float(value)
    if ctype(int(value)).value != int(value) and variable.kind != "Boolean":
        raise Problem(f"{variable.name}: expected a value in the range of {variable.type}, got {value}")
    return int(value)


def from_ctypes(variable: FmuVariable, value: Any) -> Value:
    """The value of an element of a ctypes array of numbers."""
    return bool(value) if variable.kind == "Boolean" else value


TEXTS = ("String", "Binary")  # kinds of values that are no numbers; a Binary is a text of hexadecimal digits
OUT_OF_RANGE = -1  # status of a call from C: an integer is out of the range of the target type


@dataclass(frozen=True)
class Access:
    """A get or set function of an FMU with fixed arguments, executable from Python and from C.

    call         bound call from Python, which checks the status
    references   value references, shape (m,); those of an array are one for all its elements
    orders       orders of derivatives, shape (m,); None for values
    fmu_values   values in the type of the FMU, shape (n,)
    values       values of the run, shape (n,); the same array as `fmu_values` if the types agree
    sets         True for a set function
    names        names of the variables, n
    """

    call: BoundCall
    references: NDArray[np.uint32]
    orders: NDArray[np.int32] | None
    fmu_values: Buffer
    values: Buffer
    sets: bool
    names: Sequence[str]

    def __call__(self) -> None:
        convert = self.fmu_values.dtype != self.values.dtype
        if convert and self.sets:
            self._convert()
        self.call()
        if convert and not self.sets:
            self._convert()

    def _convert(self) -> None:
        """Copy values to or from the type of the FMU; integers must be in the range of the other type."""
        before, after = (self.values, self.fmu_values) if self.sets else (self.fmu_values, self.values)
        with np.errstate(over="ignore"):  # overflow to single precision gives infinity
            after[:] = before
        check_range(before, after, self.names)

    def check_status(self, status: int) -> None:
        """Raise the exception for the status of a call from C."""
        if status == OUT_OF_RANGE:
            self._convert()
        self.call.check_status(status)


@dataclass(frozen=True)
class DirectionalDerivative:
    """GetDirectionalDerivative with fixed arguments, executable from Python and from C.

    unknowns, knowns   value references, shape (m,) and shape (n,)
    """

    call: BoundCall
    unknowns: NDArray[np.uint32]
    knowns: NDArray[np.uint32]

    def __call__(self) -> None:
        self.call()


@dataclass(frozen=True)
class ExchangeCall:
    """A function of Model Exchange with fixed arguments, executable from C.

    values   time [s], shape (1,); a vector (of states or event indicators), shape (n,); or the results of a
             completed step, shape (2,): event needed, end of the simulation
    """

    call: BoundCall
    values: NDArray[np.float64]


@dataclass(frozen=True)
class StepCalls:
    """How C steps an instance, and saves and restores its state.

    members   of the structure of a component in engine.h: instance, addresses of functions and of results
    checks    address of a function -> raises the exception for a status of it; that of `do_step` is 0
    slot      the call in progress, see `worker.calls`
    """

    members: Mapping[str, int]
    checks: Mapping[int, Callable[[int], None]]
    slot: CallSlot


def compatible_buffer(values: Buffer, count: int, ctype: Any) -> Buffer:
    """`values` if an FMU can access it directly as values of a ctypes type, or else a new array."""
    if len(values) < count or not values.flags.c_contiguous or values.dtype not in (np.float64, np.int64):
        raise ValueError(f"expected {count} contiguous values, got shape {values.shape} of {values.dtype}")
    return values[:count] if values.dtype == np.dtype(ctype) else np.zeros(count, ctype)


def check_range(before: Buffer, after: Buffer, names: Sequence[str]) -> None:
    """Refuse integers out of the range of the target type; floating-point values may be rounded."""
    if after.dtype.kind in "iu" and not np.array_equal(before, after):
        k = int(np.flatnonzero(before != after)[0])
        raise Problem(f"{names[k]}: expected a value in the range of {after.dtype}, got {before[k]}")
