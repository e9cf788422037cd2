"""The solver of the FMUs (export/native/solver.c) in NumPy: for Python FMUs, and as a reference for tests.

Inner steps with error control. A cheap method is tried first; if its error is too large, another one takes
the step:

    models that are not stiff   Kutta's method (order 3), that of Cash and Karp (order 5), RODAS (order 4)
    stiff models                RODAS3 (order 3), RODAS (order 4)

RODAS3 is tried if the tolerance is not tight and one step would cover the whole interval. A method that fails
is suspended, longer after repeated failures. That of Cash and Karp is suspended only if it is unstable.

Explicit methods (native/runge_kutta.c): W. Kutta, Zeitschrift fuer Mathematik und Physik 46 (1901) 435, with
the midpoint rule of order 2 inside; J. R. Cash, A. H. Karp, ACM Transactions on Mathematical Software 16(3)
(1990) 201, with solutions of order 5, 4 and 3.

Implicit methods (native/rosenbrock.c): linearly implicit Runge-Kutta methods, L-stable and stiffly accurate,
one Jacobian and one LU factorisation per step:

    (I / (gamma h) - J) k_i = f(t + alpha_i h, x + sum_j a_ij k_j) + sum_j c_ij / h k_j + g_i h f_t

The last two stages are the embedded and the final correction, so the last k is the error estimate. RODAS:
E. Hairer, G. Wanner, Solving Ordinary Differential Equations II, 2nd ed., section IV.7 and program RODAS.
RODAS3: A. Sandu et al., Atmospheric Environment 31 (1997) 3459.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Protocol, TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lapack

Array: TypeAlias = NDArray[np.float64]

MAX_STEPS = 1_000_000  # inner steps in one call
LONGEST_PAUSE = 16  # inner steps without a method that failed
LOOSE = 1e-5  # tightest tolerance for RODAS3
RODAS3_FACTOR, ORDER_4_FACTOR, ORDER_3_FACTOR = 3.0, 15.0, 0.01  # of error estimates, see native/solver.c
KUTTA_LIMIT, CASH_KARP_LIMIT = 1.0, 3.0  # largest eigenvalue times step


@dataclass(frozen=True)
class Rosenbrock:
    """Coefficients of a Rosenbrock method; rows of a and c: strictly lower triangles."""

    gamma: float
    alpha: tuple[float, ...]
    g: tuple[float, ...]
    a: tuple[tuple[float, ...], ...]
    c: tuple[tuple[float, ...], ...]


RODAS = Rosenbrock(
    gamma=0.25,
    alpha=(0.0, 0.386, 0.21, 0.63, 1.0, 1.0),
    g=(0.25, -0.1043, 0.1035, -0.0362, 0.0, 0.0),
    a=(
        (),
        (1.544,),
        (0.9466785280815826, 0.2557011698983284),
        (3.314825187068521, 2.896124015972201, 0.9986419139977817),
        (1.221224509226641, 6.019134481288629, 12.53708332932087, -0.6878860361058950),
        (1.221224509226641, 6.019134481288629, 12.53708332932087, -0.6878860361058950, 1.0),
    ),
    c=(
        (),
        (-5.6688,),
        (-2.430093356833875, -0.2063599157091915),
        (-0.1073529058151375, -9.594562251023355, -20.47028614809616),
        (7.496443313967647, -10.24680431464352, -33.99990352819905, 11.70890893206160),
        (8.083246795921522, -7.981132988064893, -31.52159432874371, 16.31930543123136, -6.058818238834054),
    ),
)
RODAS3 = Rosenbrock(
    gamma=0.5,
    alpha=(0.0, 0.0, 1.0, 1.0),
    g=(0.5, 1.5, 0.0, 0.0),
    a=((), (0.0,), (2.0, 0.0), (2.0, 0.0, 1.0)),
    c=((), (4.0,), (1.0, -1.0), (1.0, -1.0, -8 / 3)),
)

# Cash and Karp: nodes, stages (a strictly lower triangle), weights of the solutions of order 5, 4 and 3
CK_NODES = (0.0, 0.2, 0.3, 0.6, 1.0, 0.875)
CK_STAGES = (
    (),
    (0.2,),
    (0.075, 0.225),
    (0.3, -0.9, 1.2),
    (-11 / 54, 2.5, -70 / 27, 35 / 27),
    (1631 / 55296, 175 / 512, 575 / 13824, 44275 / 110592, 253 / 4096),
)
CK_ORDER_5 = (37 / 378, 0.0, 250 / 621, 125 / 594, 0.0, 512 / 1771)
CK_ORDER_4 = (2825 / 27648, 0.0, 18575 / 48384, 13525 / 55296, 277 / 14336, 0.25)
CK_ORDER_3 = (19 / 54, 0.0, -10 / 27, 55 / 54, 0.0, 0.0)


class OdeSystem(Protocol):
    """dx/dt = f(x, u); the next call may overwrite the returned arrays.

    nominal      nominal values of the states
    absolute     absolute tolerances of the states, divided by the relative tolerance
    stiff        whether the explicit method is never tried
    rate         f
    linearised   f, df/dx and df/du du
    """

    nominal: Array
    absolute: Array
    stiff: bool

    def rate(self, x: Array, u: Array) -> Array: ...
    def linearised(self, x: Array, u: Array, du: Array) -> tuple[Array, Array, Array]: ...


@dataclass(frozen=True)
class InputPolynomials:
    """Inputs over a step: u = sum over k of coefficients[k] tau^k, tau [s] since its start; shape (4, nu)."""

    coefficients: Array

    @property
    def varying(self) -> bool:
        """Whether any input changes over the step."""
        return bool(self.coefficients[1:].any())

    def value(self, tau: float) -> Array:
        """Inputs at tau."""
        m = self.coefficients
        u: Array = m[0] + tau * (m[1] + tau * (m[2] + tau * m[3]))
        return u

    def derivative(self, tau: float) -> Array:
        """Time derivatives of the inputs at tau."""
        m = self.coefficients
        du: Array = m[1] + tau * (2 * m[2] + tau * 3 * m[3])
        return du


class Unsolved(Exception):
    """The solver failed.

    why     "not finite" (derivative), "singular" (Jacobian), "small" (step) or "many" (steps)
    tau     time reached [s]
    step    last inner step tried [s]
    worst   index of the state with the largest error, or of the derivative that is not finite
    value   value of that derivative
    x       states at tau
    """

    def __init__(self, why: str, tau: float, step: float, worst: int, value: float, x: Array) -> None:
        super().__init__(why)
        self.why, self.tau, self.step, self.worst, self.value, self.x = why, tau, step, worst, value, x


@dataclass
class Pause:
    """Suspension of a method that failed.

    left   remaining inner steps without the method
    next   length of the pause after its next failure
    """

    left: int = 0
    next: int = 0

    def is_over(self) -> bool:
        """Whether the method is tried for this inner step; counts the pause down."""
        if self.left <= 0:
            return True
        self.left -= 1
        return False

    def update(self, success: bool) -> None:
        """Set the pause after a trial of the method."""
        pause = min(max(self.next, 1), LONGEST_PAUSE)
        self.left = 0 if success else pause
        self.next = pause - 1 if success else 2 * pause


MEMORY_SIZE = 5  # numbers that the solver keeps from step to step, see `solve`


@dataclass
class _Attempt:
    """A step that was tried: its method is the cheap one, new states, error over tolerance, worst state."""

    cheap: bool = False
    new: Array = field(default_factory=lambda: np.zeros(0))
    error: float = math.inf
    worst: int = 0

    @property
    def accepted(self) -> bool:
        """Whether the error is small enough; NaN is not."""
        return self.error <= 1.0


def solve(
    system: OdeSystem, x: Array, motion: InputPolynomials, length: float, tolerance: float, memory: Array
) -> tuple[Array, Array]:
    """States after `length` seconds, and the memory for the next call.

    memory   from the last call, zeros at first; shape (MEMORY_SIZE,): proposal for the next inner step [s], 0
             without one; pause of the method that is tried first; pause of the method of Cash and Karp
    """
    with np.errstate(all="ignore"):  # values that are not finite are handled here
        return _solve(system, x, motion, length, tolerance, memory.tolist())


def _solve(
    system: OdeSystem,
    x: Array,
    motion: InputPolynomials,
    length: float,
    tolerance: float,
    memory: Sequence[float],
) -> tuple[Array, Array]:
    cheap, second = Pause(int(memory[1]), int(memory[2])), Pause(int(memory[3]), int(memory[4]))
    smallest = max(1e-14 * length, sys.float_info.min)  # smaller steps do not change the time
    tau, rejected, count, proposal = 0.0, False, 0, memory[0] or length
    attempt = _Attempt()
    linear: LinearisedStep | None = None  # the linearised model at tau
    while tau < length:
        # Equal steps to the end, none larger than the proposal: no tiny last step.
        rest = length - tau
        ratio = rest / proposal * (1.0 - 1e-9)
        parts = math.ceil(ratio) if ratio > 1.0 else 1
        h = rest / parts
        if count == MAX_STEPS:
            raise Unsolved("many", tau, h, attempt.worst, 0.0, x)
        count += 1
        attempt = _Attempt()
        if linear is None and not system.stiff:
            attempt = _explicit(system, motion, tau, x, h, tolerance, cheap, second)
        if not attempt.accepted and linear is None:
            linear = _linearised(system, motion, tau, x)
            if system.stiff and tolerance >= LOOSE and h == length and cheap.is_over():
                attempt = _implicit(linear, RODAS3, x, h, tolerance / RODAS3_FACTOR)
                attempt.cheap = True
                cheap.update(attempt.accepted)
        if not attempt.accepted and linear is not None:
            attempt = _implicit(linear, RODAS, x, h, tolerance)
        error = attempt.error
        if attempt.accepted:
            # The error of RODAS grows with h^4 (order 3 of the estimate), that of the others similarly.
            growth = min(1.0 if rejected else 5.0, 0.9 / max(error, 1e-8) ** 0.25)
            # The cheap method leaves the step to the next one. A step shortened by the end of the interval
            # does not reduce the old proposal.
            keep = attempt.cheap or growth == 5.0
            proposal = max(h * growth, proposal) if keep else h * growth
            x, rejected, linear = attempt.new, False, None
            tau = tau + h if parts > 1 else length
        else:
            proposal = h * (max(0.2, 0.9 / error**0.25) if error < sys.float_info.max else 0.2)
            rejected = True
            if proposal < smallest:
                why = "small" if linear is None or linear.solvable else "singular"
                raise Unsolved(why, tau, h, attempt.worst, 0.0, x)
    return x, np.array([proposal, cheap.left, cheap.next, second.left, second.next])


def _explicit(
    system: OdeSystem,
    motion: InputPolynomials,
    tau: float,
    x: Array,
    h: float,
    tolerance: float,
    cheap: Pause,
    second: Pause,
) -> _Attempt:
    """A step of Kutta's method, or of that of Cash and Karp."""
    attempt = _Attempt()
    if cheap.is_over():
        new, estimate, stable = kutta(system, motion, tau, x, h)
        if stable:
            attempt = _Attempt(True, new, *_error(x, new, estimate, tolerance, system.absolute))
        cheap.update(attempt.accepted)
    if not attempt.accepted and second.is_over():
        new, fourth, third, stable = cash_karp(system, motion, tau, x, h)
        attempt = _Attempt()
        if stable:
            error, worst = _error(x, new, fourth, tolerance, system.absolute)
            error_3, _ = _error(x, new, third, tolerance, system.absolute)
            larger = float(np.fmax(ORDER_4_FACTOR * error, ORDER_3_FACTOR * error_3))
            attempt = _Attempt(False, new, larger, worst)
        second.update(stable)
    return attempt


