"""The rating of ISO/TS 18571 is that of an independent implementation, and of examples by hand."""

import numpy as np
import pytest

from orchestrator.results.iso18571 import rate

N = 104  # a tenth and a fifth of it are no whole numbers of samples
TIME = np.linspace(0.0, 4.0, N)


@pytest.fixture(scope="module")
def theirs():
    """The ratings by the package of Openvt's ISO working group, unrounded."""
    # its warping in time as Python: to compile it takes longer than all of these curves
    numba = pytest.importorskip("numba")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(numba.config, "DISABLE_JIT", True)
        rating = pytest.importorskip("objective_rating_metrics.rating")

    def parts(simulation, reference):
        curves = [np.column_stack((TIME, y)) for y in (reference, simulation)]
        rated = rating.ISO18571(*curves, dt=TIME[1])
        names = ("overall", "corridor", "phase", "magnitude", "slope")
        return [getattr(rated, f"{name}_rating")(-1) for name in names]

    return parts


def pulse(scale=1.0, delay=0.0, tail=0.0):
    """A pulse and what swings after it."""
    at = TIME - delay
    return scale * np.exp(-((at - 1.2) ** 2) / 0.1) + tail * np.sin(7 * at) * np.exp(-0.4 * at)


CASES = {
    "scaled": (pulse(1.1, tail=0.2), pulse(tail=0.2)),
    "late": (pulse(delay=0.15, tail=0.2), pulse(tail=0.2)),
    "early and scaled": (pulse(0.8, -0.2, 0.1), pulse(tail=0.2)),
    "too late": (pulse(delay=1.5), pulse()),
    "another shape": (pulse(tail=0.6), pulse(tail=-0.3)),
    "offset": (pulse(tail=0.2) + 0.3, pulse(tail=0.2)),
    "upside down": (-pulse(tail=0.3), pulse(tail=0.3)),
    # the second pulse is further away than time may be warped
    "second late": (pulse() - pulse(0.4, 2.0), pulse() - pulse(0.4, 1.5)),
    "noisy": (pulse(tail=0.2) + np.random.default_rng(3).normal(0.0, 0.05, N), pulse(tail=0.2)),
}


@pytest.mark.parametrize("case", CASES)
def test_every_part_is_that_of_another_implementation(theirs, case):
    """Corridor, phase, magnitude and slope, from nearly equal curves to those that have nothing in common."""
    # the same sums in another order: rounding
    np.testing.assert_allclose(rate(*CASES[case]), theirs(*CASES[case]), rtol=1e-9, atol=1e-12)


def test_a_shift_costs_phase_and_the_corridor_falls_by_the_square():
    """n of N samples late: 1 - n / (0.2 N), equal shape; half way between the corridors a quarter."""
    n, late = 400, 20
    whole = np.sin(np.linspace(0.0, 9.0, n + late)) * np.linspace(1.0, 2.0, n + late)
    found = rate(whole[:n], whole[late:])
    # exact but for rounding
    assert found.phase == pytest.approx(1 - late / (0.2 * n), rel=1e-12)
    assert found.magnitude == pytest.approx(1.0, abs=1e-12)
    assert found.slope == pytest.approx(1.0, abs=1e-12)
    reference = np.where(TIME < 2.0, 1.0, -1.0)
    assert rate(reference + 0.275, reference).corridor == pytest.approx(0.25, rel=1e-12)
