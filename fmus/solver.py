"""The solver of the FMUs (export/native/solver.c) in NumPy: for Python FMUs, and as a reference for tests.

An implicit method takes inner steps with error control. If the model is not declared stiff, an explicit
method tries each inner step first. If its error is too large or it is unstable, the implicit method takes the
step, and the explicit method is suspended: for 8 inner steps at first, for up to 1024 after repeated
failures.

Explicit: Kutta's method of order 3 with the midpoint rule of order 2 inside (native/kutta.c).
Implicit: RODAS (native/rosenbrock.c), a linearly implicit Runge-Kutta method of order 4 with an embedded one
of order 3, L-stable and stiffly accurate, six stages, one Jacobian and one LU factorisation per step:

    (I / (gamma h) - J) k_i = f(t + alpha_i h, x + sum_j a_ij k_j) + sum_j c_ij / h k_j + g_i h f_t

The last two stages are the embedded and the final correction, so k_6 is the error estimate.
Coefficients: E. Hairer, G. Wanner, Solving Ordinary Differential Equations II, 2nd ed.,
section IV.7 and program RODAS.
"""

from __future__ import annotations

import math
import sys
from dataclasses import dataclass
from typing import Protocol, TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lapack

Array: TypeAlias = NDArray[np.float64]

STAGES = 6
MAX_STEPS = 1_000_000  # inner steps in one call
SHORTEST_PAUSE, LONGEST_PAUSE = 8, 1024  # inner steps without the explicit method
GAMMA = 0.25
ALPHA = (0.0, 0.386, 0.21, 0.63, 1.0, 1.0)
G = (0.25, -0.1043, 0.1035, -0.0362, 0.0, 0.0)
A = tuple(
    np.array(row)
    for row in (
        (),
        (1.544,),
        (0.9466785280815826, 0.2557011698983284),
        (3.314825187068521, 2.896124015972201, 0.9986419139977817),
        (1.221224509226641, 6.019134481288629, 12.53708332932087, -0.6878860361058950),
        (1.221224509226641, 6.019134481288629, 12.53708332932087, -0.6878860361058950, 1.0),
    )
)
C = tuple(
    np.array(row)
    for row in (
        (),
        (-5.6688,),
        (-2.430093356833875, -0.2063599157091915),
        (-0.1073529058151375, -9.594562251023355, -20.47028614809616),
        (7.496443313967647, -10.24680431464352, -33.99990352819905, 11.70890893206160),
        (8.083246795921522, -7.981132988064893, -31.52159432874371, 16.31930543123136, -6.058818238834054),
    )
)


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
class StepMemory:
    """Memory of the solver from step to step; all zero at first.

    step         proposal for the next inner step [s], 0 without one
    pause        remaining inner steps without the explicit method, because it failed
    next_pause   length of the pause after the next failure
    """

    step: float = 0.0
    pause: int = 0
    next_pause: int = 0

    def explicit_is_due(self) -> bool:
        """Whether the explicit method is tried for this inner step; counts the pause down."""
        if self.pause <= 0:
            return True
        self.pause -= 1
        return False

    def update(self, success: bool) -> None:
        """Set the pauses after a trial of the explicit method."""
        pause = min(max(self.next_pause, SHORTEST_PAUSE), LONGEST_PAUSE)
        self.pause = 0 if success else pause
        self.next_pause = pause - 1 if success else 2 * pause


def solve(
    system: OdeSystem, x: Array, motion: InputPolynomials, length: float, tolerance: float, memory: Array
) -> tuple[Array, Array]:
    """States after `length` seconds, and the memory for the next call.

    memory   memory from the last call, zeros at first; shape (3,), the fields of `StepMemory`
    """
    step_memory = StepMemory(float(memory[0]), int(memory[1]), int(memory[2]))
    with np.errstate(all="ignore"):  # values that are not finite are handled here
        x = _solve(system, x, motion, length, tolerance, step_memory)
    return x, np.array([step_memory.step, step_memory.pause, step_memory.next_pause])


