"""What a simulation needs at every sample: short gaps are bridged, long ones refused, clocks made uniform."""

from dataclasses import replace

import numpy as np
import pytest

from fmus.contract import ModelError
from fmus.identification.recordings.signals import bridged, evenly, take, uniform_rate


def test_short_gaps_are_bridged_by_straight_lines(recording):
    """A ramp with gaps of up to 0.1 s is the ramp again; before its first sample a signal keeps its value."""
    ramp = np.arange(200.0)
    holes = ramp.copy()
    holes[[50, *range(100, 119)]] = np.nan
    # interpolation of a ramp: rounding only
    np.testing.assert_allclose(bridged(recording(u=holes), "u"), ramp, rtol=1e-12)
    holes[:3] = np.nan
    assert list(bridged(recording(u=holes), "u")[:4]) == [3.0, 3.0, 3.0, 3.0]


def test_a_long_gap_is_refused_with_its_time(recording):
    """What a lever did in half a second is not guessed."""
    holes = np.ones(400)
    holes[100:200] = np.nan
    with pytest.raises(
        ModelError, match=r"u has no sample from 0\.5 s to 0\.995 s, expected gaps of at most"
    ):
        bridged(recording(u=holes), "u")
    with pytest.raises(ModelError, match="u has no sample, expected one"):
        bridged(recording(u=np.full(10, np.nan)), "u")


def test_a_uniform_clock_is_left_alone(recording):
    """Nothing is interpolated where nothing has to be."""
    made = recording(u=np.arange(10.0))
    assert evenly(made) is made


def test_lost_rows_become_gaps(recording):
    """Half a second of rows that the logger lost: a uniform clock, no value inside, the others unchanged."""
    made = recording(u=np.arange(400.0))
    rows = np.r_[0:100, 200:400]
    found = evenly(take(made, rows))
    assert uniform_rate(found) == pytest.approx(200.0, rel=1e-9)  # rounding of stamps
    missing = np.isnan(found["u"])
    assert list(np.flatnonzero(missing)) == list(range(100, 200))
    np.testing.assert_allclose(found["u"][~missing], made["u"][rows], atol=1e-6)  # rounding of stamps


def test_jitter_is_taken_off(recording):
    """Stamps that are late by up to a fifth of a period: a line over true time is one over the new clock."""
    made = recording(u=np.zeros(400))
    late = np.random.default_rng(2).uniform(0, 0.2, 400) / 200
    time = made.time + late
    found = evenly(replace(made, time=time, signals={"u": 3 * time}))
    assert uniform_rate(found) > 0
    np.testing.assert_allclose(found["u"], 3 * found.time, atol=1e-12)  # interpolation of a line: rounding
