"""Polynomials over a step: what projections keep, what interpolation and extrapolation are exact for."""

import ctypes
import math

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from orchestrator.engine.c_library import engine_h, library

CouplingInput = engine_h().CouplingInput
SLOPE = ctypes.c_double(0.0)  # the functions only ask whether there is one


def call(name, *arguments):
    """A function of the engine; numbers that are floats are passed as such."""
    return getattr(library(), name)(*(ctypes.c_double(a) if isinstance(a, float) else a for a in arguments))


def vector(c):
    return (ctypes.c_double * 4)(*c)


def of_polynomial(name):
    """A function of the engine, of a polynomial and a number."""
    return lambda c, x: call(f"polynomial_{name}", vector(c), x)


mean, at, slope_at = map(of_polynomial, ("mean", "value", "slope"))


def projected(c, degree, h):
    call("polynomial_project", found := vector(c), degree, h)
    return tuple(found)


def shifted(c, by):
    call("polynomial_shift", vector(c), by, found := vector(c))
    return tuple(found)


class Input:
    """A coupling input of the engine."""

    def __init__(self, **fields):
        self.struct = CouplingInput(
            **{"factor": 1.0, "source_component": 1, "fmu_degree": 3, "requested_degree": 3}
            | {"source_slope": ctypes.addressof(SLOPE), "slopes_known": 2}
            | fields
        )

    def __getattr__(self, name):
        """A value, or a function of the engine on this input."""
        if hasattr(CouplingInput, name):
            return getattr(self.struct, name)
        return lambda *arguments: call(f"input_{name}", ctypes.byref(self.struct), *arguments)


numbers = st.floats(-1e3, 1e3).map(lambda x: x if abs(x) > 1e-9 else 0.0)  # far from underflow
cubics = st.tuples(numbers, numbers, numbers, numbers)
lengths = st.floats(1e-2, 10.0)  # [s]
degrees = st.integers(1, 3)


def cut(c, degree):
    """The terms up to a degree."""
    return tuple(x if k <= degree else 0.0 for k, x in enumerate(c))


def size(c, h):
    """The largest sum of terms over a step, with which rounding grows."""
    return sum(abs(x) * h**k for k, x in enumerate(c))


def close(found, expected, magnitude):
    """Equal but for rounding of a few dozen operations on numbers of that magnitude."""
    assert found == pytest.approx(expected, rel=0, abs=1e-13 * magnitude)


def moment(c, h):
    """Integral of s u(s) over a step."""
    return sum(x * h ** (k + 2) / (k + 2) for k, x in enumerate(c))


@example((1.0, 2.0, 1.0, 0.0), 2.0)
@example((1.0, 2.0, 0.0, 1.0), 2.0)
@given(cubics, lengths)
def test_projections_keep_mean_and_moment(c, h):
    """A lower degree keeps the mean, the line both: it is nearest; what has the degree stays as it is."""
    constant, line = projected(c, 0, h), projected(c, 1, h)
    assert constant[1:] == (0.0, 0.0, 0.0)
    assert line[2:] == (0.0, 0.0)
    for found in (constant, line):
        close(mean(found, h), mean(c, h), size(c, h))
    close(moment(line, h) / h**2, moment(c, h) / h**2, size(c, h))
    for degree in (0, 1, 3):
        assert projected(cut(c, degree), degree, h) == cut(c, degree)


@given(cubics, lengths, degrees)
def test_interpolation_passes_through_its_data(c, h, degree):
    """The only polynomial of its degree with both values, the slope at the beginning, and that at the end."""
    value, slope, value1, slope1 = c
    s = Input(value=value, slope=slope, value_end=value1, slope_end=slope1)
    s.interpolate(degree, h, 1.0)
    found, magnitude = tuple(s.c), abs(value) + abs(value1) + h * (abs(slope) + abs(slope1))
    assert not any(found[degree + 1 :])
    close(at(found, 0.0), value, magnitude)
    close(at(found, h), value1, 10 * magnitude)  # coefficients of the cubic are up to 4 times as large
    if degree > 1:
        close(h * slope_at(found, 0.0), h * slope, magnitude)
    if degree > 2:
        close(h * slope_at(found, h), h * slope1, 30 * magnitude)


@given(cubics, lengths, lengths, st.integers(0, 3))
def test_extrapolation_is_exact_for_polynomials_of_its_degree(c, step, h, degree):
    """Value, slope and the previous step determine the polynomial, at any lengths of the steps."""
    c = cut(c, degree)
    before, chord = slope_at(c, -step), (c[0] - at(c, -step)) / step
    s = Input(value=c[0], slope=c[1], slope_before=before, chord_before=chord, order=degree)
    s.extrapolate(1.0, step)
    found = tuple(s.c)
    # differences over the step before are rounded in units of the magnitude there
    magnitude = size(c, max(h, step)) * max(1.0, h / step) ** degree
    close(at(found, h), at(c, h), 10 * magnitude)


