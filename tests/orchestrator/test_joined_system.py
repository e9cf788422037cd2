"""The joined linear system compared with the exact solution of its equations."""

from ctypes import byref, c_double

import numpy as np
import pytest
from scipy.linalg import expm, lu_factor

from orchestrator.engine.c_library import Binding, library
from orchestrator.engine.linear_system import JoinedSystem
from orchestrator.fmi.calls import address


class Joined(JoinedSystem):
    """A joined system with the functions of the engine."""

    def join(self):
        self.binding = Binding()
        self.state = self.struct(self.binding)
        library().linear_system_join(byref(self.state.system))

    def predict(self, h):
        library().prediction_prepare(byref(self.state), c_double(h))
        library().prediction_solve(byref(self.state))


def random(n, m, seed, direct=True):
    """A joined system with random matrices, and A + B K C, B K, K C and K without padding."""
    rng = np.random.default_rng(seed)
    joined = Joined(n, m)
    joined.has_feedthrough = direct
    a, b, c = rng.normal(size=(n, n)) - 2 * np.eye(n), rng.normal(size=(n, m)), rng.normal(size=(m, n))
    d = 0.3 * rng.normal(size=(m, m)) / m if direct else np.zeros((m, m))
    joined.a[:, :n], joined.b[:, :n], joined.c[:, :m], joined.d[:, :m] = a.T, b.T, c.T, d.T
    joined.f[:n], joined.course[:, :m] = rng.normal(size=n), rng.normal(size=(3, m))
    k = np.linalg.inv(np.eye(m) - d)
    return joined, (a + b @ k @ c, b @ k, k @ c, k)


def exact(joined, matrices, h):
    """The change of the inputs up to h/3, 2h/3 and h: states and powers of time as one linear system."""
    closed, push, told, k = matrices
    n, m = joined.n, joined.m
    course = joined.course[:, :m]
    big = np.zeros((n + 4, n + 4))
    big[:n, :n], big[:n, n] = closed, joined.f[:n]
    for power in range(3):  # the columns behind f are for s, s^2 and s^3
        big[:n, n + 1 + power] = push @ course[power]
        big[n + 1 + power, n + power] = power + 1
    found = []
    for s in (h / 3, 2 * h / 3, h):
        state = (expm(big * s) @ np.eye(n + 4)[n])[:n]
        found.append(told @ state + k @ (course.T @ [s, s**2, s**3]))
    return np.array(found)


@pytest.mark.parametrize("direct", [False, True])
@pytest.mark.parametrize(("n", "m"), [(1, 1), (5, 3), (8, 8), (18, 15)])
def test_the_prediction_converges_with_order_three(n, m, direct):
    """Three steps of a method of order three: halving the step divides the error of the end by sixteen."""
    joined, matrices = random(n, m, n, direct)
    errors = []
    for h in (0.02, 0.01):
        joined.join()
        joined.predict(h)
        errors.append(np.max(np.abs(joined.v[:, :m] - exact(joined, matrices, h))))
    # the local error of order three goes with h^4
    assert np.log2(errors[0] / errors[1]) == pytest.approx(4, abs=0.3)


def test_a_stiff_system_comes_to_rest():
    """Far beyond the fast rates the changes are those of the equilibrium: the method is L-stable."""
    joined = Joined(2, 2)
    joined.a[0, 0], joined.a[1, 1] = -1e9, -1e7
    joined.c[0, 0] = joined.c[1, 1] = 1.0
    joined.f[:2] = 3e9, -2e7
    joined.join()
    joined.predict(0.1)
    # the stability function falls with one over the fast rate times the step, 1e-6 and less
    np.testing.assert_allclose(joined.v[:, :2], [[3.0, -2.0]] * 3, rtol=1e-5)


def test_connections_without_a_solution_are_no_system():
    """Outputs that are copied to their own inputs have no unique solution."""
    joined = Joined(1, 2)
    joined.has_feedthrough = True
    joined.d[0, 1] = joined.d[1, 0] = 1.0
    joined.join()
    assert not joined.state.system.usable


@pytest.mark.parametrize("n", [1, 2, 7, 18])
def test_inverse(n):
    """Matrix times inverse is the identity, also if rows must be exchanged; a singular one has none."""
    matrix = np.random.default_rng(n).normal(size=(n, n))
    np.fill_diagonal(matrix, 0.0 if n > 1 else 2.0)
    wide = -(-n // 8) * 8  # rows are padded
    found, rows = np.zeros((n, wide)), np.zeros(n, np.int32)
    assert not library().matrix_invert(address(found), address(rows), n, wide)
    found[:, :n] = matrix
    assert library().matrix_invert(address(found), address(rows), n, wide)
    # rounding times the condition of the matrix, below 1e4
    np.testing.assert_allclose(found[:, :n] @ matrix, np.eye(n), atol=1e-11)
    assert rows.tolist() == lu_factor(matrix)[1].tolist()  # the largest pivots
    if n > 1:
        assert not library().matrix_invert(address(np.ones((n, wide))), address(rows), n, wide)
