"""Warnings at the top of the page and in the terminal."""

from __future__ import annotations

import math

from identification.report.test_refined import NAMES, refined, traces

from fmus.identification.report.report_texts import CHECK, warnings


def test_a_good_fit_has_no_warnings():
    """Converged, inside the bounds, 3 % and 4 % of the range: an empty list."""
    assert warnings(refined(at_bound=())) == []


def test_warnings_have_the_names_of_the_report():
    """The search, the bound and the poor signal, in this order, then the advice."""
    poor = refined(converged=False, reason="40 iterations", training=(traces("a", 0.03), traces("b", 0.4)))
    search, bound, fit, check = warnings(poor, NAMES, {"angle": "manipulator.angle"})
    assert "did not converge: 40 iterations" in search
    assert "boom_stick.hose" in bound
    # root mean square of 3 % and 40 % over the same range
    assert "manipulator.angle 28 %" in fit
    assert "flow" not in fit  # it was never measured
    assert check == CHECK


def test_a_failed_simulation_is_a_warning():
    """No value, but the name of the signal."""
    *_, fit, _ = warnings(refined(at_bound=(), training=(traces("a", math.nan),)))
    assert "angle (could not be simulated)" in fit
