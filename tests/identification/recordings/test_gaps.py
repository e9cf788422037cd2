"""Signals for simulation: short gaps are filled, long gaps refused, clocks resampled to uniform ones."""

from dataclasses import replace

import numpy as np
import pytest

from fmus.identification.recordings.clock import downsample, resample_uniformly, uniform_rate
from fmus.identification.recordings.reading import take
from orchestrator.base.errors import Problem
from orchestrator.data.recording import Sensor, fill_gaps


def test_short_gaps_are_bridged_by_straight_lines(recording):
    """A ramp with gaps of up to 0.1 s is the ramp again; before its first sample a signal is constant."""
    ramp = np.arange(200.0)
    holes = ramp.copy()
    holes[[50, *range(100, 119)]] = np.nan
    # interpolation of a ramp: rounding only
    np.testing.assert_allclose(fill_gaps(recording(u=holes), "u"), ramp, rtol=1e-12)
    holes[:3] = np.nan
    assert list(fill_gaps(recording(u=holes), "u")[:4]) == [3.0, 3.0, 3.0, 3.0]


def test_a_long_gap_is_refused_with_its_time(recording):
    """The motion of a lever over half a second is not interpolated."""
    holes = np.ones(400)
    holes[100:200] = np.nan
    with pytest.raises(Problem, match=r"u: expected gaps of at most 0\.1 s, got one from 0\.5 s to 0\.995 s"):
        fill_gaps(recording(u=holes), "u")
    with pytest.raises(Problem, match="u: expected a sample"):
        fill_gaps(recording(u=np.full(10, np.nan)), "u")


def test_lost_rows_become_gaps(recording):
    """Half a second of lost rows: a uniform clock with gaps, and the other samples unchanged."""
    made = recording(u=np.arange(400.0))
    assert resample_uniformly(made) is made  # its clock is uniform
    rows = np.r_[0:100, 200:400]
    found = resample_uniformly(take(made, rows))
    assert uniform_rate(found) == pytest.approx(200.0, rel=1e-9)  # rounding of stamps
    missing = np.isnan(found["u"])
    assert list(np.flatnonzero(missing)) == list(range(100, 200))
    np.testing.assert_allclose(found["u"][~missing], made["u"][rows], atol=1e-6)  # rounding of stamps


def test_jitter_is_taken_off(recording):
    """With time stamps up to a fifth of a period late, a line over true time is a line over the new clock."""
    made = recording(u=np.zeros(400))
    late = np.random.default_rng(2).uniform(0, 0.2, 400) / 200
    time = made.time + late
    found = resample_uniformly(replace(made, time=time, signals={"u": 3 * time}))
    assert uniform_rate(found) > 0
    np.testing.assert_allclose(found["u"], 3 * found.time, atol=1e-12)  # interpolation of a line: rounding


def test_a_fast_recording_is_thinned(recording):
    """From 5 kHz to 500 Hz: commands are held, other signals filtered, the noise of the sensor is reduced."""
    rng = np.random.default_rng(4)
    t = np.arange(20_000) / 5000
    noisy = np.sin(2 * np.pi * t) + rng.normal(0, 0.1, t.size)
    steps = np.where(t < 2, 0.0, 3.0)
    made = recording(rate=5000.0, sensors={"x": Sensor(noise=0.1)}, x=noisy, boom_command=steps)
    found = downsample(made)
    assert uniform_rate(found) == pytest.approx(500.0)  # rounding of stamps
    assert set(found["boom_command"]) == {0.0, 3.0}
    error = (found["x"] - np.sin(2 * np.pi * found.time))[50:-50]
    # the standard error of a standard deviation of 1900 samples that the filter correlates a little: 3 %
    assert error.std() == pytest.approx(found.sensor("x").sd, rel=0.1)
    assert found.sensor("x").sd < 0.04
    assert downsample(found) is found


def test_a_slow_encoder_does_not_gain_by_the_filter(recording):
    """A step of 1 and a turn of 20 steps in 4 s: the reported error is the remaining error."""
    t = np.arange(20_000) / 5000
    true = 5.0 * t
    made = recording(rate=5000.0, sensors={"x": Sensor(resolution=1.0)}, x=np.round(true))
    found = downsample(made)
    error = (found["x"] - 5.0 * found.time)[50:-50]
    # a saw tooth of 20 periods, whose corners the filter rounds a little
    assert error.std() == pytest.approx(found.sensor("x").sd, rel=0.05)
