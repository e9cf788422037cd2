"""Binding of the C engine: the compiled library, its structures from native/engine.h, and callbacks.

The library is in the wheel. In a checkout it is compiled on first use, by the compiler of the package
`ziglang`, and kept in the user's cache.
"""

from __future__ import annotations

import ctypes
import re
from collections.abc import Callable, Iterable, Sequence
from functools import cache, partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Protocol, cast

import numpy as np
from numpy.typing import NDArray

from orchestrator.base import compiler
from orchestrator.base.compiler import host, shared_library
from orchestrator.base.errors import AtEvent, Discarded, Problem
from orchestrator.base.units import LinearTransformation
from orchestrator.fmi.calls import Access, Call, DirectionalDerivative, ExchangeCall, Slave
from orchestrator.fmi.description import WHOLE
from orchestrator.fmi.instance import BoundCall, FmuInstance
from orchestrator.fmi.messages import WARNING, Log

FOLDER = Path(__file__).parent / "native"
TYPES = {
    "double": ctypes.c_double,
    **{f"{u}int{n}_t": getattr(ctypes, f"c_{u}int{n}") for u in ("", "u") for n in (8, 32, 64)},
}
ELEMENTS = tuple(  # types of values in an FMU, in the order of the enumeration in engine.h
    np.dtype(name) for name in ("f8", "f4", "i1", "u1", "i2", "u2", "i4", "u4", "i8", "u8", "?")
)
EXCHANGES = {"SetTime": "SET_TIME", "CompletedIntegratorStep": "COMPLETED_STEP"}  # others: VECTOR


recipe = partial(compiler.recipe, "engine", FOLDER)  # for a platform


@cache
def library() -> ctypes.CDLL:
    """The compiled library; raises Problem if it cannot be compiled or loaded."""
    try:
        engine = ctypes.CDLL(str(shared_library(*recipe(host()))))
    except (OSError, Problem) as error:
        raise Problem(f"the engine is not compiled: {error}") from None
    for name in re.findall(r"EXPORT (?:double|Real) (\w+)\(", _header()):
        getattr(engine, name).restype = ctypes.c_double
    return engine


# ---- structures


class Struct(ctypes.Structure):
    """A structure of engine.h; other attributes than its fields are refused."""

    __slots__ = ()


@cache
def _header() -> str:
    return without_comments((FOLDER / "engine.h").read_text(encoding="utf-8"))


def without_comments(header: str) -> str:
    """C code without its comments."""
    return re.sub(r"/\*.*?\*/", "", header, flags=re.DOTALL)


@cache
def engine_h() -> Any:
    """All structures and constants of engine.h, by name; a pointer is an address."""
    return structures(_header())


def structures(header: str, width: int = 1) -> Any:
    """All structures and constants of a C header without comments, by name; a pointer is an address.

    width   number of machines; with more than one, a structure has its Reals and Masks first
    """
    real, mask = (
        (ctypes.c_double, ctypes.c_int32) if width == 1 else (ctypes.c_double * width, ctypes.c_int64 * width)
    )
    names_of_header: dict[str, Any] = {**TYPES, "WIDTH": width, "Real": real, "Mask": mask}
    for names in re.findall(r"enum \{([^}]*)\}", header):
        value = -1
        for entry in names.split(","):
            name, _, number = (part.strip() for part in entry.partition("="))
            value = int(number) if number else value + 1
            names_of_header[name] = value
    for name, body in re.findall(r"typedef struct (\w+) \{(.*?)\} \1;", header, flags=re.DOTALL):
        fields = [
            field for line in body.split(";") if line.strip() for field in _fields(line, names_of_header)
        ]
        if width > 1 and any(kind in (real, mask) or hasattr(kind, "aligned") for _, kind in fields):
            size = ctypes.sizeof(type(name, (Struct,), {"_fields_": fields}))
            fields.append(("aligned", ctypes.c_byte * (-size % ctypes.sizeof(real))))
        names_of_header[name] = type(name, (Struct,), {"_fields_": fields, "__slots__": ()})
    return SimpleNamespace(**names_of_header)


