"""The coefficients of the methods in the C code, and their steps in NumPy: conditions that they obey."""

import math
from itertools import chain

import numpy as np
import pytest
from kit import solver


def square(rows: np.ndarray) -> np.ndarray:
    """A strictly lower triangle, whose last column is missing, as a matrix."""
    return np.hstack([rows, np.zeros((len(rows), 1))])


class Untransformed:
    """A Rosenbrock method in the notation of Hairer and Wanner, section IV.7, (7.4).

    gamma, steps   gamma_ij and alpha_ij
    b, embedded    weights of the solution, x + its last argument + the last k, and of the embedded one
    """

    def __init__(self, method: solver.Rosenbrock) -> None:
        a, n = square(method.a), len(method.alpha)
        self.gamma = np.linalg.inv(np.eye(n) / method.gamma - square(method.c))
        self.steps = a @ self.gamma
        self.b = np.append(a[-1, :-1], 1.0) @ self.gamma
        self.embedded = a[-1] @ self.gamma


METHODS = {"RODAS": solver.RODAS, "RODAS3": solver.RODAS3}
# exact identities of the methods; the coefficients are printed with 16 digits, and are up to 60
EXACT = {"rtol": 0, "atol": 1e-12}


@pytest.mark.parametrize("name", METHODS)
def test_places_and_slopes_are_row_sums(name):
    """alpha_i = sum_j alpha_ij, g_i = sum_j gamma_ij: each coefficient of A and C counts in one of them."""
    m = Untransformed(METHODS[name])
    np.testing.assert_allclose(m.steps.sum(axis=1), METHODS[name].alpha, **EXACT)
    np.testing.assert_allclose(m.gamma.sum(axis=1), METHODS[name].g, **EXACT)


@pytest.mark.parametrize(
    ("name", "which", "order"),
    [("RODAS", "b", 4), ("RODAS", "embedded", 3), ("RODAS3", "b", 3), ("RODAS3", "embedded", 2)],
)
def test_order_conditions(name, which, order):
    """Hairer and Wanner, section IV.7, (7.11): up to the order of the solution and of the embedded one."""
    m = Untransformed(METHODS[name])
    b, alpha, full = getattr(m, which), m.steps.sum(axis=1), m.steps + m.gamma
    beta = full.sum(axis=1)
    conditions = [
        [(b.sum(), 1.0)],
        [(b @ beta, 1 / 2)],
        [(b @ alpha**2, 1 / 3), (b @ full @ beta, 1 / 6)],
        [
            (b @ alpha**3, 1 / 4),
            (b @ (alpha * (m.steps @ beta)), 1 / 8),
            (b @ full @ alpha**2, 1 / 12),
            (b @ full @ full @ beta, 1 / 24),
        ],
    ]
    for found, wanted in chain(*conditions[:order]):
        assert found == pytest.approx(wanted, abs=1e-12)
    # no more than that: else the difference of both solutions would not estimate the error
    assert any(abs(found - wanted) > 1e-3 for found, wanted in [*conditions, [(0.0, 1.0)]][order])


@pytest.mark.parametrize("name", METHODS)
def test_the_last_stages_are_stiffly_accurate(name):
    """The solution is the last stage: R(infinity) = 0, so stiff components are damped out in one step."""
    m = Untransformed(METHODS[name])
    np.testing.assert_allclose(m.b, (m.steps + m.gamma)[-1], **EXACT)


@pytest.mark.parametrize("order", [5, 4, 3])
def test_order_conditions_of_cash_and_karp(order):
    """Hairer, Norsett, Wanner, Solving Ordinary Differential Equations I, table II.2.2: all trees."""
    a, c = square(solver.CK_STAGES), solver.CK_NODES
    b = solver.CK_WEIGHTS[5 - order]
    np.testing.assert_allclose(a.sum(axis=1), c, rtol=0, atol=1e-15)
    conditions = [
        [(b.sum(), 1)],
        [(b @ c, 2)],
        [(b @ c**2, 3), (b @ a @ c, 6)],
        [(b @ c**3, 4), (b @ (c * (a @ c)), 8), (b @ a @ c**2, 12), (b @ a @ a @ c, 24)],
        [
            *((b @ c**4, 5), (b @ (c**2 * (a @ c)), 10), (b @ (c * (a @ c**2)), 15)),
            *((b @ (c * (a @ a @ c)), 30), (b @ (a @ c) ** 2, 20), (b @ a @ c**3, 20)),
            *((b @ a @ (c * (a @ c)), 40), (b @ a @ a @ c**2, 60), (b @ a @ a @ a @ c, 120)),
        ],
    ]
    for found, divisor in chain(*conditions[:order]):
        assert found == pytest.approx(1 / divisor, abs=1e-15)  # rounding of numbers of the size of 1
    assert any(abs(found - 1 / d) > 1e-4 for found, d in [*conditions, [(0.0, 1)]][order])


