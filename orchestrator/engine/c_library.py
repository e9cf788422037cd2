"""The engine in C: compiled on first use, its structures read from native/engine.h, its calls into Python.

The compiler is that of the package `ziglang`; what was compiled is kept in the user's cache.
"""

from __future__ import annotations

import ctypes
import re
from collections.abc import Callable, Iterable, Sequence
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Protocol, cast

import numpy as np
from numpy.typing import NDArray

from orchestrator.base.compiler import SUFFIX, shared_library
from orchestrator.base.errors import Discarded, Problem
from orchestrator.fmi.calls import Access, Call, DirectionalDerivative

FOLDER = Path(__file__).parent / "native"
FLAGS = (
    *("-std=gnu11", "-O2", "-g0", "-fPIC", "-shared", "-pthread", "-fvisibility=hidden"),
    *("-Wall", "-Wextra", "-Wconversion", "-Wshadow", "-Werror"),
    "-ffp-contract=off",  # the same numbers on each processor
    "-mcpu=baseline",  # the cache may be shared by machines whose processors know different instructions
)
TYPES = {
    "double": ctypes.c_double,
    **{f"{u}int{n}_t": getattr(ctypes, f"c_{u}int{n}") for u in ("", "u") for n in (8, 32, 64)},
}
ELEMENTS = tuple(  # types of values in an FMU, in the order of the enumeration in engine.h
    np.dtype(name) for name in ("f8", "f4", "i1", "u1", "i2", "u2", "i4", "u4", "i8", "u8", "?")
)


def sources() -> list[str]:
    """The C files, by name."""
    return sorted(path.name for path in FOLDER.glob("*.c"))


@cache
def library() -> ctypes.CDLL:
    """The compiled code; a Problem where there is none."""
    code = {path.name: path.read_bytes() for path in FOLDER.glob("*.[ch]")}
    try:
        found = ctypes.CDLL(str(shared_library(f"engine{SUFFIX}", code, [*FLAGS, *sources()])))
    except (OSError, Problem) as error:
        how = "install the Python package ziglang, whose compiler makes it (pip install ziglang)"
        raise Problem(f"the engine is not compiled: {error}; {how}") from None
    for name in re.findall(r"EXPORT double (\w+)\(", _header()):
        getattr(found, name).restype = ctypes.c_double
    return found


# ---- structures


class Struct(ctypes.Structure):
    """A structure of engine.h; it has its fields and nothing else."""

    __slots__ = ()


@cache
def _header() -> str:
    text = (FOLDER / "engine.h").read_text(encoding="utf-8")
    return re.sub(r"/\*.*?\*/", "", text, flags=re.DOTALL)


@cache
def engine_h() -> Any:
    """All structures and constants of engine.h, by name; a pointer is an address."""
    found: dict[str, Any] = {}
    for names in re.findall(r"enum \{([^}]*)\}", _header()):
        value = -1
        for entry in names.split(","):
            name, _, given = (part.strip() for part in entry.partition("="))
            value = int(given) if given else value + 1
            found[name] = value
    for name, body in re.findall(r"typedef struct (\w+) \{(.*?)\} \1;", _header(), flags=re.DOTALL):
        fields = [field for line in body.split(";") if line.strip() for field in _fields(line, found)]
        found[name] = type(name, (Struct,), {"_fields_": fields, "__slots__": ()})
    return SimpleNamespace(**found)


def _fields(declaration: str, known: dict[str, Any]) -> Iterable[tuple[str, Any]]:
    """The fields of one declaration, such as `const double *a, b[DEGREE + 1]`."""
    kind, names = declaration.replace("const ", "").strip().split(None, 1)
    for name in (part.strip() for part in names.split(",")):
        size = re.search(r"\[(\w+) \+ 1\]", name)
        if name.startswith("*"):
            yield name.lstrip("*"), ctypes.c_void_p
        elif size:
            yield name[: size.start()], (TYPES.get(kind) or known[kind]) * (known[size[1]] + 1)
        else:
            yield name, TYPES.get(kind) or known[kind]


# ---- what C calls, and what calls Python


class Checks(Protocol):
    """Raises what there is to say about a status."""

    def check_status(self, status: int, /) -> None: ...


CHECK = ctypes.CFUNCTYPE(ctypes.c_int32, ctypes.c_void_p, ctypes.c_int32, ctypes.c_int32)
PYTHON = ctypes.CFUNCTYPE(ctypes.c_int32, ctypes.c_int32, ctypes.c_int32, ctypes.c_double, ctypes.c_double)


