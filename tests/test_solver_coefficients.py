"""The numbers of RODAS: conditions that they obey, and that the C code has the same."""

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
