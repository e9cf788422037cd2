"""Readings of the instruments: noise, quantisation, range, dead zone, and nothing else."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fmus.rig.instruments import ANGLE, COMMAND, FLOW, LEAKAGE, PRESSURE, generator, read
from orchestrator.data.description import SignalDescription

ALL = (PRESSURE, FLOW, LEAKAGE, ANGLE)
NOISY = (PRESSURE, FLOW, LEAKAGE)
SI = {"bar": 1e5, "L/min": 1e-3 / 60, "deg": math.pi / 180, "V": 1.0}  # value of one unit in SI
COUNT = 200_000


def readings(instrument: SignalDescription, value: float, count: int = COUNT, seed: int = 3) -> np.ndarray:
    """Readings of a constant true value in the instrument's own unit."""
    true = np.full(count, value * SI[instrument.unit])
    return read(instrument, true, generator(seed, "file", "signal"))


@pytest.mark.parametrize("instrument", NOISY, ids=lambda i: i.sensor)
def test_noise_is_white_and_has_the_told_size_and_no_bias(instrument):
    """Mean and standard deviation are those of the truth with white noise and the converter's step."""
    value = 0.37 * instrument.span[1]  # between two steps, far from ends and dead zone
    error = readings(instrument, value) - value
    sd = math.hypot(instrument.noise, instrument.resolution / math.sqrt(12))
    # five standard errors of the mean; noise of half a step leaves the converter no bias of 1 % of it
    assert abs(error.mean()) < 5 * sd / math.sqrt(COUNT) + 0.01 * instrument.resolution
    # the standard error of a standard deviation is 1/sqrt(2 n), 0.16 %; the step's part is right to 1 %
    assert error.std() == pytest.approx(sd, rel=5 / math.sqrt(2 * COUNT) + 0.01)

    error = error - error.mean()  # of which adjacent samples are uncorrelated, because there is no filter
    for lag in (1, 2, 10):
        correlation = error[lag:] @ error[:-lag] / (error @ error)
        assert abs(correlation) < 5 / math.sqrt(COUNT)  # five standard errors


@pytest.mark.parametrize("instrument", ALL, ids=lambda i: i.sensor)
@given(value=st.floats(-1e3, 1e3), seed=st.integers(0, 2**32))
def test_readings_are_whole_steps_in_range(instrument, value, seed):
    """Every reading is a multiple of the resolution and inside the range."""
    found = readings(instrument, value, 5, seed)
    steps = found / instrument.resolution
    assert np.array_equal(steps, np.round(steps))  # exact: all steps are short binary fractions or n/4096
    low, high = instrument.span or (-math.inf, math.inf)
    assert np.all((found >= low) & (found <= high))


@pytest.mark.parametrize("instrument", NOISY, ids=lambda i: i.sensor)
def test_a_converter_of_12_bit_has_4096_codes(instrument):
    """The range has 4096 codes, and signals beyond an end are clipped."""
    low, high = instrument.span
    assert (high - low) / instrument.resolution == 4095  # exact, as above
    assert np.all(readings(instrument, 1.1 * high + 1, 100) == high)
    assert np.all(readings(instrument, low - 0.1 * high, 100) == low)


def test_a_turbine_stands_still_below_its_dead_zone():
    """In both directions the reading is exactly zero below 10 L/min, and the flow with noise above."""
    for sign in (-1, 1):
        assert not readings(FLOW, sign * 9.999, 1000).any()
        turning = readings(FLOW, sign * 10.001, 1000)
        assert np.all(np.abs(turning - sign * 10) < 6 * FLOW.noise)  # six standard deviations


@given(value=st.floats(-1e4, 1e4))
def test_an_encoder_errs_by_half_a_count(value):
    """65536 counts per turn and no noise."""
    assert ANGLE.resolution * 65536 == 360
    error = readings(ANGLE, value, 1)[0] - value
    assert abs(error) <= ANGLE.resolution / 2 + 1e-12 * abs(value)  # rounding of the conversion


@given(value=st.floats(-10, 10))
def test_a_command_is_known_exactly(value):
    """The reading of a command is the command."""
    assert readings(COMMAND, value, 1)[0] == value


def test_each_file_and_signal_has_noise_of_its_own():
    """Random numbers of different seeds, files and signals are independent; equal ones are equal."""
    names = [(0, "a", "p"), (1, "a", "p"), (0, "b", "p"), (0, "a", "q")]
    noise = np.array([generator(*name).normal(size=COUNT) for name in names])
    assert np.array_equal(noise[0], generator(*names[0]).normal(size=COUNT))
    correlation = np.corrcoef(noise) - np.eye(len(names))
    assert np.abs(correlation).max() < 5 / math.sqrt(COUNT)  # five standard errors
