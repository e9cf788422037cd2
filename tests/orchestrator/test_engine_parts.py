"""Functions of the engine that its library does not export, against Python and NumPy."""

import ctypes
import time
from functools import cache

import numpy as np
import pytest
from numpy.polynomial import Legendre, Polynomial

from orchestrator.base.compiler import host, shared_library
from orchestrator.engine.c_library import Binding, recipe


@cache
def everything():
    """The engine with all its functions visible."""
    name, code, arguments = recipe(host())
    engine = ctypes.CDLL(str(shared_library(name, code, [a for a in arguments if "visibility" not in a])))
    for name in ("seconds", "step_error"):
        getattr(engine, name).restype = ctypes.c_double
    return engine


def test_the_clock_is_that_of_python():
    """Between two looks at the monotonic clock, in each part of a second."""
    for _ in range(30):
        before = time.monotonic()
        assert before <= everything().seconds() + 1e-6  # the rounding of a double at a year
        assert everything().seconds() <= time.monotonic() + 1e-6
        time.sleep(0.01)


def test_a_table_is_read_at_any_time_in_any_order():
    """Straight between the samples, held before and after; the rate is that just after a sample."""
    times, rng = np.array([1.0, 1.5, 3.0, 4.0, 8.0]), np.random.default_rng(0)
    columns = rng.normal(size=(5, 2))  # of which the second is read, in mm
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
    binding.simulation.scenario, binding.simulation.reals = binding.pointer(struct), binding.at(reals)
    column, rng = columns[:, 1], np.random.default_rng(1)
    visits = np.concatenate([times, [1.2, 0.5, 9.0, 3.5, 0.0], rng.permutation(np.linspace(0.0, 9.0, 91))])
    for t in rng.choice(visits, 1000).tolist():
        k = np.searchsorted(times, t, side="right")
        slope = (column[k] - column[k - 1]) / (times[k] - times[k - 1]) if 0 < k < len(times) else 0.0
        assert everything().scenario_set_inputs(ctypes.byref(binding.simulation), ctypes.c_double(t)) == 0
        # value and rate: rounding
        assert reals[2] == pytest.approx(1e3 * np.interp(t, times, column) + 7.0, rel=1e-12, abs=1e-9)
        assert reals[0] == pytest.approx(1e3 * slope, rel=1e-12)


@pytest.mark.parametrize("degree", [0, 1, 3])
@pytest.mark.parametrize(("begin", "last"), [(0.0, False), (0.0, True), (0.2, False), (0.2, True)])
def test_an_fmu_gets_the_nearest_polynomial_that_it_can_follow(degree, begin, last):
    """Value and derivatives at the start of the part; one that follows no cubic the line, or the constant,
    nearest to it over the part. The ends of a whole step are kept for its energy.
    """
    length, binding = 0.3, Binding()
    courses = [Polynomial([1.0, -2.0, 3.0, -5.0]), Polynomial([4.0, 0.5, -1.0, 2.0])]
    inputs = binding.array(binding.h.CouplingInput, [()] * 3)
    for k, (s, course) in enumerate(zip(inputs[1:], courses, strict=True)):
        s.c[:] = course.coef
        s.fmu_degree, s.requested_degree, s.target = degree, 3, 2 - k
    values, derivatives, ends = np.zeros(2), np.zeros(6), np.zeros((2, 3))
    component = binding.h.Component(
        first_input=1, input_count=2, sets_values=1, values=binding.at(values),
        derivatives=binding.at(derivatives),
    )  # fmt: skip
    simulation = binding.h.Simulation(
        inputs=binding.pointer(inputs), input_ends=binding.at(ends), real_count=3
    )

    def call(name, *arguments):
        assert getattr(everything(), name)(ctypes.byref(simulation), ctypes.byref(component), *arguments) == 0

    call("component_set_inputs", ctypes.c_double(begin), ctypes.c_double(length), int(last))
    # Legendre's polynomials are orthogonal over the part: the first terms are the nearest polynomial
    part = {"kind": Legendre, "domain": [begin, begin + length]}
    parts = [course.convert(**part).truncate(degree + 1) for course in courses]
    expected = [[part.deriv(k)(begin) for k in range(degree + 1)] for part in parts]
    near = {"rel": 1e-12, "abs": 1e-12}  # rounding
    assert values == pytest.approx([e[0] for e in expected], **near)
    assert derivatives[: 2 * degree] == pytest.approx([d for e in expected for d in e[1:]], **near)
    assert not derivatives[2 * degree :].any()
    kept = np.zeros((2, 3))
    kept[0, [2, 1]] = [e[0] for e in expected] if begin == 0.0 else 0.0
    kept[1, [2, 1]] = [part(begin + length) for part in parts] if last else 0.0
    assert ends == pytest.approx(kept, **near)


class Step:
    """Inputs that a step of half a second has held, except for one that a scenario drives."""

    h = 0.5

    def __init__(self, ways, driven=(0.0, 0.0, 0.0)):
        """ways: (value, slope, value at the end) of each source; driven: begin, middle, end."""
        h = ctypes.c_double(self.h)
        self.binding = Binding()
        self.inputs = self.binding.array(self.binding.h.CouplingInput, [()] * (len(ways) + 1))
        for s, (value, slope, end) in zip(self.inputs, ways, strict=False):
            s.source_component, s.slope, s.slope_end = 1, slope, slope
            everything().input_begin(ctypes.byref(s), ctypes.c_double(value), ctypes.c_double(0.0))
            s.slope, s.slope_end, s.value_end = slope, slope, end
            everything().input_extrapolate(ctypes.byref(s), h, h)
        last = self.inputs[len(ways)]
        last.source_component, last.value = self.binding.h.DRIVEN, driven[0]
        everything().input_drive(ctypes.byref(last), *map(ctypes.c_double, driven[1:]), h)

    def error(self, passes=1):
        """step_error after so many passes."""
        simulation = self.binding.h.Simulation(
            inputs=self.binding.pointer(self.inputs), input_count=len(self.inputs), passes=passes
        )
        return everything().step_error(ctypes.byref(simulation), ctypes.c_double(self.h))


def test_the_error_of_a_step_is_that_of_its_worst_input():
    """The way of a held line, what a line leaves out, what a pass would change: each over its magnitude."""
    lines = [(1.0, 4.0, 3.0), (-8.0, 2.0, -7.0)]
    step = Step(lines)
    assert step.error() == pytest.approx(2 / 3, rel=1e-15)  # rounding
    driven = Step(lines, driven=(1.0, 5.0, 3.0))
    assert driven.error() == pytest.approx((5 - 2) / 3, rel=1e-15)
    for s in step.inputs:
        s.expected = s.value_end  # as foreseen
    assert step.error(passes=1) == 0.0
    assert step.error(passes=2) == pytest.approx(2 / 3, rel=1e-15)