def _solve(
    system: OdeSystem,
    x: Array,
    motion: InputPolynomials,
    length: float,
    tolerance: float,
    step_memory: StepMemory,
) -> Array:
    smallest = max(1e-14 * length, sys.float_info.min)  # smaller steps do not change the time
    tau, worst, rejected, count, proposal = 0.0, 0, False, 0, step_memory.step or length
    rodas: RodasStep | None = None  # the linearised model at tau
    while tau < length:
        # Equal steps to the end, none larger than the proposal: no tiny last step.
        parts = math.ceil((length - tau) / proposal * (1.0 - 1e-9))
        h = (length - tau) / parts if parts > 1 else length - tau
        if count == MAX_STEPS:
            raise Unsolved("many", tau, h, worst, 0.0, x)
        count += 1
        error, new = math.inf, x
        if rodas is None and not system.stiff and step_memory.explicit_is_due():
            new, estimate, stable = kutta(system, motion, tau, x, h)
            error, worst = _error(x, new, estimate, tolerance, system.absolute)
            error = error if stable else math.inf
            step_memory.update(error <= 1.0)  # a comparison with NaN is false
        if not error <= 1.0:
            rodas = rodas or _linearised(system, motion, tau, x)
            new, estimate = rodas.advance(x, h)
            error, worst = _error(x, new, estimate, tolerance, system.absolute)
        if error <= 1.0:
            # The error grows with h^4 in RODAS (order 3 of the estimate), with h^3 in the explicit method.
            growth = min(5.0, 0.9 / max(error, 1e-8) ** 0.25)
            following = h * (min(1.0, growth) if rejected else growth)
            # A step shortened by the end of the interval does not reduce the old proposal.
            proposal = following if growth < 5.0 or rejected else max(following, proposal)
            x, rejected, rodas = new, False, None
            tau = tau + h if parts > 1 else length
        else:
            proposal = h * (max(0.2, 0.9 / error**0.25) if error < sys.float_info.max else 0.2)
            rejected = True
            if proposal < smallest:
                why = "small" if rodas is None or rodas.solvable else "singular"
                raise Unsolved(why, tau, h, worst, 0.0, x)
    step_memory.step = proposal
    return x


def kutta(
    system: OdeSystem, motion: InputPolynomials, tau: float, x: Array, h: float
) -> tuple[Array, Array, bool]:
    """States after an explicit step of size h, error estimate, and whether the step is stable.

    Between the last two stages dx/dt changes by lambda = (k_3 - k_2) / (x_3 - x_2): stable if |lambda h| < 1.
    """
    k1 = system.rate(x, motion.value(tau)).copy()
    k2 = system.rate(x + 0.5 * h * k1, motion.value(tau + 0.5 * h)).copy()
    k3 = system.rate(x + h * (2.0 * k2 - k1), motion.value(tau + h))
    estimate = h / 6.0 * (k1 - 2.0 * k2 + k3)
    rate_change, state_change = ((k3 - k2) / system.nominal, (2.0 * k2 - 1.5 * k1) / system.nominal)
    return x + h * k2 + estimate, estimate, bool(rate_change @ rate_change <= state_change @ state_change)


def _linearised(system: OdeSystem, motion: InputPolynomials, tau: float, x: Array) -> RodasStep:
    u = motion.value(tau)
    f, jacobian, ft = system.linearised(x, u, motion.derivative(tau))
    if not np.isfinite(f).all():
        index = int(np.argmin(np.isfinite(f)))
        raise Unsolved("not finite", tau, 0.0, index, float(f[index]), x)
    return RodasStep(system, motion if motion.varying else None, tau, u, f.copy(), jacobian, ft)


def _error(x: Array, new: Array, estimate: Array, tolerance: float, absolute: Array) -> tuple[float, int]:
    """Weighted root mean square of the error estimate, and the index of the largest error."""
    errors = np.abs(estimate) / (tolerance * (absolute + np.maximum(np.abs(x), np.abs(new))))
    return math.sqrt(errors @ errors / errors.size), int(np.argmax(errors))


@dataclass
class RodasStep:
    """Inner steps of RODAS from one point; `solvable`: whether the last matrix was regular."""

    system: OdeSystem
    motion: InputPolynomials | None  # None if all inputs are constant
    tau: float
    u: Array
    f0: Array
    jacobian: Array
    ft: Array
    solvable: bool = True

    def advance(self, x: Array, h: float) -> tuple[Array, Array]:
        """States after a step of size h, and error estimate."""
        nominal, k = self.system.nominal, np.zeros((STAGES, x.size))
        # scaled by the nominal values, for good pivots
        matrix = -self.jacobian * nominal / nominal[:, None]
        matrix[np.diag_indices(x.size)] += 1.0 / (GAMMA * h)
        lu, pivots, singular = lapack.dgetrf(matrix, overwrite_a=True)
        self.solvable = singular == 0
        if not self.solvable:
            return x, np.full(x.size, math.nan)
        at = x
        for s in range(STAGES):
            b = self.f0
            if s > 0:
                at = x + A[s] @ k[:s]
                b = self.system.rate(at, self._inputs(s, h)) + C[s] @ k[:s] / h
            if self.motion is not None and s < 4:
                b = b + G[s] * h * self.ft
            k[s] = nominal * lapack.dgetrs(lu, pivots, b / nominal)[0]
        return at + k[-1], k[-1]

    def _inputs(self, s: int, h: float) -> Array:
        return self.u if self.motion is None else self.motion.value(self.tau + ALPHA[s] * h)
