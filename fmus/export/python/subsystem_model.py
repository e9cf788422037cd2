"""The model that an `Instance` runs: a protocol, and its implementation for a `Subsystem`.

The functions of the subsystem are evaluated by CasADi's virtual machine. Nothing is compiled, and the
optimisations of the C code (fmus.export.c_code, fmus.export.elimination) are not applied.

Also the origin of a subsystem: the name under which an FMU imports it. An origin is "module:name", or
"module:name.key" for an entry of a mapping such as VARIANTS.
"""

from __future__ import annotations

import hashlib
import importlib
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import casadi as ca
import numpy as np

from fmus.contract import Subsystem, place
from fmus.export.c_code import directional
from fmus.export.interface import Interface
from fmus.solver import Array, InputPolynomials, solve
from orchestrator.base.errors import Problem

if TYPE_CHECKING:
    from fmus.export.python.instance import InstanceState


class RunnableModel(Protocol):
    """A model that an `Instance` runs; x states, u inputs, p parameters, t time [s].

    interface    the variables
    statements   descriptions of the requirements, whose values must be positive
    start        initial states, from their start values
    rate         time derivatives of the states; empty if the model gives no derivatives. The next call may
                 overwrite the array
    observe      outputs that are not states, and the values of the requirements
    advance      states after `length` seconds, and what the solver keeps for the next step
    forward      directional derivatives of x, dx/dt and the outputs, along directions of (p, u, x).
                 With `initial`: through the initial states; else the parameters are constants, whose
                 direction is ignored
    """

    @property
    def interface(self) -> Interface: ...
    @property
    def statements(self) -> Sequence[str]: ...
    def start(self, x: Array, u: Array, p: Array) -> Array: ...
    def rate(self, x: Array, u: Array, p: Array) -> Array: ...
    def observe(self, x: Array, u: Array, p: Array, t: float) -> tuple[Array, Array]: ...
    def advance(self, s: InstanceState, inputs: InputPolynomials, length: float) -> tuple[Array, Array]: ...
    def forward(
        self, x: Array, u: Array, p: Array, direction: tuple[Array, Array, Array], initial: bool
    ) -> tuple[Array, Array, Array]: ...


class SubsystemFunctions:
    """The CasADi functions of a subsystem, which all its instances share."""

    def __init__(self, interface: Interface) -> None:
        self.interface, sym = interface, interface.equations
        arguments = [sym.x, sym.u, sym.p]
        like = {"vp": sym.p, "vu": sym.u, "vx": sym.x}
        v = {name: ca.SX.sym(name, symbol.numel()) for name, symbol in like.items()}
        du = ca.SX.sym("du", sym.u.numel())  # time derivatives of the inputs
        along = directional(sym, interface.y, v)
        seeded = [*arguments, *v.values()]
        rates = [sym.dx, ca.jacobian(sym.dx, sym.x), ca.jtimes(sym.dx, sym.u, du)]
        self.functions = {
            "rate": _function(arguments, [sym.dx]),
            "linearised": _function([*arguments, du], rates),
            "start": _function(arguments, [sym.start]),
            "observe": _function(arguments, [interface.y, sym.require]),
            "forward": _function(seeded, [v["vx"], ca.vertcat(along["vdx"], along["vy"])]),
            "start_forward": _function(seeded, [along["vx0"], ca.vertcat(along["vdx0"], along["vy0"])]),
        }


def _function(inputs: Sequence[ca.SX], outputs: Sequence[ca.SX]) -> ca.Function:
    return ca.Function("f", list(inputs), [ca.densify(value) for value in outputs], {"cse": True})


class _BoundFunction:
    """A CasADi function bound to fixed arrays, so that a call creates no objects."""

    def __init__(self, function: ca.Function) -> None:
        buffer: Any
        buffer, self._run = function.buffer()
        self._buffer = buffer  # must exist as long as self._run
        self._arguments = [np.zeros(function.size1_in(i)) for i in range(function.n_in())]
        # CasADi stores matrices by columns
        shapes = [function.size_out(i) for i in range(function.n_out())]
        self._results = [np.zeros(s if s[1] != 1 else s[0], order="F") for s in shapes]
        for i, array in enumerate(self._arguments):
            buffer.set_arg(i, array.data)
        for i, array in enumerate(self._results):
            buffer.set_res(i, array.ravel(order="K").data)

    def __call__(self, *arguments: Array) -> list[Any]:
        """Results in arrays that the next call overwrites."""
        for array, values in zip(self._arguments, arguments, strict=True):
            array[:] = values
        self._run()
        return self._results


