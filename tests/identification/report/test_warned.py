"""Warnings at the top of the page and in the terminal."""

from __future__ import annotations

import math

from identification.report.test_refined import NAMES, refined, traces

from fmus.identification.refinement.gauss_newton import Iteration, TrustRegion
from fmus.identification.refinement.residuals import Whiteness
from fmus.identification.report.report_texts import CHECK, warnings


def test_a_good_fit_has_no_warnings():
    """Converged, inside the bounds, 3 % and 4 % of the range: an empty list."""
    assert warnings(refined(at_bound=())) == []


def test_residuals_far_above_the_noise_are_a_warning():
    """168 times the noise: the number, and the signals that show it most, by the names of the report."""
    trust = TrustRegion(1.0)
    history = (Iteration(0, 168.0, 0.1, 0.0, trust, {}),)
    tests = {"angle": Whiteness(0.0, 1.0, {}, 505.0), "flow": Whiteness(0.2, 0.01, {}, 1.1)}
    far = refined(history=history, whiteness=tests, at_bound=())
    told, check = warnings(far, NAMES, {"angle": "manipulator.angle"})
    assert "residuals 168 times as large as the noise" in told
    assert "(manipulator.angle 505 times)" in told
    assert check == CHECK


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
