"""A `Subsystem` as an instance in Python runs it, and how it is found again on another machine.

The functions are those of the declaration, evaluated by CasADi's virtual machine: nothing is compiled, and
nothing of the code for C is used (its parameters are hoisted, its elimination is written out).

An origin is "module:name", or "module:name.key" for an entry of a mapping such as VARIANTS.
"""

from __future__ import annotations

import hashlib
import importlib
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from typing import Any, Protocol

import casadi as ca
import numpy as np

from fmus.contract import Subsystem
from fmus.export.interface import Interface
from fmus.solver import Array, InputPolynomials, solve
from orchestrator.base.errors import Problem


class RunnableModel(Protocol):
    """A model that an `Instance` runs; x states, u inputs, p parameters, t time [s].

    interface    the variables
    statements   what `observe` gives numbers for that must stay positive
    start        states at the start, from their start values
    rate         their time derivatives, if it has any
    observe      outputs that are not states, and the numbers for the statements
    advance      states after `length` seconds, and the memory of the solver
    forward      derivatives along directions of p, u and x: of x (at the start, else the direction),
                 of dx/dt and of the outputs
    """

    @property
    def interface(self) -> Interface: ...
    @property
    def statements(self) -> Sequence[str]: ...
    def start(self, x: Array, u: Array, p: Array) -> Array: ...
    def rate(self, x: Array, u: Array, p: Array) -> Array: ...
    def observe(self, x: Array, u: Array, p: Array, t: float) -> tuple[Array, Array]: ...
    def advance(
        self,
        x: Array,
        p: Array,
        motion: InputPolynomials,
        t: float,
        length: float,
        tolerance: float,
        memory: Array,
    ) -> tuple[Array, Array]: ...
    def forward(
        self, x: Array, u: Array, p: Array, along: tuple[Array, Array, Array], initial: bool
    ) -> tuple[Array, Array, Array]: ...


class SubsystemFunctions:
    """The functions of a subsystem; made once, used by all its instances."""

    def __init__(self, interface: Interface) -> None:
        self.interface, sym = interface, interface.equations
        known = [sym.x, sym.u, sym.p]
        vp, vu, vx, du = (ca.SX.sym(n, v.numel()) for n, v in zip("puxd", (*known[::-1], sym.u), strict=True))
        running, directions = ca.vertcat(sym.x, sym.u), ca.vertcat(vx, vu)
        starting, all_directions = ca.vertcat(sym.x, sym.u, sym.p), ca.vertcat(vx, vu, vp)
        vx0 = ca.jtimes(sym.start, starting, all_directions)
        through = ca.vertcat(vx0, vu, vp)
        after = ca.vertcat(sym.dx, interface.y)
        self.rate = _function(known, [sym.dx])
        self.linearised = _function(
            [*known, du], [sym.dx, ca.jacobian(sym.dx, sym.x), ca.jtimes(sym.dx, sym.u, du)]
        )
        self.start = _function(known, [sym.start])
        self.observe = _function(known, [interface.y, sym.require])
        self.forward = _function([*known, vp, vu, vx], [vx, ca.jtimes(after, running, directions)])
        self.start_forward = _function([*known, vp, vu, vx], [vx0, ca.jtimes(after, starting, through)])


def _function(inputs: Sequence[ca.SX], outputs: Sequence[ca.SX]) -> ca.Function:
    return ca.Function("f", list(inputs), [ca.densify(value) for value in outputs], {"cse": True})


class _Bound:
    """A CasADi function on arrays of its own: no objects are made in a call."""

    def __init__(self, function: ca.Function) -> None:
        buffer: Any
        buffer, self._run = function.buffer()
        self._buffer = buffer  # it has to live as long as the call
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
        for own, given in zip(self._arguments, arguments, strict=True):
            own[:] = given
        self._run()
        return self._results