class Binding:
    """A `Simulation` of engine.h, and what it is filled with: addresses, instructions, and calls into Python.

    simulation   the structure
    components   what C asks to step, save and restore, or whose steps it reports, see `RunningComponent`
    withdraw     called when a step is going to be repeated

    It keeps alive what C has the addresses of.
    """

    def __init__(self) -> None:
        self.h = engine_h()
        self.simulation = self.h.Simulation()
        self.components: Sequence[Any] = ()
        self.withdraw: Callable[[], None] = lambda: None
        self._checks: dict[int, Checks] = {}
        self._calls: list[Call] = []
        self._problem: BaseException | None = None
        callbacks = CHECK(self._check_status), PYTHON(self._call_python)
        self._alive: list[Any] = [*callbacks]
        for name, callback in zip(("check_status", "call_python"), callbacks, strict=True):
            setattr(self.simulation, name, ctypes.cast(callback, ctypes.c_void_p).value)

    def call(self, function: str, *arguments: Any) -> None:
        """Call a function of the engine on this simulation; raises what ended it."""
        verdict = getattr(library(), function)(ctypes.byref(self.simulation), *arguments)
        if verdict:
            raise self._problem or Problem("the run stopped")

    # ---- addresses

    def at(self, array: NDArray[Any]) -> int:
        """The address of an array that C uses."""
        if not array.flags.c_contiguous:
            raise ValueError("expected a contiguous array")
        self._alive.append(array)
        return array.ctypes.data

    def all_at(self, owner: object, names: str) -> dict[str, int]:
        """The addresses of arrays that are attributes of the same names."""
        return {name: self.at(getattr(owner, name)) for name in names.split()}

    def array(self, kind: Any, values: Sequence[Any]) -> Any:
        """Structures of one kind side by side, as a ctypes array; C gets its address."""
        found = (kind * max(len(values), 1))(*values)
        self._alive.append(found)
        return found

    def pointer(self, structure: Any) -> int:
        """The address of a structure."""
        self._alive.append(structure)
        return ctypes.addressof(structure)

    # ---- calls

    def program(self, calls: Sequence[Call]) -> Any:
        """Calls as instructions; C makes those of FMUs itself and asks Python for the others."""
        instructions = self.array(self.h.Instruction, [self._instruction(call) for call in calls])
        return self.h.Program(len(calls), ctypes.addressof(instructions))

    def _instruction(self, call: Call) -> Any:
        if isinstance(call, Access):
            return self.h.Instruction(self.h.ACCESS, 0, self._access(call))
        instruction = getattr(call, "instruction", None)  # a `Link` or an `AlgebraicLoop`
        if instruction is not None:
            return instruction(self)
        return self.h.Instruction(self.h.PYTHON, self._in_python(call), None)

    def _in_python(self, call: Call) -> int:
        self._calls.append(call)
        return len(self._calls) - 1

    def _access(self, call: Access) -> int:
        made = self.h.Access(
            function=call.address,
            instance=call.component,
            references=self.at(call.references),
            orders=None if call.orders is None else self.at(call.orders),
            own=self.at(call.fmu_values),
            values=self.at(call.values),
            count=len(call.names),
            fmi=call.fmi,
            type=ELEMENTS.index(call.fmu_values.dtype),
            bank=self.bank(call.values),
            sets=call.sets,
        )
        return self.checked(made, call)

    def bank(self, values: NDArray[Any]) -> int:
        """Whether an array is one of Real values or of whole numbers."""
        return cast(int, self.h.REAL if values.dtype == np.float64 else self.h.WHOLE)

    def checked(self, structure: Any, by: Checks) -> int:
        """The address of a structure whose statuses are to be judged `by` something."""
        self._checks[ctypes.addressof(structure)] = by
        return self.pointer(structure)

    def fill_derivative(self, made: Any, call: Call, seed: NDArray[Any], into: NDArray[Any]) -> None:
        """Fill a `Derivative`, which stays where it is; `seed` and `into` are those of the call."""
        made.seed, made.into, made.count, made.outputs = self.at(seed), self.at(into), len(seed), len(into)
        if isinstance(call, DirectionalDerivative):
            made.function, made.instance, made.fmi = call.address, call.component, call.fmi
            made.of, made.by = self.at(call.unknowns), self.at(call.knowns)
            self.checked(made, call)
        else:
            made.index = self._in_python(call)

    # ---- called from C

    def _check_status(self, where: int | None, component: int, status: int) -> int:
        """What to do after a status that is not OK."""

        def check() -> None:
            if status == self.h.WITHDRAWN:
                self.withdraw()
            elif where in self._checks:
                self._checks[where].check_status(status)
            else:
                self.components[component].check_status(where, status)

        return self._verdict(check)

    def _call_python(self, what: int, index: int, t: float, h: float) -> int:
        if what == self.h.CALL:
            return self._verdict(self._calls[index])
        component = self.components[index]
        if what == self.h.STEP:
            return self._verdict(lambda: component.slave.step(t, h))
        return self._verdict(component.save if what == self.h.SAVE else component.restore)

    def _verdict(self, call: Call) -> int:
        """What C is to do after a call; an exception waits until C has returned."""
        try:
            call()
        except Discarded as problem:
            self._problem, self.simulation.reached = problem, problem.reached
            return cast(int, self.h.DISCARDED)
        except Problem as problem:
            self._problem = problem
            return cast(int, self.h.STOP)
        except BaseException as problem:
            self._problem = problem
            return cast(int, self.h.ABORT)
        return cast(int, self.h.CONTINUE)
