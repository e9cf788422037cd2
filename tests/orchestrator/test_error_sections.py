"""How the error estimate reads a source: corners, fourth derivatives, sections, linearisations."""

from ctypes import byref, c_double

import numpy as np
import pytest
from kit.mistakes import table

from orchestrator.engine.c_library import Binding, library
from orchestrator.engine.linear_system import ERROR_ROWS, LinearSystem


class Estimate(LinearSystem):
    """States x' = a x + u, whose input u is 0 while its source is not: the defect is the source itself."""

    def __init__(self, lag=10**6, states=1):
        super().__init__(states, 1)
        self.b[:, 0] = 1.0
        wide = self.n_padded
        self.e, self.stages, self.factors = map(np.zeros, (wide, (ERROR_ROWS, wide), (states, wide)))
        self.w, self.middle = np.zeros(self.m_padded), np.zeros(self.m_padded)
        self.defects, self.lengths, self.starts = np.zeros((1, 2)), np.zeros(3), np.zeros(2)
        self.diagonal, self.slope = np.zeros(states), np.zeros(1)
        binding = self.binding = Binding()
        h = binding.h
        self.source = binding.array(h.CouplingInput, [h.CouplingInput(source_slope=binding.at(self.slope))])
        self.source[0].fmu_degree = self.source[0].requested_degree = 3
        self.source[0].slopes_known = 2
        self.input = binding.array(h.ErrorInput, [h.ErrorInput(substeps=1)])
        names = "e stages factors w middle defects lengths diagonal starts"
        self.state = h.ErrorPropagation(
            system=self.system_struct(binding),
            inputs=binding.pointer(self.input),
            longest_section=100,
            longest_lag=20,
            sample=10**6,
            lag=lag,
            **binding.all_at(self, names),
        )
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