def _fields(declaration: str, header: dict[str, Any]) -> Iterable[tuple[str, Any]]:
    """The fields of one declaration, such as `const double *a, b[DEGREE + 1]`."""
    type_name, names = declaration.replace("const ", "").strip().split(None, 1)
    for name in (part.strip() for part in names.split(",")):
        size = re.search(r"\[(\w+)( \+ 1)?\]", name)
        if name.startswith("*"):
            yield name.lstrip("*"), ctypes.c_void_p
        elif size:
            yield name[: size.start()], header[type_name] * (header[size[1]] + bool(size[2]))
        else:
            yield name, header[type_name]


# members of structures that belong to one process or to one scenario and stop time
OF_PROCESS = frozenset(
    (
        *("total", "patience", "spent", "counted", "tick", "busy", "pause", "threads"),
        *("divided_count", "next_divided", "samples", "interval"),
    )
)


def _views(struct: Struct) -> list[NDArray[np.uint8]]:
    """The members of a structure that are no addresses, as writable bytes."""
    whole = np.frombuffer(memoryview(struct), np.uint8)
    return [whole[first : first + size] for first, size in _spans(type(struct))]


@cache
def _spans(kind: Any) -> tuple[tuple[int, int], ...]:
    """Offset and size of the members that are no addresses."""
    spans = list[tuple[int, int]]()
    for name, member in kind._fields_:
        first = getattr(kind, name).offset
        if isinstance(member, type) and issubclass(member, Struct):
            spans += [(first + inner, size) for inner, size in _spans(member)]
        elif member is not ctypes.c_void_p and name not in OF_PROCESS:
            spans.append((first, ctypes.sizeof(member)))
    return tuple(spans)


# ---- one simulation


class StatusCheck(Protocol):
    """Raises the Problem that a status means."""

    def check_status(self, status: int, /) -> None: ...


CHECK = ctypes.CFUNCTYPE(ctypes.c_int32, ctypes.c_void_p, ctypes.c_int32, ctypes.c_int32)
Allocate = Callable[[str, int], Any]  # (name, bytes) -> writable buffer
PYTHON = ctypes.CFUNCTYPE(ctypes.c_int32, ctypes.c_int32, ctypes.c_int32, ctypes.c_double, ctypes.c_double)


def in_process(_: str, size: int) -> bytearray:
    """Memory of this process only."""
    return bytearray(size)


