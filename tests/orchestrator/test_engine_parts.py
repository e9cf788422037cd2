"""Functions of the engine that its library does not export, against Python and NumPy."""

import ctypes
import time
from ctypes import byref, c_double
from functools import cache

import numpy as np
import pytest
from kit.mistakes import table
from numpy.polynomial import Legendre, Polynomial

from orchestrator.base.compiler import host, shared_library
from orchestrator.engine.c_library import Binding, library, recipe
from orchestrator.engine.linear_system import ErrorSystem


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


# ---- How the error estimate reads a source: corners, fourth derivatives, sections, linearisations


class Estimate(ErrorSystem):
    """States x' = a x + u, whose input u is 0 while its source is not: the defect is the source itself."""

    def __init__(self, lag=10**6, states=1):
        super().__init__(states, 1)
        self.b[:, 0], self.slope = 1.0, np.zeros(1)
        binding = self.binding = Binding()
        h = binding.h
        self.source = binding.array(h.CouplingInput, [h.CouplingInput(source_slope=binding.at(self.slope))])
        self.source[0].fmu_degree = self.source[0].requested_degree = 3
        self.source[0].slopes_known = 2
        self.input = binding.array(h.ErrorInput, [h.ErrorInput(substeps=1)])
        limits = {"longest_section": 100, "longest_lag": 20, "sample": 10**6, "lag": lag}
        self.state = self.struct(binding, inputs=binding.pointer(self.input), **limits)
        self.simulation = h.Simulation(
            inputs=binding.pointer(self.source),
            components=binding.pointer(binding.array(h.Component, [h.Component()])),
            errors=binding.pointer(self.state),
        )
        library().linear_system_join(byref(self.state.system))

    def step(self, h, value, slope, value_end, slope_end):
        """A step over which the source moves from (value, slope) to (value_end, slope_end)."""
        s = self.source[0]
        s.value, s.slope, s.value_end, s.slope_end = value, slope, value_end, slope_end
        assert library().error_propagate(byref(self.simulation), c_double(h)) == 0
        self.simulation.t += h

    @property
    def integral(self):
        """Of the source over the steps that have been judged: all but the last; a is 0."""
        return self.e[0] + self.defects[0, 0]


@pytest.mark.parametrize(("between", "limit"), [(0, 4.0), (5, 4.0 * 0.9**5)])
@pytest.mark.parametrize("over", [0.99, 1.01])
def test_a_slope_that_changes_four_times_as_much_as_usual_has_a_corner(between, limit, over):
    """Past changes fade by 10 % in a step. With the corner the integral is exact, without it is not."""
    p, h, value, slope = Estimate(), 0.5, 0.0, 0.0
    for _ in range(3):  # a parabola, whose second derivative is 1
        p.step(h, value, slope, value + slope * h + h**2 / 2, slope + h)
        value, slope = value + slope * h + h**2 / 2, slope + h
    for _ in range(between + 1):  # straight
        p.step(h, value, slope, value + slope * h, slope)
        value += slope * h
    limit *= 0.9  # of the first straight step
    jump, rest = over * limit * h, 0.7 * h  # of the slope, after which it is straight again
    exact = h * (value + slope * h / 2) + jump * rest**2 / 2
    end = value + slope * h + jump * rest
    p.step(h, value, slope, end, slope + jump)
    value, slope = end, slope + jump
    before = p.integral
    p.step(h, value, slope, value + slope * h, slope)
    found = p.integral - before
    # rounding; the cubic through the same ends has 0.017 of the jump times h2 more
    assert (found == pytest.approx(exact, rel=1e-9)) == (over > 1)


@pytest.mark.parametrize(("first", "last"), [(0.29, 0.29), (0.31, 0.29), (0.29, 0.31)])
def test_a_fourth_derivative_needs_a_neighbour_of_three_tenths_of_the_step(first, last):
    """The third derivatives of two steps tell that of t^4/24, which has 1/720 of h^5 beside its cubic."""
    p, t, integrals = Estimate(), 1.0, []
    for h in (first, 1.0, last, 1.0):
        ends = [(x**4 / 24, x**3 / 6) for x in (t, t + h)]
        p.step(h, *ends[0], *ends[1])
        integrals.append(p.integral)
        t += h
    begin = 1.0 + first
    exact = ((begin + 1) ** 5 - begin**5) / 120
    missing = 0.0 if max(first, last) > 0.3 else 1 / 720
    assert integrals[2] - integrals[1] == pytest.approx(exact - missing, rel=1e-10)  # rounding


@pytest.mark.parametrize(("change", "steps"), [(0.099, 8), (0.101, 7)])
def test_a_section_lasts_until_the_slopes_have_changed_by_four_fifths(change, steps):
    """A slope that goes up and down by 10 % of its magnitude: eight steps are advanced at once."""
    p, taken = Estimate(), []
    for k in range(40):
        slopes = (1.0, 1.0 - change)[:: 1 if k % 2 == 0 else -1]
        p.step(1.0, 0.0, slopes[0], sum(slopes) / 2, slopes[1])
        taken.append(p.state.taken)
    ends = [k for k, n in enumerate(taken) if n == 0][2:]  # the first two steps have no neighbours
    assert set(np.diff(ends)) == {steps}


def test_the_magnitude_of_a_slope_fades_by_a_twentieth_in_a_step():
    """After a steep step, flat ones belong together as soon as the past is flat, too."""
    p = Estimate()
    p.step(1.0, 0.0, 1.0, 1.0, 1.0)
    for k in range(1, 12):
        p.step(1.0, 0.0, 0.1, 0.1, 0.1)
        assert p.input[0].usual_slope == pytest.approx(0.95**k, rel=1e-12)


@table(__file__, "linearisations", "change, before, after")
def test_linearisations_are_as_rare_as_the_system_changes(change, before, after):
    """A diagonal element that changes by three tenths of its size halves their distance, a tenth doubles it.

    The size is the sum of both magnitudes and of the rate that the distance itself resolves. The distance
    stays between 1 and 20 steps. Of two states one does not change.
    """
    p, old, h = Estimate(lag=before, states=2), -100.0, 1e-2
    p.a[0, 0], p.a[1, 1] = 7.0, old
    library().linear_system_join(byref(p.state.system))
    least = 1 / (before * h)
    # |new - old| = change (|new| + |old| + least), where new is the larger one
    p.a[1, 1] = (old * (1 + change) - change * least) / (1 - change)
    for _ in range(before + 1):
        p.step(h, 0.0, 0.0, 0.0, 0.0)
    assert p.state.lag == after
