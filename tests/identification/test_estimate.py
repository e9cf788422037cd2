"""Confidence intervals: width, shape and bounds."""

import math

import pytest

from fmus.identification.estimate import Estimate, confidence_interval, coverage_factor


def test_a_normal_interval_reaches_196_standard_deviations():
    """The 97.5 % quantile of the normal distribution, from tables."""
    # tables have six digits
    assert coverage_factor() == pytest.approx(1.959964, abs=1e-6)
    assert confidence_interval(5.0, 2.0) == pytest.approx((1.080072, 8.919928), abs=1e-5)


@pytest.mark.parametrize(("freedom", "factor"), [(1, 12.7062), (4, 2.77645), (30, 2.04227)])
def test_few_degrees_of_freedom_widen_it(freedom, factor):
    """Student's t, from tables."""
    # tables have six digits
    assert coverage_factor(freedom) == pytest.approx(factor, rel=1e-5)
    low, high = confidence_interval(0.0, 1.0, freedom)
    assert (-low, high) == pytest.approx((factor, factor), rel=1e-5)


def test_logarithmic_cut_and_open_intervals():
    """A positive value times and over a factor; bounds cut it; an unknown error leaves it open."""
    low, high = confidence_interval(2.0, 1.0, log=True)
    # exact identity: rounding only
    assert (low * high, high / 2.0) == pytest.approx((4.0, math.exp(coverage_factor() / 2)))
    assert confidence_interval(-2.0, 1.0, log=True) == confidence_interval(-2.0, 1.0)
    assert confidence_interval(1.0, 1.0, minimum=0.0, maximum=1.5) == (0.0, 1.5)
    assert confidence_interval(1.0, math.inf) == (-math.inf, math.inf)
    note = Estimate.normal("mass", 1.0, "kg", math.inf, "by hand", minimum=0.0).number().note
    assert note == "by hand; 95 % interval 0 to open"
