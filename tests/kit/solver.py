"""The solver of the FMUs (fmus/export/native/solver.c, which explains it) a second time, in NumPy.

Only the tables of coefficients are those of the C code; `equations/test_solver_coefficients.py` holds them.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import casadi as ca
import numpy as np
from scipy.linalg import lapack

import fmus
from fmus.contract import quantities
from fmus.export.c_code import DEFAULT_TOLERANCE
from kit.equations import Part

NATIVE = Path(fmus.__file__).parent / "export" / "native"


def coefficients(file: str, name: str) -> np.ndarray:
    """A constant of the C code: a number, an array, or a matrix, whose missing numbers are zero."""
    code = (NATIVE / file).read_text(encoding="utf-8")
    (text,) = re.findall(rf"static const double {name}\b[^=]*= ([^;]*);", code)
    rows = [
        [float(top) / float(bottom or 1.0) for top, bottom in re.findall(r"(-?[\d.]+)(?: / ([\d.]+))?", row)]
        for row in re.findall(r"[^{}]*[\d.][^{}]*", text)
    ]
    size = max(len(row) for row in rows)
    found = np.array([row + [0.0] * (size - len(row)) for row in rows])
    return found if len(rows) > 1 else found[0]


@dataclass(frozen=True)
class Rosenbrock:
    """A Rosenbrock method: its coefficients as in rosenbrock.c, a and c strictly lower triangles."""

    gamma: float
    alpha: np.ndarray
    g: np.ndarray
    a: np.ndarray
    c: np.ndarray


def _rosenbrock(prefix: str) -> Rosenbrock:
    gamma, *rest = (coefficients("rosenbrock.c", prefix + n) for n in ("GAMMA", "ALPHA", "G", "A", "C"))
    return Rosenbrock(float(gamma[0]), *rest)


RODAS, RODAS3 = _rosenbrock(""), _rosenbrock("RODAS3_")
CK_NODES, CK_STAGES, *CK_WEIGHTS = (  # weights of the solutions of order 5, 4 and 3
    coefficients("runge_kutta.c", f"CK_{n}") for n in ("NODES", "STAGES", "ORDER_5", "ORDER_4", "ORDER_3")
)


class Motion:
    """Inputs over a step: polynomials of the time; coefficients (4, nu), ascending."""

    def __init__(self, polynomials: np.ndarray) -> None:
        self.m, self.varying = polynomials, bool(polynomials[1:].any())

    def value(self, tau: float) -> np.ndarray:
        return tau ** np.arange(4) @ self.m

    def derivative(self, tau: float) -> np.ndarray:
        return np.array([1.0, 2 * tau, 3 * tau**2]) @ self.m[1:]


@dataclass
class Pause:
    """Inner steps without a method that failed, and how many after its next failure."""

    left: int = 0
    next: int = 0

    def is_over(self) -> bool:
        over = self.left == 0
        self.left -= not over
        return over

    def update(self, success: bool) -> None:
        pause = min(max(self.next, 1), 16)
        self.left, self.next = (0, pause - 1) if success else (pause, 2 * pause)


class System:
    """A subsystem with its numbers as dx/dt = f(x, u)."""

    def __init__(self, part: Part) -> None:
        states, m = quantities(part.sub.states).values(), part.model
        self.nominal, self.stiff = part.nominal, part.sub.stiff
        self.absolute = np.array([q.absolute_scale for q in states])
        du, p = ca.SX.sym("du", m.u.numel()), list(part.p.values())
        results = [m.dx, ca.densify(ca.jacobian(m.dx, m.x)), ca.jtimes(m.dx, m.u, du)]
        functions = ca.Function("f", [m.x, m.u, m.p], [m.dx]), ca.Function("j", [m.x, m.u, m.p, du], results)
        self._rate, self._linearised = functions
        self._p = ca.DM(p)

    def rate(self, x: np.ndarray, u: np.ndarray) -> np.ndarray:
        return self._rate(x, u, self._p).full()[:, 0]

    def linearised(self, x: np.ndarray, u: np.ndarray, du: np.ndarray) -> tuple[np.ndarray, ...]:
        f, jacobian, ft = self._linearised(x, u, self._p, du)
        return f.full()[:, 0], jacobian.full(), ft.full()[:, 0]


def kutta(
    system: System, motion: Motion, tau: float, x: np.ndarray, h: float
) -> tuple[np.ndarray, np.ndarray, bool]:
    """States after a step, their error, and whether the step is stable."""
    k1 = system.rate(x, motion.value(tau))
    k2 = system.rate(x + 0.5 * h * k1, motion.value(tau + 0.5 * h))
    k3 = system.rate(x + h * (2.0 * k2 - k1), motion.value(tau + h))
    estimate = h / 6.0 * (k1 - 2.0 * k2 + k3)
    return x + h * k2 + estimate, estimate, _is_stable(system, k3 - k2, h * (2.0 * k2 - 1.5 * k1), h, 1.0)


def cash_karp(
    system: System, motion: Motion, tau: float, x: np.ndarray, h: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray, bool]:
    """States after a step, errors of the solutions of order 4 and 3, and whether the step is stable."""
    k, at = np.zeros((6, x.size)), [x] * 6
    for s, (node, row) in enumerate(zip(CK_NODES, CK_STAGES, strict=True)):
        at[s] = x + h * (row[:s] @ k[:s])
        k[s] = system.rate(at[s], motion.value(tau + node * h))
    fifth, fourth, third = (weights @ k for weights in CK_WEIGHTS)
    stable = _is_stable(system, k[5] - k[4], at[5] - at[4], h, 3.0)
    return x + h * fifth, h * (fifth - fourth), h * (fifth - third), stable


def _is_stable(system: System, df: np.ndarray, dx: np.ndarray, h: float, limit: float) -> bool:
    return bool(np.linalg.norm(h * df / system.nominal) <= np.linalg.norm(limit * dx / system.nominal))


class Linearised:
    """Steps of the implicit methods from one point."""

    def __init__(self, system: System, motion: Motion, tau: float, x: np.ndarray) -> None:
        self.system, self.motion, self.tau, self.x = system, motion, tau, x
        self.f, self.jacobian, self.ft = system.linearised(x, motion.value(tau), motion.derivative(tau))

    def step(self, method: Rosenbrock, h: float) -> tuple[np.ndarray, np.ndarray]:
        """States after a step, and their error."""
        nominal, k = self.system.nominal, np.zeros((method.alpha.size, self.x.size))
        matrix = np.eye(self.x.size) / (method.gamma * h) - self.jacobian * nominal / nominal[:, None]
        lu, pivots, singular = lapack.dgetrf(matrix)
        assert not singular
        for s, (alpha, g) in enumerate(zip(method.alpha, method.g, strict=True)):
            at = self.x + method.a[s, :s] @ k[:s]
            b = self.f if not s else self.system.rate(at, self.motion.value(self.tau + alpha * h))
            b = b + method.c[s, :s] @ k[:s] / h + g * h * self.ft
            k[s] = nominal * lapack.dgetrs(lu, pivots, b / nominal)[0]
        return at + k[-1], k[-1]


class Solver:
    """Steps of a subsystem, with what the solver keeps between them."""

    def __init__(self, part: Part, u: Mapping[str, float], tolerance: float = DEFAULT_TOLERANCE) -> None:
        self.part, self.system, self.tolerance, self.x = part, System(part), tolerance, part.start(u)
        self.rates = [q.rate for q in quantities(part.sub.inputs).values()]
        self.cheap, self.second, self.proposal = Pause(), Pause(), 0.0

    def step(self, length: float, **inputs: float) -> None:
        """A communication step, in which inputs move with their rate inputs."""
        rows = [self.part.u | inputs]
        for _ in range(3):
            rows.append({n: rows[-1].get(r or "", 0.0) for n, r in zip(rows[0], self.rates, strict=True)})
        motion = Motion(np.array([list(row.values()) for row in rows]) / [[1], [1], [2], [6]])
        self.proposal = self.proposal or length
        tau, rejected = 0.0, False
        while self.x.size and tau < length:
            # equal steps to the end, none larger than the proposal
            parts = max(1, math.ceil((length - tau) / self.proposal * (1.0 - 1e-9)))
            h = (length - tau) / parts
            new, error, cheap = self._try(motion, tau, h, first=not rejected, whole=h == length)
            if error <= 1.0:
                growth = min(1.0 if rejected else 5.0, 0.9 / max(error, 1e-8) ** 0.25)
                keep = cheap or growth == 5.0
                self.proposal = max(h * growth, self.proposal) if keep else h * growth
                self.x, rejected = new, False
                tau = tau + h if parts > 1 else length
            else:
                self.proposal, rejected = h * max(0.2, 0.9 / error**0.25), True

    def _try(
        self, motion: Motion, tau: float, h: float, first: bool, whole: bool
    ) -> tuple[np.ndarray, float, bool]:
        """New states, their error over the tolerance, and whether they are those of the cheap method."""
        system, x = self.system, self.x
        if first and not system.stiff:
            error = math.inf
            if self.cheap.is_over():
                new, estimate, stable = kutta(system, motion, tau, x, h)
                error = self._error(new, estimate) if stable else math.inf
                self.cheap.update(error <= 1.0)
                if error <= 1.0:
                    return new, error, True
            if self.second.is_over():
                new, fourth, third, stable = cash_karp(system, motion, tau, x, h)
                self.second.update(stable)
                error = max(15.0 * self._error(new, fourth), 0.01 * self._error(new, third))
                if stable and error <= 1.0:
                    return new, error, False
        linear = Linearised(system, motion, tau, x)
        if first and system.stiff and self.tolerance >= 1e-5 and whole and self.cheap.is_over():
            new, estimate = linear.step(RODAS3, h)
            error = 3.0 * self._error(new, estimate)
            self.cheap.update(error <= 1.0)
            if error <= 1.0:
                return new, error, True
        new, estimate = linear.step(RODAS, h)
        return new, self._error(new, estimate), False

    def _error(self, new: np.ndarray, estimate: np.ndarray) -> float:
        """Weighted root mean square of an error of new states."""
        weights = self.system.absolute + np.maximum(np.abs(self.x), np.abs(new))
        return float(np.sqrt(np.mean((estimate / weights) ** 2)) / self.tolerance)
