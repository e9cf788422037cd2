"""Resampling is exact for linear signals, keeps gaps, and has no aliasing."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fmus.identification.recordings.clock import resample, uniform_rate
from orchestrator.base.errors import Problem
from orchestrator.data.recording import Sensor


@given(rate=st.floats(20, 2000), slope=st.floats(-5, 5), jitter=st.floats(0, 0.2), seed=st.integers(0, 1000))
def test_a_ramp_stays_a_ramp(recording, rate, slope, jitter, seed):
    """Interpolation and filter are exact for a ramp, for any jitter of the old clock."""
    made = recording(x=np.zeros(400))
    late = np.random.default_rng(seed).uniform(-jitter, jitter, 400) / 200
    made = replace(made, time=made.time + late)
    ramp = replace(made, signals={"x": 1 + slope * made.time})
    found = resample(ramp, rate)
    assert uniform_rate(found) == pytest.approx(rate, rel=1e-9)
    # the filter continues a ramp as a ramp at both ends: rounding, times the filter's poles near 1
    np.testing.assert_allclose(found["x"], 1 + slope * found.time, atol=1e-6 * (1 + abs(slope)))


def test_what_is_above_half_the_new_rate_does_not_fold_back(recording):
    """From 200 Hz to 50 Hz: 2 Hz passes; 40 Hz, with an alias at 10 Hz, is removed."""
    t = np.arange(2000) / 200
    slow, fast = np.sin(2 * np.pi * 2 * t), np.sin(2 * np.pi * 40 * t)
    found = resample(recording(both=slow + fast, slow=slow), 50.0)
    inside = slice(50, -50)
    # Butterworth of order 8 at 20 Hz, forwards and back: 1 - 1e-16 at 2 Hz, 1 / (1 + 2^16) at 40 Hz
    np.testing.assert_allclose(found["both"][inside], slow[::4][inside], atol=2e-4)
    # linear interpolation meets the samples themselves, every fourth one
    np.testing.assert_allclose(found["slow"][inside], slow[::4][inside], atol=1e-6)


@pytest.mark.parametrize("rate", [50.0, 200.0, 900.0])
def test_gaps_stay_gaps(recording, rate):
    """A missing value and a missing sample are gaps of the same length in the new clock."""
    values = np.arange(400.0)
    values[100:110] = np.nan
    made = recording(x=values, y=np.arange(400.0))
    kept = np.ones(400, dtype=bool)
    kept[200:220] = False
    made = replace(made, time=made.time[kept], signals={n: v[kept] for n, v in made.signals.items()})
    found = resample(made, rate)
    t = 200 * found.time
    # samples 99 and 110, 199 and 220 are there; rounding decides for a new sample that falls on one
    sure = np.abs(np.round(t) - t) > 1e-6 if rate == 900 else ~np.isin(np.round(t), [99, 110, 199, 220])
    lost, empty = (t > 199) & (t < 220), (t > 99) & (t < 110)
    assert np.array_equal(np.isnan(found["x"])[sure], (lost | empty)[sure])
    assert np.array_equal(np.isnan(found["y"])[sure], lost[sure])


def test_going_down_uses_good_samples_only(recording):
    """A clipped interval becomes a gap at a lower rate and is kept at a higher one."""
    values = 10 * np.sin(np.arange(800) / 50)
    made = recording(x=np.minimum(values, 8.0), sensors={"x": Sensor(high=8.0)})
    found = resample(made, 50.0)
    assert np.isnan(found["x"][(values >= 8.0)[::4]]).all()
    assert np.nanmax(resample(made, 400.0)["x"]) == 8.0


@pytest.mark.parametrize("rate", [50.0, 200.0, 730.0])
def test_commands_are_held(recording, rate):
    """A step of a command stays a step, at the first new sample that is not earlier."""
    made = recording(u=np.repeat([0.0, 3.0], 100), x=np.zeros(200))
    found = resample(made, rate, hold=["u"])
    assert np.array_equal(found["u"], np.where(found.time > 0.5 - 1e-7, 3.0, 0.0))


def test_sensor_behind_the_filter_has_the_noise_that_is_left(recording):
    """The noise of the new sensor is the standard deviation after the filter."""
    rng = np.random.default_rng(1)
    made = recording(x=rng.normal(0, 2.0, 80_000), sensors={"x": Sensor(noise=2.0)})
    found = resample(made, 20.0)
    # 8000 samples: 1 / sqrt(16 000) = 0.8 %, four times that
    assert found["x"].std() == pytest.approx(found.sensor("x").sd, rel=0.032)
    assert resample(made, 200.0).sensor("x") == made.sensor("x")


def test_uniform_rate_refuses_a_clock_that_is_not_uniform(recording):
    """Jitter beyond a twentieth of a period, or a missing sample, is refused with its time."""
    made = recording(x=np.zeros(100))
    assert uniform_rate(made) == pytest.approx(200.0, rel=1e-12)
    time = made.time.copy()
    time[40:] += 0.005
    with pytest.raises(Problem, match=r"memory\.csv: time 0\.\d+ s is \d+ % of a period off.*resample"):
        uniform_rate(replace(made, time=time))
    with pytest.raises(Problem, match="two or more samples, got 1"):
        uniform_rate(recording(x=np.zeros(1)))
    with pytest.raises(Problem, match="a rate above 0 and two or more samples"):
        resample(made, 0.0)