@given(cubics, lengths)
def test_a_driven_input_is_a_line_that_errs_by_what_it_leaves_out_in_the_middle(c, h):
    """Between the values at both ends; a parabola through all three is farthest from it there."""
    value, slope, middle, end = c
    s = Input(value=value, slope=slope)
    s.drive(middle, end, h)
    magnitude = abs(value) + abs(middle) + abs(end)
    close(at(s.c, h), end, magnitude)
    assert (s.c[0], *s.c[2:]) == (value, 0.0, 0.0)
    close(s.deviation(h, 0), middle - (value + end) / 2, magnitude)


@given(cubics, lengths, numbers)
def test_a_prediction_is_the_cubic_through_thirds_and_errs_by_a_quarter_in_the_mean(c, h, error):
    """Its error grows as t^3; behind a source that has stepped it ends there, and begins as before."""
    s = Input(value=c[0])
    s.predict(*(at(c, k * h / 3) - c[0] for k in (1, 2, 3)), h)
    magnitude = 200 * size(c, h) + 10 * abs(error)  # coefficients of the thirds are up to 45
    for k, (found, true) in enumerate(zip(tuple(s.c), c, strict=True)):
        close(found * h**k, true * h**k, magnitude)
    source = (*c[:3], c[3] + error / h**3)
    s.struct.value_end = at(source, h)
    close(s.deviation(h, 0), mean(c, h) - mean(source, h), magnitude)
    before = tuple(s.c)
    s.end_at_source(h)
    assert tuple(s.c)[:3] == before[:3]
    close(at(s.c, h), s.value_end, magnitude)


@given(st.floats(0.5, 2.0), st.floats(0.5, 2.0))
def test_between_two_ends_an_input_errs_by_less_than_its_deviation(before, h):
    """From a source of one degree more: t^2, t^3, t^4, whose errors are those of Hermite's remainder."""
    largest = {1: h**2 / 4, 2: 4 * h**3 / 27, 3: h**4 / 16}
    times = {1: 1.0, 2: 27 / 16 * (h + 1.5 * before) / (h + before), 3: 4.0}
    for degree in (1, 2, 3):
        power = degree + 1
        s = Input(slope_before=power * (-before) ** degree, chord_before=-((-before) ** power) / before)
        s.struct.value_end, s.struct.slope_end = h**power, power * h**degree
        s.interpolate(degree, h, before)
        # rounding: the extrapolation is up to 64
        assert abs(s.deviation(h, 0)) == pytest.approx(times[degree] * largest[degree], rel=1e-12)


@given(cubics, lengths, lengths)
def test_shifting_counts_time_from_elsewhere(c, by, s):
    """u(by + s) is the shifted polynomial at s; by 0, without substeps, it is the same bit for bit."""
    assert shifted(c, 0.0) == c
    close(at(shifted(c, by), s), at(c, by + s), size(c, by + s))
    close(s * slope_at(shifted(c, by), s), s * slope_at(c, by + s), 3 * size(c, by + s))


# ---- an input over several steps


def watched(c, lengths, order=0, slopes=True, degree=3):
    """An input whose source followed c over these steps, the last one undone; `slopes`: it gives them."""
    missing = {} if slopes else {"source_slope": None}
    s = Input(fmu_degree=degree, order=order, **missing)
    s.begin(c[0], c[1] if slopes else 0.0)
    t, steps = 0.0, (0.0, 0.0)
    for n, h in enumerate(lengths):
        s.extrapolate(h, steps[0])
        s.set_end(at(c, t + h), slope_at(c, t + h) if slopes else math.nan, h, *steps)
        if n < len(lengths) - 1:
            s.accept(h)
            t, steps = t + h, (h, steps[0])
    return s, t, steps


@given(cubics, st.floats(0.5, 2.0), st.floats(0.5, 2.0), st.floats(0.5, 2.0), degrees)
def test_slopes_from_differences_are_exact_up_to_a_cubic(c, first, second, third, degree):
    """Two values give the slope of a line, three that of a parabola, four that of a cubic."""
    c, lengths = cut(c, degree), [first, second, third][:degree]
    s, t, _ = watched(c, lengths, slopes=False)
    # differences of third order of values rounded at that magnitude, over steps of half a second
    close(s.slope_end, slope_at(c, t + lengths[-1]), 200 * size(c, sum(lengths)))


@given(cubics, st.floats(0.5, 2.0), st.floats(0.5, 2.0))
def test_a_polynomial_within_reach_is_no_error(c, before, h):
    """The expected end of a cubic is exact: deviation and mismatch are zero."""
    s, _, (step, _) = watched(c, [before, h], order=3)
    magnitude = 100 * size(c, before + h)
    close(s.deviation(h, 0), 0.0, magnitude)
    s.interpolate(3, h, step)
    close(s.deviation(h, 1), 0.0, magnitude)
    close(s.mismatch(h) * s.magnitude(), 0.0, magnitude)


