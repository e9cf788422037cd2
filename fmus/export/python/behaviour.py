"""What an instance needs to know of a model, and a `Subsystem` seen that way.

The functions are those of the declaration, evaluated by CasADi's virtual machine: nothing is compiled, and
nothing of the code for C is used (its parameters are hoisted, its elimination is written out).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

import casadi as ca
import numpy as np

from fmus.export.interface import Interface, Variable
from fmus.solver import Array, Motion, solve


class Behaviour(Protocol):
    """A model that an `Instance` runs; x states, u inputs, p parameters, t time [s].

    variables    in the order of their value references: parameters, inputs, states, derivatives, outputs
    sizes        how many of each
    statements   what `observe` gives numbers for that must stay positive
    start        states at the start, from their start values
    rate         their time derivatives, if it has any
    observe      outputs that are not states, and the numbers for the statements
    advance      states after `length` seconds, and the memory of the solver
    forward      derivatives along directions of p, u and x: of x (at the start, else the direction),
                 of dx/dt and of the outputs
    """

    @property
    def variables(self) -> Sequence[Variable]: ...
    @property
    def sizes(self) -> tuple[int, int, int, int, int]: ...
    @property
    def statements(self) -> Sequence[str]: ...
    def start(self, x: Array, u: Array, p: Array) -> Array: ...
    def rate(self, x: Array, u: Array, p: Array) -> Array: ...
    def observe(self, x: Array, u: Array, p: Array, t: float) -> tuple[Array, Array]: ...
    def advance(
        self, x: Array, p: Array, motion: Motion, t: float, length: float, tolerance: float, memory: Array
    ) -> tuple[Array, Array]: ...
    def forward(
        self, x: Array, u: Array, p: Array, along: tuple[Array, Array, Array], initial: bool
    ) -> tuple[Array, Array, Array]: ...


def sizes(face: Interface) -> tuple[int, int, int, int, int]:
    """Numbers of parameters, inputs, states, derivatives and outputs that are not states."""
    groups = (face.parameters, face.inputs, face.states, face.derivatives, face.outputs)
    return tuple(len(group) for group in groups)  # type: ignore[return-value]


class Functions:
    """The functions of a subsystem; made once, used by all its instances."""

    def __init__(self, face: Interface) -> None:
        self.face, sym = face, face.equations
        known = [sym.x, sym.u, sym.p]
        vp, vu, vx, du = (ca.SX.sym(n, v.numel()) for n, v in zip("puxd", (*known[::-1], sym.u), strict=True))
        running, directions = ca.vertcat(sym.x, sym.u), ca.vertcat(vx, vu)
        starting, all_directions = ca.vertcat(sym.x, sym.u, sym.p), ca.vertcat(vx, vu, vp)
        vx0 = ca.jtimes(sym.start, starting, all_directions)
        through = ca.vertcat(vx0, vu, vp)
        after = ca.vertcat(sym.dx, face.y)
        self.rate = _function(known, [sym.dx])
        self.linearised = _function(
            [*known, du], [sym.dx, ca.jacobian(sym.dx, sym.x), ca.jtimes(sym.dx, sym.u, du)]
        )
        self.start = _function(known, [sym.start])
        self.observe = _function(known, [face.y, sym.require])
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


class Continuous:
    """The behaviour of a subsystem: the exact Jacobian, and the solver of `fmus.solver`."""

    def __init__(self, functions: Functions, variables: Sequence[Variable]) -> None:
        face = functions.face
        self.variables, self.sizes = variables, sizes(face)
        self.statements = face.equations.statements
        self.nominal = np.array([v.quantity.nominal for v in face.states])
        self.absolute = np.array([v.quantity.absolute_scale for v in face.states])
        self.stiff = face.stiff
        self._p = np.zeros(len(face.parameters))
        self._rate, self._linearised = _Bound(functions.rate), _Bound(functions.linearised)
        self._start, self._observe = _Bound(functions.start), _Bound(functions.observe)
        self._forward, self._start_forward = _Bound(functions.forward), _Bound(functions.start_forward)

    def start(self, x: Array, u: Array, p: Array) -> Array:
        """See `Behaviour`; of the copies, what is calculated there may be overwritten."""
        return self._start(x, u, p)[0].copy()  # type: ignore[no-any-return]

    def rate(self, x: Array, u: Array, p: Array | None = None) -> Array:
        """See `Behaviour` and `solver.System`."""
        return self._rate(x, u, self._p if p is None else p)[0]  # type: ignore[no-any-return]

    def linearised(self, x: Array, u: Array, du: Array) -> tuple[Array, Array, Array]:
        """See `solver.System`."""
        f, jacobian, ft = self._linearised(x, u, self._p, du)
        return f, jacobian, ft

    def observe(self, x: Array, u: Array, p: Array, t: float) -> tuple[Array, Array]:
        """See `Behaviour`."""
        y, require = self._observe(x, u, p)
        return y.copy(), require.copy()

    def advance(
        self, x: Array, p: Array, motion: Motion, t: float, length: float, tolerance: float, memory: Array
    ) -> tuple[Array, Array]:
        """See `Behaviour`."""
        if not x.size:
            return x, memory
        self._p[:] = p
        return solve(self, x, motion, length, tolerance, memory)

    def forward(
        self, x: Array, u: Array, p: Array, along: tuple[Array, Array, Array], initial: bool
    ) -> tuple[Array, Array, Array]:
        """See `Behaviour`."""
        function = self._start_forward if initial else self._forward
        vx, after = function(x, u, p, *along)
        return vx.copy(), after[: x.size].copy(), after[x.size :].copy()
