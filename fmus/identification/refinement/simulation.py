"""Segments of a trajectory with their sensitivities: exact ones of compiled C, or difference quotients."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from fmus.contract import Subsystem
from fmus.identification.refinement.generated_code import WIDTH, library, reduce, sources
from fmus.parameters import Values
from fmus.parameters import values as numbers
from orchestrator.base.errors import Problem

Array = NDArray[np.float64]

STEP = 1e-5  # of difference quotients, relative; suits a simulation with about ten digits


class SimulationFailed(Exception):
    """The model could not be simulated: reason, and the time [s] it reached."""

    def __init__(self, reason: str, time: float) -> None:
        super().__init__(f"{reason} at t = {time:.9g} s")
        self.reason, self.time = reason, time


@dataclass(frozen=True)
class SegmentSolution:
    """A segment of n samples; the derivatives have no entries where none were asked for.

    y          outputs at the samples, shape (n, ny)
    x          states at the last sample, shape (nx,)
    y_x, y_p   derivatives of y by the states at the start and by the parameters, (n, ny, nx), (n, ny, np)
    x_x, x_p   derivatives of x likewise, (nx, nx), (nx, np)
    steps      steps of the solver, if they are known
    """

    y: Array
    x: Array
    y_x: Array
    y_p: Array
    x_x: Array
    x_p: Array
    steps: int = 0


class Simulator(Protocol):
    """A model as the refinement sees it.

    states, inputs, outputs, free   names; `free` are the free parameters
    nominal                         magnitudes of the states, shape (nx,)
    p0                              values of the free parameters to begin with, shape (np,)
    """

    states: tuple[str, ...]
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    free: tuple[str, ...]
    nominal: Array
    p0: Array

    def start(self, p: Array, u0: Array, /) -> tuple[Array, Array]:
        """States at rest at inputs `u0`, shape (nx,), and their derivatives by p, shape (nx, np)."""

    def segment(
        self, x: Array, p: Array, time: Array, inputs: Array, sensitivities: bool = True, /
    ) -> SegmentSolution:
        """From the states `x` over `time` (n,) with `inputs` (n, nu), linear between the samples."""


_POINTER = ctypes.POINTER(ctypes.c_double)
_REQUIREMENT = 5
_REASONS = (  # as in native/solver.h and native/sensitivities.c
    "",
    "the derivative of {} is not finite",
    "the Jacobian is singular",
    "steps become too small, the error is largest in {}",
    "too many steps between two samples",
    'requirement "{}" is violated',
    "an output or a derivative of one is not finite",
)


class CompiledModel:
    """A subsystem compiled for output error, with exact sensitivities.

    states, inputs   names of those that the outputs depend on: the others are left out
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
        self._statements = model.equations.statements
        self._tolerance = tolerance
        self._x = np.array(list(given.x.values()))
        slope = ca.densify(ca.jacobian(model.start, model.q))
        eqs = model.equations
        self._start = ca.Function("start", [model.all_x, eqs.u, eqs.p], [model.start, slope])
        self._refine = library(sources(model)).refine
        self._refine.restype = ctypes.c_int
        doubles = [_POINTER] * 4
        self._refine.argtypes = [ctypes.c_int, *doubles, ctypes.c_double, ctypes.c_int, *doubles]

    def start(self, p: Array, u0: Array) -> tuple[Array, Array]:
        """States at the start by the subsystem's `initial`, (nx,), and their derivatives by p, (nx, np)."""
        x, slope = self._start(self._x, u0, self._all(p))
        return x.full()[:, 0], slope.full()

    def segment(
        self, x: Array, p: Array, time: Array, inputs: Array, sensitivities: bool = True
    ) -> SegmentSolution:
        """The motion from the states x at time[0] on to time[-1].

        time    of the samples [s], increasing, shape (n,)
        inputs  at the samples, linear between them, shape (n, nu)

        Raises SimulationFailed. Several threads may call it at once: it runs without Python's lock.
        """
        time, inputs = (np.ascontiguousarray(a, dtype=np.float64) for a in (time, inputs))
        n, nx, ny = time.size, len(self.states), len(self.outputs)
        self._check(x, p, time, inputs)
        columns = -(-(self._acting.size + nx) // WIDTH) * WIDTH if sensitivities else 0
        x, y, report = np.array(x, dtype=np.float64), np.empty((n, ny)), np.zeros(3)
        slopes, ends = np.empty((n, ny, columns)), np.empty((nx, columns))
        arrays = [a.ctypes.data_as(_POINTER) for a in (time, inputs, x, self._all(p))]
        results = [a.ctypes.data_as(_POINTER) for a in (y, slopes, ends, report)]
        status = self._refine(n, *arrays, self._tolerance, int(sensitivities), *results)
        if status:
            names = self._statements if status == _REQUIREMENT else self.states
            raise SimulationFailed(_REASONS[status].format(names[int(report[2])]), report[0])
        return SegmentSolution(y, x, *self._split(slopes), *self._split(ends), int(report[1]))

    def _check(self, x: Array, p: Array, time: Array, inputs: Array) -> None:
        for what, array, expected, names in (
            ("inputs", inputs, (time.size, len(self.inputs)), self.inputs),
            ("states", x, (len(self.states),), self.states),
            ("parameters", p, (len(self.free),), self.free),
        ):
            if np.shape(array) != expected:
                message = f"{what} have the shape {np.shape(array)}, expected {expected}"
                raise Problem(f"{message}, of {', '.join(names)}" if names else message)
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


class Differences:
    """A simulator with the derivatives replaced by forward difference quotients of its own segments.

    step   relative to the magnitude of each state and parameter
    """

    def __init__(self, model: Simulator, step: float = STEP) -> None:
        self.model, self.step = model, step
        self.states, self.inputs, self.outputs = model.states, model.inputs, model.outputs
        self.free, self.nominal, self.p0, self.start = model.free, model.nominal, model.p0, model.start

    def segment(
        self, x: Array, p: Array, time: Array, inputs: Array, sensitivities: bool = True
    ) -> SegmentSolution:
        """As the model's, over n + 1 simulations."""
        base = self.model.segment(x, p, time, inputs, False)
        if not sensitivities:
            return base
        nx, at = len(x), np.concatenate([x, p])
        y, ends = np.zeros((*base.y.shape, at.size)), np.zeros((nx, at.size))
        nominal = np.concatenate([self.nominal, np.where(p == 0, 1.0, np.abs(p))])
        for j, size in enumerate(self.step * nominal):
            moved = at.copy()
            moved[j] += size
            other = self.model.segment(moved[:nx], moved[nx:], time, inputs, False)
            y[..., j], ends[..., j] = (other.y - base.y) / size, (other.x - base.x) / size
        return replace(base, y_x=y[..., :nx], y_p=y[..., nx:], x_x=ends[:, :nx], x_p=ends[:, nx:])


class BlackBox:
    """Any simulator of whole runs: `simulate(p, time, inputs)` gives the outputs, shape (n, ny).

    It has no states that could be set, so each run is one segment: single shooting. Derivatives are those of
    `Differences`.
    `simulate` is called from several threads; give `refine` one thread if it cannot bear that.
    """

    def __init__(
        self,
        simulate: Callable[[Array, Array, Array], Array],
        inputs: Sequence[str],
        outputs: Sequence[str],
        free: Sequence[str],
        p0: Array,
        step: float = STEP,
    ) -> None:
        self.simulate, self.step = simulate, step
        self.states: tuple[str, ...] = ()
        self.inputs, self.outputs, self.free = tuple(inputs), tuple(outputs), tuple(free)
        self.nominal, self.p0 = np.zeros(0), p0

    def start(self, p: Array, u0: Array) -> tuple[Array, Array]:
        """No state, so nothing."""
        del u0
        return np.zeros(0), np.zeros((0, len(p)))

    def segment(
        self, x: Array, p: Array, time: Array, inputs: Array, sensitivities: bool = True
    ) -> SegmentSolution:
        """One whole run, or n + 1 of them."""
        if sensitivities:
            return Differences(self, self.step).segment(x, p, time, inputs)
        y, none = self.simulate(p, time, inputs), np.zeros((0, 0))
        return SegmentSolution(y, x, np.zeros((*y.shape, 0)), np.zeros((*y.shape, 0)), none, none)
