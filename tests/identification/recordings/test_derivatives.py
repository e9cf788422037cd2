"""The derivative filter is exact for polynomials, and its noise is the computed one."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from kit.properties import examples

from fmus.identification.recordings.clock import SavitzkyGolay, filter_for
from orchestrator.base.errors import Problem


@given(
    coefficients=st.lists(st.floats(-10, 10), min_size=1, max_size=4),
    rate=st.sampled_from([50.0, 200.0, 1000.0]),
    samples=st.integers(3, 30),
)
def test_polynomials_up_to_the_degree_pass_exactly(coefficients, rate, samples):
    """Value, slope and curvature of a cubic are exact for any rate and window."""
    t = np.arange(4 * samples) / rate
    cubic = np.polynomial.Polynomial(coefficients)
    used = SavitzkyGolay(rate, 2 * samples / rate, 3)
    size = sum(abs(c) for c in coefficients)
    for order in range(3):
        exact = cubic.deriv(order)(t) if order else cubic(t)
        found = used.apply(cubic(t), order)
        inside = np.isfinite(found)
        assert inside.sum() == len(t) - 2 * samples
        # scipy finds the weights from powers up to 30^3 of the places in the window: 1e-16 * 3e4, and as
        # much again for its conditioning
        tolerance = 1e-11 * (1 + size * max(1, t[-1] ** 3)) * max(used.gain(order), rate**order)
        np.testing.assert_allclose(found[inside], exact[inside], rtol=0, atol=tolerance)


@examples(15)
@given(window=st.floats(0.03, 0.5), degree=st.integers(2, 4), seed=st.integers(0, 2**31))
def test_gain_is_the_noise_of_a_simulation(window, degree, seed):
    """White noise with standard deviation 1 has the standard deviation `gain` after the filter."""
    used = SavitzkyGolay(200.0, window, degree)
    samples = np.random.default_rng(seed).normal(size=40 * 1000 + used.size)
    for order in range(3):
        found = used.apply(samples, order)
        found = found[np.isfinite(found)]
        # at least 40 000 / 101 independent values: 1 / sqrt(2 * 400) = 3.5 %, five times that
        assert found.std() == pytest.approx(used.gain(order), rel=0.18)


def test_window_with_a_gap_gives_a_gap(recording):
    """The result is missing for each window with a missing sample and at both ends, and nowhere else."""
    values = np.sin(np.arange(200) / 20)
    values[100] = np.nan
    used = filter_for(recording(x=values), 0.05)
    assert used.size == 11
    missing = np.flatnonzero(np.isnan(used.apply(values, 1)))
    assert missing.tolist() == [*range(5), *range(95, 106), *range(195, 200)]
    assert np.isnan(used.apply(values[:10])).all()


def test_window_that_is_too_short_is_refused(recording):
    """A cubic needs more than three samples."""
    with pytest.raises(Problem, match=r"window of 0\.01 s at 200 Hz is 3 samples; expected 2 <= degree"):
        filter_for(recording(x=np.zeros(50)), 0.01)
