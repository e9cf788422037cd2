"""The numbers of both methods: conditions that they obey; the C code has the same numbers of RODAS."""

import re
from pathlib import Path

import numpy as np
import pytest

from fmus import solver

NATIVE = Path(solver.__file__).parent / "export" / "native" / "rosenbrock.c"


def square(rows) -> np.ndarray:
    """Rows of a strictly lower triangle as a matrix, shape (6, 6)."""
    return np.array([[*row, *[0.0] * (solver.STAGES - len(row))] for row in rows])


A, C = square(solver.A), square(solver.C)
GAMMA = np.linalg.inv(np.eye(solver.STAGES) / solver.GAMMA - C)  # gamma_ij of the untransformed method
STEPS = A @ GAMMA  # alpha_ij
WEIGHTS = np.append(A[-1, :-1], 1.0) @ GAMMA  # b_i of the solution: x + its last argument + k_6
EMBEDDED = A[-1] @ GAMMA  # of the embedded one: without k_6
# exact identities of the method; its coefficients are printed with 16 digits, and are up to 60
EXACT = {"rtol": 0, "atol": 1e-12}


def test_places_and_slopes_are_row_sums():
    """alpha_i = sum_j alpha_ij, g_i = sum_j gamma_ij: each coefficient of A and C counts in one of them."""
    np.testing.assert_allclose(STEPS.sum(axis=1), solver.ALPHA, **EXACT)
    np.testing.assert_allclose(GAMMA.sum(axis=1), solver.G, **EXACT)


@pytest.mark.parametrize(("b", "order"), [(WEIGHTS, 4), (EMBEDDED, 3)])
def test_order_conditions(b, order):
    """Hairer and Wanner, section IV.7, (7.11): up to order 4 of the solution, 3 of the embedded one."""
    alpha, beta = STEPS.sum(axis=1), (STEPS + GAMMA).sum(axis=1)
    full = STEPS + GAMMA
    conditions = {
        "1": (b.sum(), 1.0),
        "2": (b @ beta, 1 / 2),
        "3a": (b @ alpha**2, 1 / 3),
        "3b": (b @ full @ beta, 1 / 6),
    }
    if order == 4:
        conditions |= {
            "4a": (b @ alpha**3, 1 / 4),
            "4b": (b @ (alpha * (STEPS @ beta)), 1 / 8),
            "4c": (b @ full @ alpha**2, 1 / 12),
            "4d": (b @ full @ full @ beta, 1 / 24),
        }
    for name, (found, wanted) in conditions.items():
        assert found == pytest.approx(wanted, abs=1e-12), name


def test_the_last_stages_are_stiffly_accurate():
    """The solution is the last stage: R(infinity) = 0, so stiff components are damped out in one step."""
    np.testing.assert_allclose(WEIGHTS, (STEPS + GAMMA)[-1], **EXACT)


def test_the_c_code_has_the_same_numbers():
    """GAMMA, ALPHA, G, A and C as in native/rosenbrock.c, digit by digit."""
    code = NATIVE.read_text(encoding="utf-8")

    def numbers(name: str) -> list[float]:
        (text,) = re.findall(rf"static const double {name}\b[^=]*= ([^;]*);", code)
        return [float(n) for n in re.findall(r"-?\d+(?:\.\d+)?(?:e-?\d+)?", text)]

    flat = {"A": [0.0, *np.concatenate(solver.A)], "C": [0.0, *np.concatenate(solver.C)]}
    for name in ("GAMMA", "ALPHA", "G", "A", "C"):
        assert numbers(name) == [*np.ravel(flat.get(name, getattr(solver, name)))], name


class Linear:
    """dx/dt = rate x + u."""

    nominal, absolute, stiff = np.ones(1), np.ones(1), False

    def __init__(self, rate: float) -> None:
        self.factor = rate

    def rate(self, x, u):
        return self.factor * x + u

    def linearised(self, x, u, du):
        return self.rate(x, u), np.array([[self.factor]]), du


def inputs(*coefficients: float) -> solver.InputPolynomials:
    """An input that is this polynomial of the time."""
    return solver.InputPolynomials(np.array([*coefficients, *[0.0] * (4 - len(coefficients))])[:, None])


@pytest.mark.parametrize("z", [-1.1, -0.9, -0.3, 0.5])
def test_kuttas_method_is_the_series_of_the_exponential(z):
    """Of dx/dt = lambda x it takes 1 + z + z^2/2 + z^3/6; its error is the last term; stable to |z| = 1."""
    new, estimate, stable = solver.kutta(Linear(z / 0.2), inputs(0.0), 0.0, np.array([3.0]), 0.2)
    # exact identities: rounding only
    assert new[0] == pytest.approx(3 * (1 + z + z**2 / 2 + z**3 / 6), rel=1e-14)
    assert estimate[0] == pytest.approx(3 * z**3 / 6, rel=1e-12)
    assert stable == (abs(z) < 1)


def test_inputs_that_move_are_integrated_exactly():
    """Of dx/dt = u(t) Kutta and the embedded method integrate a parabola exactly, RODAS a cubic."""
    h, late, x = 0.7, 0.4, np.array([2.0])
    for degree in (2, 3):
        coefficients = (5.0, -3.0, 2.0, 4.0 * (degree - 2))
        motion, integral = inputs(*coefficients), np.polynomial.Polynomial(coefficients).integ()
        exact = x[0] + integral(late + h) - integral(late)
        new, estimate = solver._linearised(Linear(0.0), motion, late, x).advance(x, h)
        # exact identities but for the 16 digits of the coefficients, which are up to 60
        assert new[0] == pytest.approx(exact, abs=1e-12)
        assert (abs(estimate[0]) < 1e-12) == (degree == 2)
        if degree == 2:
            new, estimate, _ = solver.kutta(Linear(0.0), motion, late, x, h)
            assert new[0] == pytest.approx(exact, rel=1e-14)
            # Simpson's rule less the midpoint rule: h^3 u''/24
            assert estimate[0] == pytest.approx(h**3 * 4.0 / 24, rel=1e-12)
