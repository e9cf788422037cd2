"""The linear systems of the solver: as NumPy solves them, or reported as inaccurate."""

import casadi as ca
import fmpy
import numpy as np
import pytest
from export.conftest import stateless
from kit.mistakes import problem, table

from fmus.contract import Quantity
from fmus.export.build import build
from fmus.export.c_functions import Routine, c_function, number
from fmus.export.elimination import eliminate, pivot_order
from fmus.parameters import Values


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


def test_step_whose_system_is_singular_is_made_shorter(open_fmu):
    """x' = 4000 x over 1 ms: the diagonal of the first try, 4 / step, is the 4000 that is taken from it."""
    fmu = open_fmu("decay").start(tolerance=1e-8, rate=-4000.0)
    # ten inner steps of tolerance 1e-8, the first error grows by exp(4)
    assert fmu.step(1e-3)["level"] == pytest.approx(np.exp(4.0), rel=1e-5)


# ---- The C written for CasADi's operations computes what CasADi computes

OPERATIONS = {
    "sum": lambda a, b: a + b - 2 * b,
    "ratio": lambda a, b: a / b + 1 / a,
    "power": lambda a, b: ca.fabs(a) ** b + b**3 + ca.fabs(b) ** 0.5,
    "roots": lambda a, b: ca.sqrt(ca.fabs(a)) + ca.exp(-(b**2)) + ca.log(ca.fabs(a) + 1),
    "circle": lambda a, b: ca.sin(a) * ca.cos(b) + ca.tan(a) + ca.atan2(a, b) + ca.atan(b),
    "arcs": lambda a, b: ca.asin(ca.sin(a)) + ca.acos(ca.cos(b)),
    "hyperbolic": lambda a, b: ca.sinh(a) + ca.cosh(b) + ca.tanh(a) + ca.asinh(b) + ca.acosh(1 + b**2),
    "more": lambda a, b: ca.atanh(ca.sin(a)) + ca.erf(b) + ca.log1p(a**2) + ca.expm1(b),
    "steps": lambda a, b: ca.floor(a) + ca.ceil(b) + ca.fabs(a) + ca.sign(b) + ca.fmod(a, b),
    "extremes": lambda a, b: ca.fmin(a, b) - 3 * ca.fmax(a, 0.5) + ca.copysign(a, b) + ca.hypot(a, b),
    "branch": lambda a, b: ca.if_else(a > b, a, -b) + ca.if_else(ca.logic_and(a >= 0, b < 1), 1.5, a * b),
    "logic": lambda a, b: ca.if_else(ca.logic_or(a == b, ca.logic_not(a != 0)), 2 * a, -a),
    # at, above and below the bound
    "clipped": lambda a, b: ca.exp(ca.fmax(a, -0.3)) + ca.exp(ca.fmax(-0.3, b)),
    "constant": lambda a, b: ca.SX(-3.25e-7) + 0 * a + 0 * b,
}


@pytest.fixture(scope="module")
def operations(tmp_path_factory):
    """An FMU without states whose outputs are the operations of its two inputs and one parameter."""
    sub = stateless(
        "operations",
        dict.fromkeys("ab", "1"),
        dict.fromkeys(OPERATIONS, "1"),
        lambda _x, u, p: {name: f(u.a, u.b) * ca.cos(p.scale) for name, f in OPERATIONS.items()},
        {"scale": "1"},
    )
    numbers = Values({"scale": 0.3}, {"a": 0.0, "b": 1.0}, {})
    return build(sub, tmp_path_factory.mktemp("operations"), values=numbers)


@pytest.mark.parametrize(("a", "b"), [(0.7, 1.3), (-1.2, 0.4), (0.4, -2.5), (2.0, 2.0), (-0.3, -0.3)])
def test_compiled_operations_equal_casadi(operations, a, b):
    """Every elementary function, through the FMU, against CasADi's own evaluation."""
    symbols = ca.SX.sym("a"), ca.SX.sym("b")
    function = ca.Function("f", symbols, [f(*symbols) * ca.cos(0.3) for f in OPERATIONS.values()])
    expected = [float(value) for value in function(a, b)]
    given = {"start_values": {"a": a, "b": b}, "output": list(OPERATIONS)}
    result = fmpy.simulate_fmu(str(operations), stop_time=0.01, **given)
    # same operations, another mathematics library: a few rounding errors
    np.testing.assert_allclose([result[name][-1] for name in OPERATIONS], expected, rtol=1e-14, atol=1e-15)


def test_c_text_names_the_variables():
    """Next to their use; an operation without C code is an error of the build, not of the compiler."""
    x = ca.SX.sym("x", 2)
    text = c_function(Routine("f", {"x": x}, {"y": x[0] * x[1]}), {"x": ["pressure", "flow"]})
    assert text.startswith("LOCAL void f(const double *x, double *y) {")
    assert "/* pressure */" in text
    assert "y[0] = v" in text
    x = ca.SX.sym("x")
    problem(lambda: c_function(Routine("f", {"x": x}, {"y": ca.erfinv(x)}), {}), "is not supported in C code")


def test_negative_zero_keeps_its_sign_and_its_parentheses():
    """-(-0.0) is C only with parentheses; -0.0 is not 0.0."""
    assert [number(value) for value in (-0.0, 0.0, -2.5, 1e300)] == ["(-0.0)", "0.0", "(-2.5)", "1e+300"]


def test_text_of_a_declaration_ends_no_comment(tmp_path):
    """The start or end of a C comment in a description is broken up, so that the sources compile."""
    q = Quantity("1", "a /* b */ c")
    sub = stateless("comments", {"u": q}, {"y": q}, lambda _x, u, _p: {"y": u.u})
    assert build(sub, tmp_path, values=Values({}, {"u": 0.0}, {})).is_file()