@given(numbers, numbers.filter(lambda x: abs(x) > 1e-3), st.floats(0.5, 2.0), st.floats(0.5, 2.0))
def test_a_held_line_is_off_by_its_way(value, slope, before, h):
    """The deviation of a held input is the change of the source."""
    s, _, _ = watched((value, slope, 0.0, 0.0), [before, h])
    magnitude = abs(value) + 4 * abs(slope)
    close(abs(s.deviation(h, 0)), abs(slope) * h, magnitude)


def test_corners_of_autonomous_sources_and_the_largest_magnitude():
    """From a state it is a cubic; errors near zero are relative to the largest magnitude ever."""
    # from the end of its motion on a free source is a line, whatever it did before
    stopped = Input(autonomous=True, value=2.0, value_end=2.0, slope_before=1.0, chord_before=1.0)
    stopped.interpolate(3, 0.5, 0.5)
    assert stopped.deviation(0.5, 0) == 0.0
    for free, expected in ((True, (0.0, 1.0, 0.0, 0.0)), (False, (0.0, 1.0, 1.0, -1.0))):
        s = Input(autonomous=free)
        s.begin(0.0, 1.0)
        s.set_end(1.0, 0.0, 1.0, 0.0, 0.0)  # the slope at the end is that of what follows the corner
        s.interpolate(3, 1.0, 0.0)
        assert tuple(s.c) == expected
    s, _, _ = watched((8.0, -4.0, 0.0, 0.0), [1.0, 1.0])
    assert (s.value_end, s.magnitude(), s.relative(2.0)) == (0.0, 8.0, 0.25)
    still = Input()
    assert still.relative(1.0) == 0.0  # the start: nothing was ever there to compare with
    small = Input(scale=1e-3)
    assert small.relative(-2e-3) == 2.0


@pytest.mark.parametrize("at_start", [True, False])
@pytest.mark.parametrize(("share", "line"), [(0.99, True), (1.01, False)])
def test_an_end_with_the_slope_of_the_chord_up_to_1e_6_makes_a_line(at_start, share, line):
    """Relative to the sum of the magnitudes of three slopes: the chord's 1, this one's and the other's 2."""
    slopes = 1.0 + share * 4e-6, -2.0
    slope, slope_end = slopes if at_start else slopes[::-1]
    s = Input(autonomous=True, value=3.0, value_end=3.5, slope=slope, slope_end=slope_end)
    s.interpolate(3, 0.5, 1.0)
    assert (tuple(s.c) == (3.0, 1.0, 0.0, 0.0)) == line
    call("input_true_course", ctypes.byref(s.struct), 0.5, course := vector((9.0,) * 4))
    assert tuple(course) == tuple(s.c)


def test_an_input_takes_the_numbers_of_another_but_not_its_wires():
    """Of the machines that are chosen."""
    fields = [name for name, _ in CouplingInput._fields_]
    numbers, wires = fields[: fields.index("source_slope")], fields[fields.index("source_slope") :]

    def read(s, names):
        return [tuple(x) if hasattr(x := getattr(s.struct, name), "__len__") else x for name in names]

    one, other = Input(order=1, target=4, value=1.0), Input(source_slope=None, order=2, weight=3.0, value=2.0)
    before, wiring = read(one, numbers), read(one, wires)
    for machines, expected in ((0, before), (1, read(other, numbers))):
        one.replace(ctypes.byref(other.struct), machines)
        assert read(one, numbers) == expected
        assert read(one, wires) == wiring
    assert expected != before


@pytest.mark.parametrize("order", range(4))
def test_the_past_of_the_start_is_a_straight_line(order):
    """Or a constant if there is no slope yet."""
    for slope, known in ((3.0, 3.0), (math.nan, 0.0)):
        s = Input(order=order)
        s.begin(2.0, slope)
        assert tuple(s.c) == (2.0, known, 0.0, 0.0)
        points = [s.slopes_known]
        s.extrapolate(0.5, 0.0)
        assert tuple(s.c) == (2.0, known if order else 0.0, 0.0, 0.0)
        assert s.expected == at(s.c, 0.5)
        s.set_end(4.0, 5.0, 0.5, 0.0, 0.0)
        s.interpolate(3, 0.5, 0.0)  # without a slope at the beginning: the line between both ends
        assert (tuple(s.c) == (2.0, 4.0, 0.0, 0.0)) == (known == 0.0)
        s.accept(0.5)
        assert (s.slope_before, s.chord_before) == ((3.0, 4.0) if known else (5.0, 5.0))
        for _ in range(2):
            points.append(s.slopes_known)
            s.accept(0.5)
        assert points == ([1, 2, 2] if known else [0, 1, 2])
