"""The benches: held points by closed forms, and readings of the instruments."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fmus.operator_input.work_cycle import RATE
from fmus.rig.experiments import (
    ANGLE,
    FLOW,
    HOLD,
    LEAKAGE,
    MOTOR_HOLD,
    PRESSURE,
    Experiment,
    experiment,
    generator,
    read,
)
from orchestrator.data.description import SignalDescription

BOTH = pytest.mark.parametrize("machine", ["lumped", "detailed"])
EDGES = pytest.mark.parametrize("edge", ["pa", "bt", "pb", "at"])
LITRES = 60e3  # L/min in 1 m3/s
# numbers of the parts' parameters.toml, written down once more
AREA, DISCHARGE, DENSITY, DEAD_BAND, ROUNDING, FULL = 4e-5, 0.62, 970.0, 0.6, 0.4, 10.0
LENGTH, BORE, VISCOSITY = 4.0, 0.01905, 0.02
HOSE_RESISTANCE = 3.2e10 * (VISCOSITY / 8e-3) ** 0.25  # at 170 L/min, eq. (10)
R_IN, R_EX = 2.0e12, 1.1e12


def held(e: Experiment, hold: float, after: float) -> dict[str, np.ndarray]:
    """Each true signal `after` seconds from the beginning of each hold."""
    at = np.round((1.0 + after + hold * np.arange((e.time[-1] - 1.0) / hold)) * RATE).astype(int)
    return {name: values[at] for name, values in e.signals.items()}


@BOTH
@EDGES
def test_a_held_edge_obeys_eq_1_and_2(machine, edge):
    """dP = C_R Q|Q| with C_R = rho/(2 C_d^2 A^2) and A a straight line; flows suit the meters."""
    x = held(experiment(f"valve_{edge}", machine), HOLD, 1.9)
    volts, flow, drop = np.abs(x["command"]), x["flow"], x["pressure_in"] - x["pressure_out"]
    open_ = volts >= 1.5  # beyond the rounded foot, which ends at 1 V, and far over the leakage
    area = AREA * (volts[open_] - DEAD_BAND - ROUNDING / 2) / (FULL - DEAD_BAND - ROUNDING / 2)
    resistance = DENSITY / (2 * DISCHARGE**2 * area**2)
    # leakage of the edge beside its orifice: 20 of 23 000 mL/min at 1.5 V, twice that share in the drop;
    # laminar below 0.6 L/min: (0.6/23)^2 / 2 of the drop
    assert drop[open_] == pytest.approx(resistance * flow[open_] ** 2, rel=3e-3)
    assert np.all(np.sign(x["command"]) == (1 if edge in ("pa", "bt") else -1) * (volts > 0))
    # readings are zero up to 1 V, as in Fig. 5; all flows are in range, and drops far above the noise
    assert np.all(flow[volts <= 1.0] * LITRES < 10)  # L/min, the dead zone
    assert np.all(flow[volts >= 1.25] * LITRES > 10)
    assert 250 < flow.max() * LITRES < 299
    assert np.all(drop > 1000 * 0.1e5)  # 1000 times the noise of 0.1 bar


@BOTH
def test_a_held_hose_obeys_its_law(machine):
    """4 m of 3/4 in: Darcy's friction factor 64/Re, at 170 L/min C_R and from there Blasius' Re^-1/4."""
    x = held(experiment("hose_resistance", machine), HOLD, 1.9)
    flow, drop = x["flow"], x["pressure_in"] - x["pressure_out"]
    speed = flow / (math.pi / 4 * BORE**2)
    reynolds = DENSITY * speed * BORE / VISCOSITY
    laminar = 64 / reynolds * LENGTH / BORE * DENSITY * speed**2 / 2
    turbulent = HOSE_RESISTANCE * flow**2 * (170 / LITRES / flow) ** 0.25
    share = 1 / (1 + (2300 / reynolds) ** 8)
    # lumped 1e-8; the detailed hose has not settled at the smallest flow, 2e-4 after 1.9 s
    assert drop == pytest.approx((1 - share) * laminar + share * turbulent, rel=1e-3)
    assert reynolds.min() < 1000
    assert reynolds.max() > 10000
    assert 20 <= flow.size <= 30
    assert flow.min() * LITRES > 10
    assert 275 < flow.max() * LITRES < 299


@BOTH
@pytest.mark.parametrize("number", [1, 2])
def test_a_locked_motor_obeys_eq_11_and_12(machine, number):
    """Q_a = (P_a - P_b)/R_in + P_a/R_ex, drain (P_a + P_b)/R_ex, at every held point."""
    x = held(experiment(f"motor_leakage_{number}", machine), MOTOR_HOLD, 2.9)
    a, b = x["pressure_a"], x["pressure_b"]
    # settled to far below 1e-6 of 1 L/min
    assert x["flow_a"] == pytest.approx((a - b) / R_IN + a / R_EX, rel=1e-6, abs=1e-12)
    assert x["drain_flow"] == pytest.approx((a + b) / R_EX, rel=1e-6)
    assert np.abs(x["flow_a"]).max() * LITRES < 5
    # both leakages can be told apart: the columns of the regression are far from parallel
    columns = np.column_stack([a - b, a])
    assert np.linalg.cond(columns / np.linalg.norm(columns, axis=0)) < 10


# ---- Readings of the instruments: noise, quantisation, range, dead zone, and nothing else

ALL = (PRESSURE, FLOW, LEAKAGE, ANGLE)
NOISY = (PRESSURE, FLOW, LEAKAGE)
SI = {"bar": 1e5, "L/min": 1e-3 / 60, "deg": math.pi / 180}  # value of one unit in SI
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
    """Every reading is a multiple of the resolution and inside the range, whose ends clip it."""
    found = readings(instrument, value, 5, seed)
    steps = found / instrument.resolution
    assert np.array_equal(steps, np.round(steps))  # exact: all steps are short binary fractions or n/4096
    if instrument == ANGLE:  # 65536 counts per turn and no noise
        assert ANGLE.resolution * 65536 == 360
        # rounding of the conversion
        assert np.abs(found - value).max() <= ANGLE.resolution / 2 + 1e-12 * abs(value)
        return
    low, high = instrument.span
    assert (high - low) / instrument.resolution == 4095  # exact, as above: 12 bit have 4096 codes
    assert np.all((found >= low) & (found <= high))
    assert np.all(readings(instrument, 1.1 * high + 1, 9) == high)


def test_a_turbine_stands_still_below_its_dead_zone():
    """In both directions the reading is exactly zero below 10 L/min, and the flow with noise above."""
    for sign in (-1, 1):
        assert not readings(FLOW, sign * 9.999, 1000).any()
        turning = readings(FLOW, sign * 10.001, 1000)
        assert np.all(np.abs(turning - sign * 10) < 6 * FLOW.noise)  # six standard deviations


def test_each_file_and_signal_has_noise_of_its_own():
    """Random numbers of different seeds, files and signals are independent; equal ones are equal."""
    names = [(0, "a", "p"), (1, "a", "p"), (0, "b", "p"), (0, "a", "q")]
    noise = np.array([generator(*name).normal(size=COUNT) for name in names])
    assert np.array_equal(noise[0], generator(*names[0]).normal(size=COUNT))
    correlation = np.corrcoef(noise) - np.eye(len(names))
    assert np.abs(correlation).max() < 5 / math.sqrt(COUNT)  # five standard errors