class SubsystemModel:
    """A subsystem as an instance runs it: the exact Jacobian, and the solver of `fmus.solver`."""

    def __init__(self, functions: SubsystemFunctions) -> None:
        self.interface = interface = functions.interface
        self.statements = interface.equations.statements
        self.nominal = np.array([v.quantity.nominal for v in interface.states])
        self.absolute = np.array([v.quantity.absolute_scale for v in interface.states])
        self.stiff = interface.stiff
        self._p = np.zeros(len(interface.parameters))
        self._rate, self._linearised = _Bound(functions.rate), _Bound(functions.linearised)
        self._start, self._observe = _Bound(functions.start), _Bound(functions.observe)
        self._forward, self._start_forward = _Bound(functions.forward), _Bound(functions.start_forward)

    def start(self, x: Array, u: Array, p: Array) -> Array:
        """See `RunnableModel`; of the copies, what is calculated there may be overwritten."""
        return self._start(x, u, p)[0].copy()  # type: ignore[no-any-return]

    def rate(self, x: Array, u: Array, p: Array | None = None) -> Array:
        """See `RunnableModel` and `solver.OdeSystem`."""
        return self._rate(x, u, self._p if p is None else p)[0]  # type: ignore[no-any-return]

    def linearised(self, x: Array, u: Array, du: Array) -> tuple[Array, Array, Array]:
        """See `solver.OdeSystem`."""
        f, jacobian, ft = self._linearised(x, u, self._p, du)
        return f, jacobian, ft

    def observe(self, x: Array, u: Array, p: Array, t: float) -> tuple[Array, Array]:
        """See `RunnableModel`."""
        y, require = self._observe(x, u, p)
        return y.copy(), require.copy()

    def advance(
        self,
        x: Array,
        p: Array,
        motion: InputPolynomials,
        t: float,
        length: float,
        tolerance: float,
        memory: Array,
    ) -> tuple[Array, Array]:
        """See `RunnableModel`."""
        if not x.size:
            return x, memory
        self._p[:] = p
        return solve(self, x, motion, length, tolerance, memory)

    def forward(
        self, x: Array, u: Array, p: Array, along: tuple[Array, Array, Array], initial: bool
    ) -> tuple[Array, Array, Array]:
        """See `RunnableModel`."""
        function = self._start_forward if initial else self._forward
        vx, after = function(x, u, p, *along)
        return vx.copy(), after[: x.size].copy(), after[x.size :].copy()


# ---- origin ----------------------------------------------------------------------------------------


def origin(sub: Subsystem) -> str:
    """Under which name a loaded module has the subsystem: its own package if possible."""
    own = str(getattr(sub.dynamics, "__module__", "")) + "."
    places = [
        (not own.startswith(f"{module}."), module.split(".")[0] != own.split(".")[0], len(place), place)
        for module in list(sys.modules)
        if module != "__main__"
        for place, value in _named(module)
        if value is sub
    ]
    if not places:
        raise Problem(
            f"{sub.name}: no module has this subsystem under a name, expected one such as "
            '"package.module:NAME" to find it again where the FMU runs'
        )
    return min(places)[-1]


def _named(module: str) -> Iterator[tuple[str, Any]]:
    """The subsystems of a module, also those in its mappings, each with its origin."""
    for name, value in list(getattr(sys.modules[module], "__dict__", {}).items()):
        if isinstance(value, Subsystem):
            yield f"{module}:{name}", value
        elif isinstance(value, Mapping) and all(isinstance(v, Subsystem) for v in value.values()):
            yield from ((f"{module}:{name}.{key}", v) for key, v in value.items())


def subsystem(where: str) -> Subsystem:
    """The subsystem with this origin."""
    module, _, path = where.partition(":")
    name, _, key = path.partition(".")
    if not name:
        raise Problem(f'"{where}" is no name of a subsystem, expected one such as "package.module:NAME"')
    try:
        sub = getattr(importlib.import_module(module), name)
        sub = sub[key] if key else sub
    except (ImportError, AttributeError, KeyError, TypeError) as problem:
        raise Problem(
            f"{where} is not in the Python of {sys.prefix}: {type(problem).__name__}: {problem}"
        ) from None
    if not isinstance(sub, Subsystem):
        raise Problem(f"{where} is {type(sub).__name__}, expected a Subsystem")
    return sub


def fingerprint(interface: Interface) -> str:
    """Another one for other variables or equations, whatever the numbers are.

    Constants count to twelve digits: a mathematical library may differ in the last ones.
    """
    digest = hashlib.sha256()
    for v in interface.variables:
        digest.update(repr((v.name, v.kind, v.output, sorted(asdict(v.quantity).items()))).encode())
    sym = interface.equations
    f = ca.Function("f", [sym.x, sym.u, sym.p], [sym.dx, interface.y, sym.start, sym.require])
    for k in range(f.n_instructions()):
        step: tuple[Any, ...] = f.instruction_id(k), f.instruction_input(k), f.instruction_output(k)
        if step[0] == ca.OP_CONST:
            step = (*step, f"{f.instruction_constant(k):.12g}")
        digest.update(repr(step).encode())
    digest.update(repr((sym.statements, interface.stiff)).encode())
    return digest.hexdigest()