class Binding:
    """A `Simulation` of engine.h: makes addresses and instructions for its members, handles its callbacks.

    simulation   the structure
    allocate     makes the memory that is read after a crash
    components   the `RunningComponent` of each index, for callbacks about a component
    withdraw     called before a step is repeated
    master       called with start and length of a step [s] that Python takes
    instant      called with the time [s] of an instant of events, and True if its step cannot be repeated
    inside       called with a component and the time [s] of an event of it alone, inside of a step
    logs         of the FMUs that may change the floating-point environment, in the order of `components`
    problem      the exception that ended the last call; None if there was none

    All Python objects whose addresses C has are kept alive. The floating-point environment is that in which
    the binding is made.
    """

    def __init__(self, allocate: Allocate = in_process) -> None:
        """allocate: makes the memory of the structure and of the recorded block, see `isolated`."""
        self.h, self.allocate = engine_h(), allocate
        size = ctypes.sizeof(self.h.Simulation)
        self.simulation = self.h.Simulation.from_buffer(allocate("simulation", size))
        self.components: Sequence[Any] = ()
        self.withdraw: Callable[[], None] = lambda: None
        self.master: Callable[[float, float], None] = lambda _t, _h: None
        self.instant: Callable[[float, bool], None] = lambda _t, _never: None
        self.inside: Callable[[str, float], None] = lambda _name, _t: None
        self.logs: Sequence[Log] = ()
        self._checks: dict[int, StatusCheck] = {}
        self._calls: list[Call] = []
        self._constants: list[Any] = []
        self.problem: BaseException | None = None
        callbacks = CHECK(self._check_status), PYTHON(self._call_python)
        self._alive: list[Any] = [*callbacks]
        for name, callback in zip(("check_status", "call_python"), callbacks, strict=True):
            setattr(self.simulation, name, ctypes.cast(callback, ctypes.c_void_p).value)
        self.call("environment_begin")
        self._called: Slave | FmuInstance | None = None
        address = ctypes.c_void_p(ctypes.addressof(self.simulation))
        self._check_environment = partial(library().environment_check, address)

    def call(self, function: str, *arguments: Any) -> None:
        """Call a function of the engine on this simulation; raises the exception that ended the run."""
        verdict = getattr(library(), function)(ctypes.byref(self.simulation), *arguments)
        if verdict:
            raise self.problem or Problem("the run stopped")

    def run(self, program: Any) -> None:
        """Run a program."""
        self.call("program_run", ctypes.byref(program))

    def restore_environment(self, called: Slave | FmuInstance | None = None) -> None:
        """Restore the floating-point environment after a call of an FMU, which gets a warning."""
        self._called = called
        self._check_environment()
        self._called = None

    def _warn_of_change(self, call: int | None, component: int) -> None:
        """Give a warning to the FMU that has changed the environment, or to the first of several."""
        logs = self.logs if component < 0 else [self.logs[component]]
        logs = [self._called.log] if self._called else logs
        if isinstance(check := self._checks.get(call or 0), Access | BoundCall):
            logs = [(check.call if isinstance(check, Access) else check).instance.log]
        who = " or ".join(["the FMU", *(log.component for log in logs[1:])])
        what = "the floating-point environment (rounding, flushing to zero or traps)"
        text = f"{who} changed {what}, now restored"
        if logs and all(message.text != text for message in logs[0].messages):
            logs[0].add(WARNING, text)

    # ---- addresses

    def at(self, array: NDArray[Any]) -> int:
        """The address of an array that C uses."""
        if not array.flags.c_contiguous:
            raise ValueError("expected a contiguous array")
        self._alive.append(array)
        return array.ctypes.data

    def constant(self, array: NDArray[Any]) -> int:
        """The address of an array that follows from scenario and stop time, which no state has."""
        self._constants.append(array)
        return array.ctypes.data

    def memory(self) -> list[Any]:
        """What C has computed so far, as writable views without addresses, in the order of allocation."""
        parts: list[Any] = _views(self.simulation)
        for owned in self._alive:
            if isinstance(owned, np.ndarray):
                parts += [] if owned.dtype == np.uint64 else [owned.reshape(-1)]  # addresses
            elif isinstance(owned, Struct):
                parts += _views(owned)
            elif isinstance(owned, ctypes.Array) and issubclass(owned._type_, Struct):
                parts += [view for struct in owned for view in _views(struct)]
        return parts

    def all_at(self, owner: object, names: str) -> dict[str, int]:
        """The addresses of arrays that are attributes of the same names."""
        return {name: self.at(getattr(owner, name)) for name in names.split()}

    def array(self, struct_type: Any, values: Sequence[Any]) -> Any:
        """A ctypes array of structures of one type."""
        structures = (struct_type * max(len(values), 1))(*values)
        self._alive.append(structures)
        return structures

    def pointer(self, structure: Any) -> int:
        """The address of a structure."""
        self._alive.append(structure)
        return ctypes.addressof(structure)

    # ---- calls

    def program(self, calls: Sequence[Call | ExchangeCall]) -> Any:
        """Calls as a program for C, which makes calls of FMI functions itself and others through Python."""
        instructions = self.array(self.h.Instruction, [self._instruction(call) for call in calls])
        return self.h.Program(len(calls), ctypes.addressof(instructions))

    def joined(self, programs: Sequence[Any]) -> Any:
        """The instructions of some programs as one."""
        parts = [(self.h.Instruction * p.count).from_address(p.instructions) for p in programs if p.count]
        count = sum(map(len, parts))
        instructions = (self.h.Instruction * max(count, 1))(*(i for part in parts for i in part))
        self._constants.append(instructions)
        return self.h.Program(count, ctypes.addressof(instructions))

    def _instruction(self, call: Call | ExchangeCall) -> Any:
        if isinstance(call, Access):
            return self.h.Instruction(self.h.ACCESS, 0, self._access(call))
        if isinstance(call, ExchangeCall):
            return self.h.Instruction(self.h.EXCHANGE, 0, self._exchange_call(call))
        if isinstance(call, self.h.Instruction):
            return call
        return self.h.Instruction(self.h.PYTHON, self._register(call), None)

    def _register(self, call: Call) -> int:
        self._calls.append(call)
        return len(self._calls) - 1

    def _access(self, call: Access) -> int:
        struct = self.h.Access(
            **call.call.for_c(),
            references=self.at(call.references),
            orders=None if call.orders is None else self.at(call.orders),
            fmu_values=self.at(call.fmu_values),
            values=self.at(call.values),
            count=len(call.names),
            reference_count=len(call.references),
            type=ELEMENTS.index(call.fmu_values.dtype),
            array=self.array_of(call.values),
            sets=call.sets,
        )
        return self.checked(struct, call)

    def _exchange_call(self, call: ExchangeCall) -> int:
        struct = self.h.ExchangeCall(
            **call.call.for_c(),
            values=self.at(call.values),
            clock=ctypes.addressof(call.call.instance.log.clock),
            kind=getattr(self.h, EXCHANGES.get(call.call.function, "VECTOR")),
            count=len(call.values),
        )
        return self.checked(struct, call.call)

    def value_table(self, maps: Iterable[tuple[int, int, LinearTransformation]]) -> int | None:
        """The address of a `ValueTable`; maps: indices of source and target, and the map between them."""
        rows = [(*ends, *entry) for *ends, linear in maps for entry in linear.table]
        rows = [row for row in rows if row[2] == int(row[2]) and abs(row[2]) <= WHOLE]
        if any(abs(after) > WHOLE for *_, after in rows):
            raise Problem(f"a mapping of values: expected whole numbers of at most {WHOLE}")
        arrays = [self.at(np.array(column, np.int64)) for column in zip(*rows, strict=True)]
        return self.pointer(self.h.ValueTable(*arrays, len(rows))) if rows else None

    def array_of(self, values: NDArray[Any]) -> int:
        """REAL or INTEGER, the array of the run that values belong to."""
        return cast(int, self.h.REAL if values.dtype == np.float64 else self.h.INTEGER)

    def checked(self, structure: Any, check: StatusCheck) -> int:
        """The address of a structure; `check` judges the statuses of its calls."""
        self._checks[ctypes.addressof(structure)] = check
        return self.pointer(structure)

    def fill_derivative(self, struct: Any, call: Call, seed: NDArray[Any], result: NDArray[Any]) -> None:
        """Fill a `Derivative` inside another structure; `seed` and `result` are the arrays of the call."""
        struct.seed, struct.result = self.at(seed), self.at(result)
        struct.known_count, struct.unknown_count = len(seed), len(result)
        if isinstance(call, DirectionalDerivative):
            for name, value in call.call.for_c().items():
                setattr(struct, name, value)
            struct.unknowns, struct.knowns = self.at(call.unknowns), self.at(call.knowns)
            struct.unknown_references, struct.known_references = len(call.unknowns), len(call.knowns)
            self.checked(struct, call.call)
        else:
            struct.index = self._register(call)

    # ---- called from C

    def _check_status(self, call: int | None, component: int, status: int) -> int:
        """The verdict on a status that is not OK; see CheckStatus in engine.h."""

        def check() -> None:
            if status == self.h.WITHDRAWN:
                self.withdraw()
            elif status == self.h.CHANGED:
                self._warn_of_change(call, component)
            elif call in self._checks:
                self._checks[call].check_status(status)
            else:
                self.components[component].check_status(call, status)

        return self._verdict(check)

    def _call_python(self, request: int, index: int, t: float, h: float) -> int:
        if request == self.h.CALL:
            return self._verdict(self._calls[index])
        if request == self.h.MASTER:
            return self._verdict(lambda: self.master(t, h))
        if request == self.h.INSTANT:
            return self._verdict(lambda: self.instant(t, index < 0))
        component = self.components[index]
        if request == self.h.ALONE:
            return self._verdict(lambda: self.inside(component.slave.name, t))
        if request == self.h.STEP:
            return self._verdict(lambda: component.slave.step(t, h))
        return self._verdict(component.save if request == self.h.SAVE else component.restore)

    def _verdict(self, call: Call) -> int:
        """Make a call and return the verdict for C; `call` raises the exception after C has returned."""
        try:
            call()
        except Discarded as problem:
            self.problem, self.simulation.reached = problem, problem.reached
            return cast(int, self.h.DISCARDED)
        except AtEvent as stop:
            self.simulation.reached = stop.reached
            return cast(int, self.h.AT_EVENT)
        except Problem as problem:
            self.problem = problem
            return cast(int, self.h.STOP)
        except BaseException as problem:
            self.problem = problem
            return cast(int, self.h.ABORT)
        return cast(int, self.h.CONTINUE)