def _implicit(linear: LinearisedStep, method: Rosenbrock, x: Array, h: float, tolerance: float) -> _Attempt:
    new, estimate = linear.advance(method, x, h)
    if not linear.solvable:
        return _Attempt()
    return _Attempt(False, new, *_error(x, new, estimate, tolerance, linear.system.absolute))


def kutta(
    system: OdeSystem, motion: InputPolynomials, tau: float, x: Array, h: float
) -> tuple[Array, Array, bool]:
    """States after a step of Kutta's method of size h, error estimate, and whether the step is stable."""
    k1 = system.rate(x, motion.value(tau)).copy()
    k2 = system.rate(x + 0.5 * h * k1, motion.value(tau + 0.5 * h)).copy()
    k3 = system.rate(x + h * (2.0 * k2 - k1), motion.value(tau + h))
    estimate = h / 6.0 * (k1 - 2.0 * k2 + k3)
    stable = _is_stable(system, k3 - k2, h * (2.0 * k2 - 1.5 * k1), h, KUTTA_LIMIT)
    return x + h * k2 + estimate, estimate, stable


def cash_karp(
    system: OdeSystem, motion: InputPolynomials, tau: float, x: Array, h: float
) -> tuple[Array, Array, Array, bool]:
    """States after a step, errors of the solutions of order 4 and 3, and whether the step is stable."""
    k, at = np.zeros((len(CK_NODES), x.size)), [x] * len(CK_NODES)
    for s, (node, row) in enumerate(zip(CK_NODES, CK_STAGES, strict=True)):
        at[s] = x + h * (np.array(row) @ k[:s])
        k[s] = system.rate(at[s], motion.value(tau + node * h))
    fifth, fourth, third = (np.array(weights) @ k for weights in (CK_ORDER_5, CK_ORDER_4, CK_ORDER_3))
    stable = _is_stable(system, k[5] - k[4], at[5] - at[4], h, CASH_KARP_LIMIT)
    return x + h * fifth, h * (fifth - fourth), h * (fifth - third), stable


