"""The delay of a delayed signal is estimated to a fraction of a sample, and a shift removes it."""

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from fmus.identification.recordings.derivatives import delay, shift
from fmus.identification.recordings.reading import add
from orchestrator.base.errors import Problem


def motion(t):
    """A signal like the motion of a machine: sums of sines up to 8 Hz that do not repeat."""
    return sum(np.sin(2 * np.pi * f * t + 3 * f) / f for f in (0.37, 1.13, 2.9, 5.1, 8.3))


@given(
    seconds=st.floats(-0.2, 0.2),
    gain=st.floats(0.1, 50),
    offset=st.floats(-100, 100),
    gap=st.integers(0, 900),
)
@example(seconds=0.0, gain=1.0, offset=0.0, gap=1)  # one sample before the gap
def test_delay_of_a_moved_signal_is_found(recording, seconds, gain, offset, gap):
    """The estimate is the true delay for any gain, offset and gap."""
    t = np.arange(1000) / 200
    first, second = motion(t), gain * motion(t - seconds) + offset
    first[gap : gap + 20] = np.nan
    found = delay(recording(a=first, b=second), "a", "b", 0.3)
    # the cubic spline at 8 Hz and 200 Hz errs by 1e-5 of the amplitude, near a gap more: 1e-3 of a sample
    assert found.seconds == pytest.approx(seconds, abs=1e-3 / 200)
    assert found.correlation > 0.9999


def test_standard_deviation_of_a_delay_is_that_of_many_trials(recording):
    """With white noise on the second signal, the estimates scatter by the reported standard deviation."""
    rng = np.random.default_rng(1)
    t = np.arange(600) / 200
    trials = [
        delay(recording(a=motion(t), b=motion(t - 0.0123) + rng.normal(0, 0.2, 600)), "a", "b", 0.1)
        for _ in range(60)
    ]
    seconds = np.array([trial.seconds for trial in trials])
    sd = np.mean([trial.sd for trial in trials])
    # 60 trials: 1 / sqrt(120) = 9 %, three times that
    assert seconds.std() == pytest.approx(sd, rel=0.27)
    # five standard deviations of the mean
    assert seconds.mean() == pytest.approx(0.0123, abs=5 * sd / np.sqrt(60))


def test_shift_takes_a_delay_out(recording):
    """A signal shifted by its delay is the original; samples from outside the recording are gaps."""
    t = np.arange(1000) / 200
    late = motion(t - 0.0233)
    late[500] = np.nan
    found = shift(recording(x=late), "x", 0.0233)["x"]
    # 0.0233 s are 4.66 samples: the last five come from outside, 495 and 496 from beside the gap
    assert np.flatnonzero(np.isnan(found)).tolist() == [495, 496, 995, 996, 997, 998, 999]
    there = np.isfinite(found)
    # the spline errs most at its ends, by the fourth power of 2 pi 8.3 / 200 = 0.26, over 8.3
    np.testing.assert_allclose(found[there], motion(t)[there], atol=1e-3)


def test_shift_of_a_command_is_a_shift_of_its_steps(recording):
    """Held values stay; whole samples are exact with every interpolation; a constant has no delay."""
    made = recording(u=np.repeat([0.0, 2.0, -1.0], 20))
    held = shift(made, "u", 0.0125, "previous")["u"]
    assert np.array_equal(held[:-3], made["u"][2:-1])
    for kind in ("cubic", "linear", "previous"):
        moved = shift(made, "u", 0.015, kind)["u"]
        # knots of the interpolation: rounding only
        np.testing.assert_allclose(moved[:-3], made["u"][3:], atol=1e-12)
    made = add(recording(a=np.zeros(100)), "b", np.arange(100.0), "1")
    with pytest.raises(Problem, match=r"memory\.csv: delay of b behind a: expected signals that vary"):
        delay(made, "a", "b", 0.1)