class Linear:
    """dx/dt = rate x + u."""

    nominal = np.ones(1)

    def __init__(self, rate: float) -> None:
        self.factor = rate

    def rate(self, x, u):
        return self.factor * x + u

    def linearised(self, x, u, du):
        return self.rate(x, u), np.array([[self.factor]]), du


def inputs(*coefficients: float) -> solver.Motion:
    """An input that is this polynomial of the time."""
    return solver.Motion(np.array([*coefficients, *[0.0] * (4 - len(coefficients))])[:, None])


@pytest.mark.parametrize("z", [-1.1, -0.9, -0.3, 0.5])
def test_kuttas_method_is_the_series_of_the_exponential(z):
    """Of dx/dt = lambda x it takes 1 + z + z^2/2 + z^3/6; its error is the last term; stable to |z| = 1."""
    new, estimate, stable = solver.kutta(Linear(z / 0.2), inputs(0.0), 0.0, np.array([3.0]), 0.2)
    # exact identities: rounding only
    assert new[0] == pytest.approx(3 * (1 + z + z**2 / 2 + z**3 / 6), rel=1e-14)
    assert estimate[0] == pytest.approx(3 * z**3 / 6, rel=1e-12)
    assert stable == (abs(z) < 1)


@pytest.mark.parametrize("z", [-3.1, -2.9, -0.3, 0.5])
def test_cash_and_karps_method_is_the_series_of_the_exponential(z):
    """Of dx/dt = lambda x all three solutions take as many terms as their order; stable to |z| = 3."""
    new, fourth, third, stable = solver.cash_karp(Linear(z / 0.2), inputs(0.0), 0.0, np.array([3.0]), 0.2)
    terms = np.cumsum([z**n / math.factorial(n) for n in range(6)])
    # the coefficients of z^5 and z^6 that the orders leave free: b A^4 1 and b A^5 1 of the table
    a = square(solver.CK_STAGES)

    def tail(b, first):
        return sum(z**n * (b @ np.linalg.matrix_power(a, n - 1)).sum() for n in range(first, 7))

    fifth, lower, lowest = (
        terms[order] + tail(solver.CK_WEIGHTS[5 - order], order + 1) for order in (5, 4, 3)
    )
    # exact identities: rounding only
    assert new[0] == pytest.approx(3 * fifth, rel=1e-13)
    assert fourth[0] == pytest.approx(3 * (fifth - lower), abs=1e-13)
    assert third[0] == pytest.approx(3 * (fifth - lowest), abs=1e-13)
    assert stable == (abs(z) < 3)


def test_inputs_that_move_are_integrated_exactly():
    """Of dx/dt = u(t) Kutta and RODAS3 integrate a parabola exactly, RODAS a cubic, Cash and Karp too.

    So do the embedded methods with one degree less; those of Cash and Karp of order 4 and 3.
    """
    h, late, x = 0.7, 0.4, np.array([2.0])
    for degree in (2, 3):
        coefficients = (5.0, -3.0, 2.0, 4.0 * (degree - 2))
        motion, integral = inputs(*coefficients), np.polynomial.Polynomial(coefficients).integ()
        exact = x[0] + integral(late + h) - integral(late)
        new, estimate = solver.Linearised(Linear(0.0), motion, late, x).step(solver.RODAS, h)
        # exact identities but for the 16 digits of the coefficients, which are up to 60
        assert new[0] == pytest.approx(exact, abs=1e-12)
        assert (abs(estimate[0]) < 1e-12) == (degree == 2)
        new, fourth, third, _ = solver.cash_karp(Linear(0.0), motion, late, x, h)
        assert new[0] == pytest.approx(exact, abs=1e-12)
        assert abs(fourth[0]) < 1e-12
        assert (abs(third[0]) < 1e-12) == (degree == 2)
        if degree == 2:
            low, estimate = solver.Linearised(Linear(0.0), motion, late, x).step(solver.RODAS3, h)
            assert low[0] == pytest.approx(exact, abs=1e-12)
            assert abs(estimate[0]) > 1e-3
            new, estimate, _ = solver.kutta(Linear(0.0), motion, late, x, h)
            assert new[0] == pytest.approx(exact, rel=1e-14)
            # Simpson's rule less the midpoint rule: h^3 u''/24
            assert estimate[0] == pytest.approx(h**3 * 4.0 / 24, rel=1e-12)