def _is_stable(system: OdeSystem, rate_change: Array, state_change: Array, h: float, limit: float) -> bool:
    """Between two stages dx/dt changes by lambda = rate_change / state_change. Is |lambda h| <= limit?"""
    df, dx = h * rate_change / system.nominal, limit * state_change / system.nominal
    return bool(df @ df <= dx @ dx)


def _linearised(system: OdeSystem, motion: InputPolynomials, tau: float, x: Array) -> LinearisedStep:
    u = motion.value(tau)
    f, jacobian, ft = system.linearised(x, u, motion.derivative(tau))
    if not np.isfinite(f).all():
        index = int(np.argmin(np.isfinite(f)))
        raise Unsolved("not finite", tau, 0.0, index, float(f[index]), x)
    return LinearisedStep(system, motion if motion.varying else None, tau, u, f.copy(), jacobian, ft)


def _error(x: Array, new: Array, estimate: Array, tolerance: float, absolute: Array) -> tuple[float, int]:
    """Weighted root mean square of the error estimate, and the index of the largest error."""
    errors = np.abs(estimate) / (tolerance * (absolute + np.maximum(np.abs(x), np.abs(new))))
    return math.sqrt(errors @ errors / errors.size), int(np.argmax(errors))


@dataclass
class LinearisedStep:
    """Inner steps of an implicit method from one point; `solvable`: whether the last matrix was regular."""

    system: OdeSystem
    motion: InputPolynomials | None  # None if all inputs are constant
    tau: float
    u: Array
    f0: Array
    jacobian: Array
    ft: Array
    solvable: bool = True

    def advance(self, method: Rosenbrock, x: Array, h: float) -> tuple[Array, Array]:
        """States after a step of size h, and error estimate."""
        nominal, k = self.system.nominal, np.zeros((len(method.alpha), x.size))
        # scaled by the nominal values, for good pivots
        matrix = -self.jacobian * nominal / nominal[:, None]
        matrix[np.diag_indices(x.size)] += 1.0 / (method.gamma * h)
        lu, pivots, singular = lapack.dgetrf(matrix, overwrite_a=True)
        self.solvable = singular == 0
        if not self.solvable:
            return x, np.full(x.size, math.nan)
        at = x
        for s, (alpha, g, a, c) in enumerate(zip(method.alpha, method.g, method.a, method.c, strict=True)):
            b = self.f0
            if any(a):  # else the stage is at the start
                at = x + np.array(a) @ k[:s]
                b = self.system.rate(at, self._inputs(alpha * h))
            if s > 0:
                b = b + np.array(c) @ k[:s] / h
            if self.motion is not None and g != 0.0:
                b = b + g * h * self.ft
            k[s] = nominal * lapack.dgetrs(lu, pivots, b / nominal)[0]
        return at + k[-1], k[-1]

    def _inputs(self, time: float) -> Array:
        return self.u if self.motion is None else self.motion.value(self.tau + time)