class SubsystemModel:
    """A subsystem as `RunnableModel`, with the exact Jacobian and the solver of `fmus.solver`."""

    def __init__(self, functions: SubsystemFunctions) -> None:
        self.interface = interface = functions.interface
        self.statements = interface.equations.statements
        self.nominal = np.array([v.quantity.nominal for v in interface.states])
        self.absolute = np.array([v.quantity.absolute_scale for v in interface.states])
        self.stiff = interface.stiff
        self._p = np.zeros(len(interface.parameters))
        self._call = {name: _BoundFunction(function) for name, function in functions.functions.items()}

    def start(self, x: Array, u: Array, p: Array) -> Array:
        """See `RunnableModel`."""
        return self._call["start"](x, u, p)[0].copy()  # type: ignore[no-any-return]

    def rate(self, x: Array, u: Array, p: Array | None = None) -> Array:
        """See `RunnableModel` and `solver.OdeSystem`; the next call overwrites the array."""
        return self._call["rate"](x, u, self._p if p is None else p)[0]  # type: ignore[no-any-return]

    def linearised(self, x: Array, u: Array, du: Array) -> tuple[Array, Array, Array]:
        """See `solver.OdeSystem`; the next call overwrites the arrays."""
        f, jacobian, ft = self._call["linearised"](x, u, self._p, du)
        return f, jacobian, ft

    def observe(self, x: Array, u: Array, p: Array, t: float) -> tuple[Array, Array]:
        """See `RunnableModel`."""
        y, require = self._call["observe"](x, u, p)
        return y.copy(), require.copy()

    def advance(self, s: InstanceState, inputs: InputPolynomials, length: float) -> tuple[Array, Array]:
        """See `RunnableModel`."""
        if not s.x.size:
            return s.x, s.memory
        self._p[:] = s.p
        return solve(self, s.x, inputs, length, s.tolerance, s.memory)

    def forward(
        self, x: Array, u: Array, p: Array, direction: tuple[Array, Array, Array], initial: bool
    ) -> tuple[Array, Array, Array]:
        """See `RunnableModel`."""
        vx, results = self._call["start_forward" if initial else "forward"](x, u, p, *direction)
        return vx.copy(), results[: x.size].copy(), results[x.size :].copy()


# ---- origin ----------------------------------------------------------------------------------------


def origin(sub: Subsystem) -> str:
    """The shortest origin of a subsystem, preferably in the module or package of its function `dynamics`.

    That is where the subsystem is defined, except for one that `fmus.composition` composed.
    """
    defining = str(getattr(sub.dynamics, "__module__", "")) + "."
    origins = [
        (
            not defining.startswith(f"{module}."),
            module.split(".")[0] != defining.split(".")[0],
            len(name),
            name,
        )
        for module in list(sys.modules)
        if module != "__main__"
        for name, value in _subsystems(module)
        if value is sub
    ]
    if not origins:
        raise Problem(
            f"{sub.name}: no module has a name for this subsystem, expected one such as "
            '"package.module:NAME", from which the FMU imports it'
        )
    return min(origins)[-1]


def _subsystems(module: str) -> Iterator[tuple[str, Any]]:
    """Origin and subsystem for all subsystems of a module, including those in its mappings."""
    for name, value in list(getattr(sys.modules[module], "__dict__", {}).items()):
        if isinstance(value, Subsystem):
            yield f"{module}:{name}", value
        elif isinstance(value, Mapping) and all(isinstance(v, Subsystem) for v in value.values()):
            yield from ((f"{module}:{name}.{key}", v) for key, v in value.items())


def _told(problem: Exception, module: str) -> str:
    """Place and text of an exception of a module that is imported, in one line."""
    where = place(problem, lambda file: Path(file).stem in module.split("."))
    if isinstance(problem, SyntaxError):
        where = f"{Path(problem.filename or module).name}:{problem.lineno}: "
    name = "" if isinstance(problem, Problem) else f"{type(problem).__name__}: "
    text = problem.msg if isinstance(problem, SyntaxError) else str(problem)
    return f"{where}{name}{' '.join(text.split())}"


def import_subsystem(origin: str) -> Subsystem:
    """Import the subsystem with this origin."""
    module, _, path = origin.partition(":")
    name, _, key = path.partition(".")
    if not name:
        raise Problem(f'"{origin}" does not name a subsystem, expected a name such as "package.module:NAME"')
    try:
        sub = getattr(importlib.import_module(module), name)
        sub = sub[key] if key else sub
    except Exception as problem:  # whatever a user's module raises when it is imported
        raise Problem(
            f"{origin} cannot be imported by the Python in {sys.prefix}: {_told(problem, module)}"
        ) from None
    if not isinstance(sub, Subsystem):
        raise Problem(f"{origin} is of type {type(sub).__name__}, expected Subsystem")
    return sub


def fingerprint(interface: Interface) -> str:
    """A hash of the variables and equations that is independent of parameter values and start values.

    Constants enter with twelve digits, because mathematical libraries differ in the last ones.
    """
    digest = hashlib.sha256()
    for v in interface.variables:
        digest.update(repr((v.name, v.kind, v.output, sorted(asdict(v.quantity).items()))).encode())
    sym = interface.equations
    f = ca.Function("f", [sym.x, sym.u, sym.p], [sym.dx, interface.y, sym.start, sym.require])
    for k in range(f.n_instructions()):
        instruction: tuple[Any, ...] = f.instruction_id(k), f.instruction_input(k), f.instruction_output(k)
        if instruction[0] == ca.OP_CONST:
            instruction = (*instruction, f"{f.instruction_constant(k):.12g}")
        digest.update(repr(instruction).encode())
    digest.update(repr((sym.statements, interface.stiff)).encode())
    return digest.hexdigest()
