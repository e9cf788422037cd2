"""The linear systems of the solver: as NumPy solves them, or reported as inaccurate."""

import casadi as ca
import numpy as np
import pytest
from kit.mistakes import table

from fmus.export.elimination import eliminate, nonzeros, pivot_order


def system(pattern, constants=()):
    """Functions (diagonal, J) -> accurate and (diagonal, J, b) -> k for a pattern of places."""
    n = len(pattern)
    places = np.argwhere(np.array(pattern))
    values = ca.SX(n, n)
    for i, j in places:
        values[i, j] = dict(constants).get((i, j), ca.SX.sym(f"j{i}{j}"))
    e = eliminate(values)
    moving = [place for place in map(tuple, places) if place not in dict(constants)]
    factorise = ca.Function("factorise", [e.diagonal, e.jac], [e.factors, e.accurate])
    solve = ca.Function("solve", [e.lu, e.b], [e.k])

    def run(diagonal, j, b):
        factors, accurate = factorise(diagonal, [j[place] for place in moving])
        return bool(accurate), solve(factors, b).full()[:, 0]

    return run


@pytest.mark.parametrize("seed", range(5))
def test_solution_is_that_of_numpy(seed):
    """Random diagonally dominant matrices, with a constant entry, are solved accurately."""
    rng = np.random.default_rng(seed)
    n = 7
    pattern = rng.random((n, n)) < 0.4
    pattern[0, 1] = True
    j = np.where(pattern, rng.normal(size=(n, n)), 0.0)
    j[0, 1] = 1.0
    b = rng.normal(size=n)
    trusted, k = system(pattern, {(0, 1): 1.0}.items())(10.0, j, b)
    assert trusted
    # rounding of some ten operations on numbers of size one
    np.testing.assert_allclose(k, np.linalg.solve(10.0 * np.eye(n) - j, b), rtol=1e-12, atol=1e-14)


def test_units_of_the_states_do_not_matter():
    """The system of a chamber and a line is accurate in any units."""
    j = np.array([[0.0, 1e12], [-1e-7, -1e3]])
    b = np.array([3.0, 4.0])
    expected = np.linalg.solve(4e3 * np.eye(2) - j, b)
    for scale in (1.0, 1e10, 1e-10):
        units = np.diag([scale, 1.0])
        trusted, k = system(j != 0)(4e3, units @ j @ np.linalg.inv(units), units @ b)
        assert trusted
        # the condition in good units is some hundred
        np.testing.assert_allclose(np.linalg.solve(units, k), expected, rtol=1e-12)


@table(__file__, "inaccurate", "j")
def test_inaccurate_factors_are_not_trusted(j):
    """At diagonal 4 the factors are inaccurate; a larger diagonal, as of a shorter step, helps."""
    trusted, _ = system([[True, True], [True, True]])(4.0, np.array(j), np.ones(2))
    assert not trusted
    trusted, _ = system([[True, True], [True, True]])(40.0, np.array(j), np.ones(2))
    assert trusted == bool(np.isfinite(j).all())


def test_order_fills_nothing_in_where_that_is_possible():
    """In an arrow matrix the tip is the last pivot, so there is no fill-in."""
    n = 6
    pattern = np.eye(n, dtype=bool)
    pattern[0, :] = pattern[:, 0] = True
    assert pivot_order(n, set(map(tuple, np.argwhere(pattern))))[-1] in (0, n - 1)
    values = ca.SX(n, n)
    for i, j in np.argwhere(pattern):
        values[i, j] = ca.SX.sym("j")
    assert eliminate(values).lu.numel() == pattern.sum()


def test_nonzeros_come_row_by_row():
    """Each entry has its value."""
    a, b, c = (ca.SX.sym(name) for name in "abc")
    matrix = ca.SX(2, 2)
    matrix[1, 0], matrix[0, 1], matrix[1, 1] = a, b, c
    found = [(place, str(value)) for place, value in nonzeros(matrix).items()]
    assert found == [((0, 1), "b"), ((1, 0), "a"), ((1, 1), "c")]


def test_step_whose_system_is_singular_is_made_shorter(open_fmu):
    """x' = 4000 x over 1 ms: the diagonal of the first try, 4 / step, is the 4000 that is taken from it."""
    fmu = open_fmu("decay").start(tolerance=1e-8, rate=-4000.0)
    # ten inner steps of tolerance 1e-8, the first error grows by exp(4)
    assert fmu.step(1e-3)["level"] == pytest.approx(np.exp(4.0), rel=1e-5)
