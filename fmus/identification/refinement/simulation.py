"""A simulation that did not reach its end.

What the refinement needs of a model: segments of a trajectory, with their sensitivities.

A subsystem compiled for output error: outputs at recorded samples, and their exact derivatives.

Many jobs in a few threads; the compiled model lets go of the interpreter.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Protocol, TypeVar

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from fmus.contract import Subsystem
from fmus.identification.refinement.generated_code import WIDTH, library, sources
from fmus.identification.refinement.reduced import reduce
from fmus.parameters import Values
from fmus.parameters import values as numbers
from orchestrator.base.errors import Problem


class Failed(Exception):
    """The model could not be simulated: why, and the time [s] it reached."""

    def __init__(self, why: str, time: float) -> None:
        super().__init__(f"{why} at t = {time:.9g} s")
        self.why, self.time = why, time


Array = NDArray[np.float64]


class PieceResult(Protocol):
    """A segment of n samples: outputs, the state at the end, their derivatives.

    `y_x` means the derivative of y with respect to the state at the segment's start, `x_p` that of the
    end state with respect to the free parameters, and so on.
    """

    @property
    def y(self) -> Array:
        """Shape (n, ny)."""

    @property
    def x(self) -> Array:
        """Shape (nx,)."""

    @property
    def y_x(self) -> Array:
        """Shape (n, ny, nx)."""

    @property
    def y_p(self) -> Array:
        """Shape (n, ny, np)."""

    @property
    def x_x(self) -> Array:
        """Shape (nx, nx)."""

    @property
    def x_p(self) -> Array:
        """Shape (nx, np)."""


class Simulator(Protocol):
    """A model as the refinement sees it; names, magnitudes of the states, start values of the parameters.

    `refinement.model.Model` is the one with exact sensitivities, `refinement.differences` has others.
    """

    @property
    def states(self) -> tuple[str, ...]:
        """Names of the states."""

    @property
    def inputs(self) -> tuple[str, ...]:
        """Names of the inputs."""

    @property
    def outputs(self) -> tuple[str, ...]:
        """Names of the outputs."""

    @property
    def free(self) -> tuple[str, ...]:
        """Names of the free parameters."""

    @property
    def nominal(self) -> Array:
        """Magnitudes of the states, shape (nx,)."""

    @property
    def p0(self) -> Array:
        """Values of the free parameters to begin with, shape (np,)."""

    def start(self, p: Array, u0: Array, /) -> tuple[Array, Array]:
        """State at rest at inputs `u0`, and its derivative with respect to p."""

    def segment(
        self, x: Array, p: Array, time: Array, inputs: Array, sensitivities: bool = True, /
    ) -> PieceResult:
        """From state `x` over `time` (n,) with `inputs` (n, nu), linear between the samples."""


_POINTER = ctypes.POINTER(ctypes.c_double)
_NOT_REQUIRED = 5
_WHY = (  # as in native/solver.h and native/sensitivities.c
    "",
    "the derivative of {} is not finite",
    "the Jacobian is singular",
    "steps become too small, the error is largest in {}",
    "too many steps between two samples",
    'requirement "{}" is violated',
    "an output or a derivative of one is not finite",
)


@dataclass(frozen=True)
class Piece:
    """What `Model.segment` gives; the derivatives have no entries where none were asked for.

    y          outputs at the samples, shape (n, ny)
    x          states at the last sample, shape (nx,)
    y_x, y_p   derivatives of y by the states at the start and by the parameters, (n, ny, nx), (n, ny, np)
    x_x, x_p   derivatives of x likewise, (nx, nx), (nx, np)
    steps      steps of the solver
    """

    y: Array
    x: Array
    y_x: Array
    y_p: Array
    x_x: Array
    x_p: Array
    steps: int


class Model:
    """A subsystem compiled for output error.

    states, inputs   names of those that the outputs depend on: the others are left out
    outputs, free    names of the outputs and of the free parameters, as given
    nominal          magnitudes of the states, shape (nx,)
    p0               values of the free parameters, shape (np,)
    """

    def __init__(
        self,
        sub: Subsystem,
        outputs: Sequence[str],
        free: Sequence[str],
        values: Values | None = None,
        tolerance: float = 1e-6,
    ) -> None:
        given = values or numbers(sub)
        model = reduce(sub, outputs, free)
        self.states, self.inputs, self.outputs = model.states, model.inputs, model.outputs
        self.free = model.free
        self.nominal = np.array([model.declared[name].nominal for name in model.states])
        self._p = np.array([given.p[name] for name in model.parameters])
        self._places = np.array([model.parameters.index(name) for name in free], dtype=np.intp)
        self.p0 = self._p[self._places]
        self._acting = np.array(model.acting, dtype=np.intp)
        self._statements = model.statements
        self._tolerance = tolerance
        self._x = np.array(list(given.x.values()))
        slope = ca.densify(ca.jacobian(model.start, model.q))
        self._start = ca.Function("start", [model.all_x, model.u, model.p], [model.start, slope])
        self._refine = library(sources(model)).refine
        self._refine.restype = ctypes.c_int
        doubles = [_POINTER] * 4
        self._refine.argtypes = [ctypes.c_int, *doubles, ctypes.c_double, ctypes.c_int, *doubles]

    def start(self, p: Array, u0: Array) -> tuple[Array, Array]:
        """States at the start by the subsystem's `initial`, (nx,), and their derivatives by p, (nx, np)."""
        x, slope = self._start(self._x, u0, self._all(p))
        return x.full()[:, 0], slope.full()

    def segment(self, x: Array, p: Array, time: Array, inputs: Array, sensitivities: bool = True) -> Piece:
        """The motion from the states x at time[0] on to time[-1].

        time    of the samples [s], increasing, shape (n,)
        inputs  at the samples, linear between them, shape (n, nu)

        Raises Failed. Several threads may call it at once: it runs without Python's lock.
        """
        time, inputs = _plain(time), _plain(inputs)
        n, nx, ny = time.size, len(self.states), len(self.outputs)
        self._check(x, p, time, inputs)
        columns = -(-(self._acting.size + nx) // WIDTH) * WIDTH if sensitivities else 0
        x, y, told = _plain(x).copy(), np.empty((n, ny)), np.zeros(3)
        slopes, ends = np.empty((n, ny, columns)), np.empty((nx, columns))
        arrays = [a.ctypes.data_as(_POINTER) for a in (time, inputs, x, self._all(p))]
        results = [a.ctypes.data_as(_POINTER) for a in (y, slopes, ends, told)]
        outcome = self._refine(n, *arrays, self._tolerance, int(sensitivities), *results)
        if outcome:
            raise self._failed(outcome, told[0], told[2])
        y_x, y_p = self._split(slopes)
        x_x, x_p = self._split(ends)
        return Piece(y, x, y_x, y_p, x_x, x_p, int(told[1]))

    def _check(self, x: Array, p: Array, time: Array, inputs: Array) -> None:
        for what, found, expected, names in (
            ("inputs", inputs, (time.size, len(self.inputs)), self.inputs),
            ("states", x, (len(self.states),), self.states),
            ("parameters", p, (len(self.free),), self.free),
        ):
            if np.shape(found) != expected:
                told = f"{what} have the shape {np.shape(found)}, expected {expected}"
                raise Problem(f"{told}, of {', '.join(names)}" if names else told)
        if time.ndim != 1 or time.size == 0 or not (np.diff(time) > 0).all():
            raise Problem("times of the samples do not increase, expected that they do")

    def _all(self, p: Array) -> Array:
        """All parameters, in the order of their declaration."""
        every = self._p.copy()
        every[self._places] = p
        return every

    def _split(self, columns: Array) -> tuple[Array, Array]:
        """Derivatives by the states and by the parameters; of those that do not act they are zero."""
        acting, nx = self._acting.size, len(self.states)
        if columns.shape[-1] == 0:
            return columns, columns
        by_states, by_acting = columns[..., acting : acting + nx], columns[..., :acting]
        if acting == len(self.free):
            return by_states, by_acting
        by_p = np.zeros((*columns.shape[:-1], len(self.free)))
        by_p[..., self._acting] = by_acting
        return by_states, by_p

    def _failed(self, outcome: int, time: float, culprit: float) -> Failed:
        names = self._statements if outcome == _NOT_REQUIRED else self.states
        return Failed(_WHY[outcome].format(names[int(culprit)]), time)


def _plain(values: Array) -> Array:
    return np.ascontiguousarray(values, dtype=np.float64)


Job = TypeVar("Job")
Result = TypeVar("Result")


def parallel(job: Callable[[Job], Result], places: Sequence[Job], threads: int) -> list[Result]:
    """Results in the order of the places; an interrupt does not wait for what has not begun."""
    if threads == 1 or len(places) == 1:
        return [job(place) for place in places]
    pool = ThreadPoolExecutor(threads)
    try:
        return list(pool.map(job, places))
    finally:
        pool.shutdown(wait=True, cancel_futures=True)
