"""Elementary functions of vectors (orchestrator/lanes/native/lanes.h) against those of NumPy."""

import ctypes
from pathlib import Path

import numpy as np
import pytest

from orchestrator.base.compiler import shared_library
from orchestrator.lanes.compiled import LANES, processor, recipe


@pytest.fixture(scope="module")
def functions():
    """name -> function of arrays of equal length."""
    source = {"f.cpp": Path(__file__).with_suffix(".cpp").read_bytes()}
    library = ctypes.CDLL(str(shared_library(*recipe("functions", "f.cpp", source, processor()))))

    def call(name, x, y=None):
        x = np.broadcast_arrays(np.asarray(x, float), np.zeros(1 if y is None else np.shape(y)))[0]
        y = np.broadcast_to(np.asarray(0.0 if y is None else y, float), x.shape)
        count = -(-x.size // LANES)
        padded = [np.resize(v, count * LANES).astype(float) for v in (x, y)]
        out = np.zeros(count * LANES)
        pointers = [v.ctypes.data_as(ctypes.POINTER(ctypes.c_double)) for v in (*padded, out)]
        getattr(library, f"{name}_of")(*pointers, count)
        return out[: x.size]

    return call


SPECIAL = np.array([0.0, -0.0, 1.0, -1.0, np.inf, -np.inf, np.nan, 5e-324, 1e-310, 1e308])


@pytest.mark.parametrize(
    ("name", "x"),
    [
        *(("exp", np.linspace(-745, 709.7, 100_003)), ("exp", np.linspace(-1e-3, 1e-3, 1001))),
        *(("log", np.geomspace(5e-324, 1e308, 100_003)), ("log", np.linspace(0.99, 1.01, 1001))),
        *((name, np.linspace(-1e4, 1e4, 100_003)) for name in ("sin", "cos")),
        *(("sin", np.geomspace(1e-300, 1e300, 2003)), ("tanh", np.linspace(-3, 3, 101))),
    ],
)
def test_a_function_agrees_with_numpy(functions, name, x):
    """A few units in the last place; near a zero of sine and cosine an absolute error of that size."""
    expected = getattr(np, name)(x)
    circular = name in ("sin", "cos")
    smallest = 2e-16 if circular else 5e-324  # the latter: the spacing of the results of exp near zero
    np.testing.assert_allclose(functions(name, x), expected, rtol=1e-15, atol=smallest)


@pytest.mark.parametrize("name", ["exp", "log", "sin", "cos"])
def test_special_values_are_those_of_numpy(functions, name):
    """Zeros, infinities, NaN and the ends of the range."""
    with np.errstate(all="ignore"):
        expected = getattr(np, name)(SPECIAL)
    np.testing.assert_allclose(functions(name, SPECIAL), expected, rtol=1e-15)


def test_a_quotient_has_an_error_of_two_units_in_the_last_place(functions):
    """Of normal numbers of any size; zeros, infinities and NaN as in the C library."""
    rng = np.random.default_rng(1)
    x, y = 10 ** rng.uniform(-150, 150, (2, 100_000))
    assert (np.abs(functions("quotient", x, y) / (x / y) - 1) < 5e-16).all()
    special = np.array([0.0, 1.0, -1.0, np.inf, -np.inf, np.nan, 1e300, 1e-300])
    assert functions("quotient", [1.0, -1.0], [1e-310, 1e-310]).tolist() == [np.inf, -np.inf]  # counts as 0
    x, y = (v.ravel() for v in np.meshgrid(special, special))
    with np.errstate(all="ignore"):
        np.testing.assert_allclose(functions("quotient", x, y), x / y, rtol=1e-15)


def test_the_exponential_of_a_bounded_value_is_known_at_its_bound(functions):
    """There it is the given number whatever the other machines have; elsewhere that of `exp`."""
    x = np.array([-2.0, -1.0, -2.0, 0.5, np.nan, 3.0, -2.0, 1.0])
    expected = np.where(x == -2.0, np.exp(-2.0), functions("exp", x))
    np.testing.assert_array_equal(functions("exp_above", x), expected)
    np.testing.assert_array_equal(functions("exp_above", np.full(8, -2.0)), np.exp(-2.0))


def test_a_power_has_the_error_of_its_logarithm(functions):
    """exp(y ln x), |y ln x| units in the last place; zero and negative numbers as in the C library."""
    rng = np.random.default_rng(1)
    x, y = 10 ** rng.uniform(-12, 12, 10_000), rng.uniform(-5, 5, 10_000)
    error = np.abs(functions("pow", x, y) / x**y - 1)
    assert (error < 2.3e-16 * (3 + np.abs(y * np.log(x)))).all()
    x, y = np.array([0.0, 0.0, 0.0, -2.0, -2.0, 2.0, np.inf]), np.array([0.25, -1.0, 0.0, 3.0, 0.5, 0.0, 2.0])
    with np.errstate(all="ignore"):
        np.testing.assert_allclose(functions("pow", x, y), x**y, rtol=1e-15)


def test_comparisons_choose_for_each_machine(functions):
    """`where` keeps the value of those for which the condition holds; a comparison with NaN does not hold."""
    x, y = np.array([1.0, 2.0, 3.0, np.nan, 1.0]), np.array([2.0, 2.0, 2.0, 2.0, np.nan])
    np.testing.assert_array_equal(functions("where", x, y), [1.0, 0.0, 0.0, 0.0, 0.0])
    np.testing.assert_array_equal(functions("both", x, y + 1), [1.0, 1.0, 0.0, 0.0, 0.0])
    np.testing.assert_array_equal(functions("fmax", x[:3], y[:3]), [2.0, 2.0, 3.0])
    np.testing.assert_array_equal(functions("fmin", x[:3], y[:3]), [1.0, 2.0, 2.0])
