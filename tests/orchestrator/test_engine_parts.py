"""Functions of the engine that its library does not export, against Python and NumPy."""

import ctypes
import time
from functools import cache

import numpy as np
import pytest

from orchestrator.base.compiler import host, shared_library
from orchestrator.engine.c_library import Binding, recipe


@cache
def everything():
    """The engine with all its functions visible."""
    name, code, arguments = recipe(host())
    engine = ctypes.CDLL(str(shared_library(name, code, [a for a in arguments if "visibility" not in a])))
    engine.seconds.restype = ctypes.c_double
    return engine


def test_the_clock_is_that_of_python():
    """Between two looks at the monotonic clock, in each part of a second."""
    for _ in range(30):
        before = time.monotonic()
        assert before <= everything().seconds() + 1e-6  # the rounding of a double at a year
        assert everything().seconds() <= time.monotonic() + 1e-6
        time.sleep(0.01)


@pytest.fixture
def scenario():
    """Evaluates a table at a time, from C: value and rate of its second column in mm, and its samples."""
    times, rng = np.array([1.0, 1.5, 3.0, 4.0, 8.0]), np.random.default_rng(0)
    columns = rng.normal(size=(5, 2))
    slopes = np.diff(columns, axis=0) / np.diff(times)[:, None]
    arrays = {
        "time": times,
        "base": np.concatenate([columns[:1], columns]),
        "slopes": np.pad(slopes, ((1, 1), (0, 0))),
        "anchor": np.concatenate([times[:1], times]),
        "columns": np.array([1]),
        "targets": np.array([2]),
        "factor": np.array([1e3]),
        "offset": np.array([7.0]),
        "rate_columns": np.array([1]),
        "rates": np.array([0]),
        "rate_factor": np.array([1e3]),
        "at_end": np.zeros(1),
    }
    binding = Binding()
    reals = np.zeros(3)
    struct = binding.h.Scenario(
        **{name: binding.at(array) for name, array in arrays.items()},
        samples=5, width=2, count=1, rate_count=1, evaluated_at=np.nan,
    )  # fmt: skip
    simulation = binding.h.Simulation(scenario=binding.pointer(struct), reals=binding.at(reals))

    def evaluated(t):
        assert everything().scenario_set_inputs(ctypes.byref(simulation), ctypes.c_double(t)) == 0
        return reals[2], reals[0]

    return evaluated, times, columns[:, 1]


def test_a_table_is_read_at_any_time_in_any_order(scenario):
    """Straight between the samples, held before and after; the rate is that just after a sample."""
    evaluated, times, column = scenario
    rng = np.random.default_rng(1)
    visits = np.concatenate([times, [1.2, 0.5, 9.0, 3.5, 0.0], rng.permutation(np.linspace(0.0, 9.0, 91))])
    for t in rng.choice(visits, 1000).tolist():
        k = np.searchsorted(times, t, side="right")
        slope = (column[k] - column[k - 1]) / (times[k] - times[k - 1]) if 0 < k < len(times) else 0.0
        value, rate = evaluated(t)
        # rounding
        assert value == pytest.approx(1e3 * np.interp(t, times, column) + 7.0, rel=1e-12, abs=1e-9)
        assert rate == pytest.approx(1e3 * slope, rel=1e-12)
