"""Uniform clocks: gaps are filled or stay, resampling is exact and has no aliasing, derivatives."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from identification.recordings.conftest import recording
from kit.mistakes import problem
from kit.properties import examples

from fmus.identification.recordings import clock
from fmus.identification.recordings.reading import take
from orchestrator.data.recording import Sensor, fill_gaps


def test_short_gaps_are_bridged_by_straight_lines_and_long_ones_refused():
    """Up to 0.1 s a ramp is the ramp again; before its first sample a signal is constant; others are told."""
    ramp = np.arange(200.0)
    holes = ramp.copy()
    holes[[50, *range(100, 119)]] = np.nan
    # interpolation of a ramp: rounding only
    np.testing.assert_allclose(fill_gaps(recording(u=holes), "u"), ramp, rtol=1e-12)
    holes[:3] = np.nan
    assert list(fill_gaps(recording(u=holes), "u")[:4]) == [3.0, 3.0, 3.0, 3.0]

    holes = np.ones(400)
    holes[100:200] = np.nan
    told = r"u: expected gaps of at most 0\.1 s, got one from 0\.5 s to 0\.995 s"
    problem(lambda: fill_gaps(recording(u=holes), "u"), told)
    problem(lambda: fill_gaps(recording(u=np.full(10, np.nan)), "u"), "u: expected a sample")


def test_lost_rows_become_gaps():
    """Half a second of lost rows: a uniform clock with gaps, and the other samples unchanged."""
    made = recording(u=np.arange(400.0))
    assert clock.resample_uniformly(made) is made  # its clock is uniform
    rows = np.r_[0:100, 200:400]
    found = clock.resample_uniformly(take(made, rows))
    assert clock.uniform_rate(found) == pytest.approx(200.0, rel=1e-9)  # rounding of stamps
    missing = np.isnan(found["u"])
    assert list(np.flatnonzero(missing)) == list(range(100, 200))
    np.testing.assert_allclose(found["u"][~missing], made["u"][rows], atol=1e-6)  # rounding of stamps


@pytest.mark.parametrize("jitter", [0.001, 0.0015])
def test_a_late_sample_is_no_gap(jitter):
    """Jitter of 20 and 30 % of a period: only the lost rows are gaps, and a ramp stays a ramp."""
    made = recording(u=np.zeros(2000))
    late = np.random.default_rng(2).normal(0, jitter, 2000)
    kept = np.r_[0:1000, 1100:2000]
    time = np.sort((made.time + late)[kept])
    found = clock.resample_uniformly(replace(made, time=time, signals={"u": time}))
    missing = np.isnan(found["u"])
    # half a second, from a stamp that is late or early to another one; few single samples
    assert missing[np.abs(found.time - 5.25) < 0.24].all()
    assert missing[np.abs(found.time - 5.25) > 0.26].sum() <= 4
    np.testing.assert_allclose(found["u"][~missing], found.time[~missing], atol=1e-12)  # a line, rounding


def test_a_fast_recording_is_thinned():
    """From 5 kHz to 500 Hz: commands are held, other signals filtered, the noise of the sensor is reduced."""
    rng = np.random.default_rng(4)
    t = np.arange(80_000) / 5000
    noisy = np.sin(2 * np.pi * t) + rng.normal(0, 0.1, t.size)
    steps = np.where(t < 2, 0.0, 3.0)
    made = recording(rate=5000.0, sensors={"x": Sensor(noise=0.1)}, x=noisy, boom_command=steps)
    found = clock.downsample(made)
    assert clock.uniform_rate(found) == pytest.approx(500.0)  # rounding of stamps
    assert set(found["boom_command"]) == {0.0, 3.0}
    error = (found["x"] - np.sin(2 * np.pi * found.time))[50:-50]
    # 7900 samples that the filter correlates a little: 1 / sqrt(15 800) = 0.8 %, four times that
    assert error.std() == pytest.approx(found.sensor("x").sd, rel=0.032)
    assert found.sensor("x").sd < 0.04
    assert clock.downsample(found) is found
    assert clock.resample(made, 5000.0).sensor("x") == made.sensor("x")


def test_a_slow_encoder_does_not_gain_by_the_filter():
    """A step of 1 and a turn of 20 steps in 4 s: the reported error is the remaining error."""
    t = np.arange(20_000) / 5000
    true = 5.0 * t
    made = recording(rate=5000.0, sensors={"x": Sensor(resolution=1.0)}, x=np.round(true))
    found = clock.downsample(made)
    error = (found["x"] - 5.0 * found.time)[50:-50]
    # a saw tooth of 20 periods, whose corners the filter rounds a little
    assert error.std() == pytest.approx(found.sensor("x").sd, rel=0.05)


# ---- resampling


@given(rate=st.floats(20, 2000), slope=st.floats(-5, 5), jitter=st.floats(0, 0.2), seed=st.integers(0, 1000))
def test_a_ramp_stays_a_ramp(rate, slope, jitter, seed):
    """Interpolation and filter are exact for a ramp, for any jitter of the old clock, which they remove."""
    made = recording(x=np.zeros(400))
    late = np.random.default_rng(seed).uniform(-jitter, jitter, 400) / 200
    made = replace(made, time=made.time + late)
    ramp = replace(made, signals={"x": 1 + slope * made.time})
    found = clock.resample(ramp, rate)
    assert clock.uniform_rate(found) == pytest.approx(rate, rel=1e-9)
    # the filter continues a ramp as a ramp at both ends: rounding, times the filter's poles near 1
    np.testing.assert_allclose(found["x"], 1 + slope * found.time, atol=1e-6 * (1 + abs(slope)))
    same = clock.resample_uniformly(ramp)
    # the median of 400 intervals, whose density at the centre is 1 / (2 jitter): five standard deviations
    assert clock.uniform_rate(same) == pytest.approx(200, rel=5 * jitter / np.sqrt(400) + 1e-9)
    np.testing.assert_allclose(same["x"], 1 + slope * same.time, atol=1e-12 * (1 + abs(slope)))


def test_what_is_above_half_the_new_rate_does_not_fold_back():
    """From 200 Hz to 50 Hz: 2 Hz passes, 40 Hz, with an alias at 10 Hz, is removed, 24 Hz is reduced."""
    t = np.arange(2000) / 200
    slow, fast = np.sin(2 * np.pi * 2 * t), np.sin(2 * np.pi * 40 * t)
    found = clock.resample(recording(both=slow + fast, slow=slow), 50.0)
    inside = slice(50, -50)
    # Butterworth of order 8 at 20 Hz, forwards and back: 1 - 1e-16 at 2 Hz, 1 / (1 + 2^16) at 40 Hz
    np.testing.assert_allclose(found["both"][inside], slow[::4][inside], atol=2e-4)
    # linear interpolation meets the samples themselves, every fourth one
    np.testing.assert_allclose(found["slow"][inside], slow[::4][inside], atol=1e-6)
    high = np.sin(2 * np.pi * 24 * t)
    # Butterworth of order 8 with its corner at 20 Hz, both in the frequencies of the bilinear transform
    gain = 1 / (1 + (np.tan(np.pi * 24 / 200) / np.tan(np.pi * 20 / 200)) ** 16)
    left = clock.resample(recording(high=high), 50.0)["high"][inside].std()
    assert left == pytest.approx(gain / 2**0.5, rel=0.01)


@pytest.mark.parametrize("rate", [50.0, 200.0, 900.0])
def test_gaps_stay_gaps(rate):
    """A missing value and a missing sample are gaps of the same length in the new clock."""
    values = np.arange(400.0)
    values[100:110] = np.nan
    made = recording(x=values, y=np.arange(400.0))
    kept = np.ones(400, dtype=bool)
    kept[200:220] = False
    made = take(made, kept)
    found = clock.resample(made, rate)
    t = 200 * found.time
    # samples 99 and 110, 199 and 220 are there; rounding decides for a new sample that falls on one
    sure = np.abs(np.round(t) - t) > 1e-6 if rate == 900 else ~np.isin(np.round(t), [99, 110, 199, 220])
    lost, empty = (t > 199) & (t < 220), (t > 99) & (t < 110)
    assert np.array_equal(np.isnan(found["x"])[sure], (lost | empty)[sure])
    assert np.array_equal(np.isnan(found["y"])[sure], lost[sure])


def test_going_down_uses_good_samples_only():
    """A clipped interval becomes a gap at a lower rate and is kept at a higher one."""
    values = 10 * np.sin(np.arange(800) / 50)
    made = recording(x=np.minimum(values, 8.0), sensors={"x": Sensor(high=8.0)})
    found = clock.resample(made, 50.0)
    assert np.isnan(found["x"][(values >= 8.0)[::4]]).all()
    assert np.nanmax(clock.resample(made, 400.0)["x"]) == 8.0


@pytest.mark.parametrize("rate", [50.0, 200.0, 730.0])
def test_commands_are_held(rate):
    """A step of a command stays a step, at the first new sample that is not earlier."""
    made = recording(u=np.repeat([0.0, 3.0], 100), x=np.zeros(200))
    found = clock.resample(made, rate, hold=["u"])
    assert np.array_equal(found["u"], np.where(found.time > 0.5 - 1e-7, 3.0, 0.0))


def test_uniform_rate_refuses_a_clock_that_is_not_uniform():
    """Jitter beyond a twentieth of a period, or a missing sample, is refused with its time."""
    made = recording(x=np.zeros(100))
    assert clock.uniform_rate(made) == pytest.approx(200.0, rel=1e-12)
    time = made.time.copy()
    time[40:] += 0.005
    told = r"memory\.csv: time 0\.\d+ s is \d+ % of a period off.*resample"
    problem(lambda: clock.uniform_rate(replace(made, time=time)), told)
    problem(lambda: clock.uniform_rate(recording(x=np.zeros(1))), "two or more samples, got 1")
    problem(lambda: clock.resample(made, 0.0), "a rate above 0 and two or more samples")


# ---- derivatives


@given(
    coefficients=st.lists(st.floats(-10, 10), min_size=1, max_size=4),
    rate=st.sampled_from([50.0, 200.0, 1000.0]),
    samples=st.integers(3, 30),
)
def test_polynomials_up_to_the_degree_pass_exactly(coefficients, rate, samples):
    """Value, slope and curvature of a cubic are exact for any rate and window."""
    t = np.arange(4 * samples) / rate
    cubic = np.polynomial.Polynomial(coefficients)
    used = clock.SavitzkyGolay(rate, 2 * samples / rate, 3)
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
    used = clock.SavitzkyGolay(200.0, window, degree)
    samples = np.random.default_rng(seed).normal(size=40 * 1000 + used.size)
    for order in range(3):
        found = used.apply(samples, order)
        found = found[np.isfinite(found)]
        # at least 40 000 / 101 independent values: 1 / sqrt(2 * 400) = 3.5 %, five times that
        assert found.std() == pytest.approx(used.gain(order), rel=0.18)


def test_window_with_a_gap_gives_a_gap():
    """The result is missing for each window with a missing sample and at both ends, and nowhere else."""
    values = np.sin(np.arange(200) / 20)
    values[100] = np.nan
    used = clock.filter_for(recording(x=values), 0.05)
    assert used.size == 11
    missing = np.flatnonzero(np.isnan(used.apply(values, 1)))
    assert missing.tolist() == [*range(5), *range(95, 106), *range(195, 200)]
    assert np.isnan(used.apply(values[:10])).all()


@pytest.mark.parametrize(("degree", "samples"), [(2, 5), (3, 5), (4, 7)])
def test_a_slow_log_has_a_longer_window(degree, samples):
    """At least degree + 2 samples, an odd number; the filter alone refuses fewer than a polynomial needs."""
    for rate in (5.0, 20.0, 50.0, 59.0):
        assert clock.filter_for(recording(rate, x=np.zeros(50)), 0.03, degree).size == samples
    assert clock.filter_for(recording(1000.0, x=np.zeros(50)), 0.03, degree).size == 31
    told = r"window of 0\.01 s at 200 Hz is 3 samples; expected 2 <= degree"
    problem(lambda: clock.SavitzkyGolay(200.0, 0.01, max(degree, 3)), told)
