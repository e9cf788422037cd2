"""Confidence intervals: width, shape and bounds."""

import math

import pytest

from fmus.identification.results import Estimate, coverage_factor


def ends(value: float, sd: float, *freedom: float, **shape: object) -> tuple[float, float]:
    """The interval of a value."""
    estimate = Estimate.normal("mass", value, "kg", sd, "by hand", *freedom, **shape)
    return estimate.low, estimate.high


@pytest.mark.parametrize(
    ("freedom", "factor"), [(math.inf, 1.959964), (1, 12.7062), (4, 2.77645), (30, 2.04227)]
)
def test_an_interval_is_that_of_tables(freedom, factor):
    """The 97.5 % quantile of the normal distribution, and of Student's t for few degrees of freedom."""
    # tables have six digits
    assert coverage_factor(freedom) == pytest.approx(factor, rel=1e-5)
    assert ends(5.0, 2.0, freedom) == pytest.approx((5 - 2 * factor, 5 + 2 * factor), abs=2e-4)


def test_logarithmic_cut_and_open_intervals():
    """A positive value times and over a factor; bounds cut it; an unknown error leaves it open."""
    low, high = ends(2.0, 1.0, log=True)
    # exact identity: rounding only
    assert (low * high, high / 2.0) == pytest.approx((4.0, math.exp(coverage_factor() / 2)))
    assert ends(-2.0, 1.0, log=True) == ends(-2.0, 1.0)
    assert ends(1.0, 1.0, minimum=0.0) == (0.0, ends(1.0, 1.0)[1])
    assert ends(1.0, math.inf) == (-math.inf, math.inf)
    note = Estimate.normal("mass", 1.0, "kg", math.inf, "by hand", minimum=0.0).number().note
    assert note == "by hand; 95 % interval 0 to open"
