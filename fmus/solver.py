"""The solver of the C code (export/native/solver.c) once more in NumPy, to be read and compared.

Inner steps with error control, by an implicit method. Of a model that is not declared stiff each is tried
with an explicit method first; where its error is too large or it is not stable, the implicit one does it, and
the explicit one rests: for 8 inner steps at first, for up to 1024 where it fails again and again.

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

STAGES, MOST_STEPS = 6, 1_000_000
SHORTEST_REST, LONGEST_REST = 8, 1024
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


class System(Protocol):
    """dx/dt = f(x, u); what it returns may be overwritten by its next call.

    nominal      magnitudes of the states
    absolute     their absolute tolerances over the relative one
    stiff        is the explicit method left out?
    rate         f
    linearised   f, df/dx and df/du du
    """

    nominal: Array
    absolute: Array
    stiff: bool

    def rate(self, x: Array, u: Array) -> Array: ...
    def linearised(self, x: Array, u: Array, du: Array) -> tuple[Array, Array, Array]: ...


@dataclass(frozen=True)
class Motion:
    """Inputs over a step: u = sum over k of coefficients[k] tau^k, tau [s] since its start; shape (4, nu)."""

    coefficients: Array

    @property
    def moving(self) -> bool:
        """Does any input change?"""
        return bool(self.coefficients[1:].any())

    def value(self, tau: float) -> Array:
        """The inputs at tau."""
        m = self.coefficients
        u: Array = m[0] + tau * (m[1] + tau * (m[2] + tau * m[3]))
        return u

    def slope(self, tau: float) -> Array:
        """Their time derivatives at tau."""
        m = self.coefficients
        du: Array = m[1] + tau * (2 * m[2] + tau * 3 * m[3])
        return du


class Unsolved(Exception):
    """The solver gave up.

    why     "not finite", "singular", "small" or "many": the derivative, the Jacobian, the step, the steps
    tau     how far it came [s]
    step    last step tried [s]
    worst   index of the state with the largest error, or of the derivative that is not finite
    value   of that derivative
    x       states at tau
    """

    def __init__(self, why: str, tau: float, step: float, worst: int, value: float, x: Array) -> None:
        super().__init__(why)
        self.why, self.tau, self.step, self.worst, self.value, self.x = why, tau, step, worst, value, x


@dataclass
class Pace:
    """What the solver remembers from step to step; all zero at first.

    step       proposal for the next inner step [s], 0 if none
    rest       inner steps for which the explicit method rests, because it failed
    patience   how many it rests when it fails the next time
    """

    step: float = 0.0
    rest: int = 0
    patience: int = 0

    def its_turn(self) -> bool:
        """Is the explicit method to be tried?"""
        if self.rest <= 0:
            return True
        self.rest -= 1
        return False

    def learn(self, success: bool) -> None:
        """After a trial of the explicit method."""
        patience = min(max(self.patience, SHORTEST_REST), LONGEST_REST)
        self.rest = 0 if success else patience
        self.patience = patience - 1 if success else 2 * patience


def solve(
    system: System, x: Array, motion: Motion, length: float, tolerance: float, memory: Array
) -> tuple[Array, Array]:
    """The states after `length` seconds, and the memory for the next call.

    memory   what the last call returned, zeros at first; shape (3,), the numbers of `Pace`
    """
    pace = Pace(float(memory[0]), int(memory[1]), int(memory[2]))
    with np.errstate(all="ignore"):  # what is not finite is looked at here
        x = _solve(system, x, motion, length, tolerance, pace)
    return x, np.array([pace.step, pace.rest, pace.patience])


def _solve(system: System, x: Array, motion: Motion, length: float, tolerance: float, pace: Pace) -> Array:
    smallest = max(1e-14 * length, sys.float_info.min)  # with smaller ones the time stands still
    tau, worst, rejected, count, proposal = 0.0, 0, False, 0, pace.step or length
    stage: Stage | None = None  # the linearised model at tau
    while tau < length:
        # Equal steps to the end, none larger than the proposal: no tiny last step.
        parts = math.ceil((length - tau) / proposal * (1.0 - 1e-9))
        h = (length - tau) / parts if parts > 1 else length - tau
        if count == MOST_STEPS:
            raise Unsolved("many", tau, h, worst, 0.0, x)
        count += 1
        error, new = math.inf, x
        if stage is None and not system.stiff and pace.its_turn():
            new, estimate, calm = kutta(system, motion, tau, x, h)
            error, worst = _error(x, new, estimate, tolerance, system.absolute)
            error = error if calm else math.inf
            pace.learn(error <= 1.0)  # a comparison with NaN is false
        if not error <= 1.0:
            stage = stage or _linearised(system, motion, tau, x)
            new, estimate = stage.advance(x, h)
            error, worst = _error(x, new, estimate, tolerance, system.absolute)
        if error <= 1.0:
            # Order of the estimate of RODAS is 3, so its error grows with h^4; that of the other with h^3.
            growth = min(5.0, 0.9 / max(error, 1e-8) ** 0.25)
            following = h * (min(1.0, growth) if rejected else growth)
            # A step cut short by the end of the interval says nothing against the old proposal.
            proposal = following if growth < 5.0 or rejected else max(following, proposal)
            x, rejected, stage = new, False, None
            tau = tau + h if parts > 1 else length
        else:
            proposal = h * (max(0.2, 0.9 / error**0.25) if error < sys.float_info.max else 0.2)
            rejected = True
            if proposal < smallest:
                why = "small" if stage is None or stage.solvable else "singular"
                raise Unsolved(why, tau, h, worst, 0.0, x)
    pace.step = proposal
    return x


def kutta(system: System, motion: Motion, tau: float, x: Array, h: float) -> tuple[Array, Array, bool]:
    """The states after an explicit step of size h, the error estimate, and whether the step is stable.

    Between the last two stages dx/dt changes by lambda = (k_3 - k_2) / (x_3 - x_2): stable if |lambda h| < 1.
    """
    k1 = system.rate(x, motion.value(tau)).copy()
    k2 = system.rate(x + 0.5 * h * k1, motion.value(tau + 0.5 * h)).copy()
    k3 = system.rate(x + h * (2.0 * k2 - k1), motion.value(tau + h))
    estimate = h / 6.0 * (k1 - 2.0 * k2 + k3)
    change, moved = ((k3 - k2) / system.nominal, (2.0 * k2 - 1.5 * k1) / system.nominal)
    return x + h * k2 + estimate, estimate, bool(change @ change <= moved @ moved)


def _linearised(system: System, motion: Motion, tau: float, x: Array) -> Stage:
    u = motion.value(tau)
    f, jacobian, ft = system.linearised(x, u, motion.slope(tau))
    if not np.isfinite(f).all():
        bad = int(np.argmin(np.isfinite(f)))
        raise Unsolved("not finite", tau, 0.0, bad, float(f[bad]), x)
    return Stage(system, motion if motion.moving else None, tau, u, f.copy(), jacobian, ft)


def _error(x: Array, new: Array, estimate: Array, tolerance: float, absolute: Array) -> tuple[float, int]:
    """Weighted root mean square of the error estimate, and where it is largest."""
    parts = np.abs(estimate) / (tolerance * (absolute + np.maximum(np.abs(x), np.abs(new))))
    return math.sqrt(parts @ parts / parts.size), int(np.argmax(parts))


@dataclass
class Stage:
    """The stages of RODAS from one point; `solvable` tells whether the last matrix was regular."""

    system: System
    motion: Motion | None  # None while all inputs stand still
    tau: float
    u: Array
    f0: Array
    jacobian: Array
    ft: Array
    solvable: bool = True

    def advance(self, x: Array, h: float) -> tuple[Array, Array]:
        """The states after a step of size h, and the error estimate."""
        nominal, k = self.system.nominal, np.zeros((STAGES, x.size))
        # in units of the magnitudes, for the sake of the pivots
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
