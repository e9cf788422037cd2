"""Motor leakage procedure, eqs. (11), (12): estimates, coverage of the intervals, remarks on other flows."""

import re
from dataclasses import replace

import numpy as np
import pytest
from identification.procedures.bench import assert_coverage, changed, named, recorded, with_sensors
from identification.procedures.lumped_machine import KNOWN, PRESSURE
from kit.mistakes import problem, table

from fmus.identification import results as tests
from fmus.identification.procedures.motor_leakage import MOTOR_LEAKAGE
from orchestrator.data.recording import Sensor

R_IN, R_EX = 2.0e12, 1.1e12  # Pa.s/m3
TRUTH = {"internal_leakage_resistance": R_IN, "external_leakage_resistance": R_EX}
METER = Sensor("gear meter", 5e-6 / 60, 1e-2 / 60 / 4096, -5e-3 / 60, 5e-3 / 60)
SENSORS = {"pressure_a": PRESSURE, "pressure_b": PRESSURE, "flow_a": METER, "drain_flow": METER}
UNITS = {"pressure_a": "Pa", "pressure_b": "Pa", "flow_a": "m3/s", "drain_flow": "m3/s"}
CAPACITANCE = 1e-12  # m3/Pa, of line A: flow that is no leakage while the pressure rises


HIGH = 1e6 * np.array([2, 5, 9, 13, 17, 11, 7])  # Pa, each for 1.5 s with ramps of 0.2 s between them
TIME = np.arange(300 * HIGH.size) / 200
CORNERS = np.add.outer(1.5 * np.arange(HIGH.size), [0.2, 1.5]).ravel()
STEPPED = np.interp(TIME, CORNERS, np.repeat(HIGH, 2))


def recordings(seed=None, low=1e6, square=0.0, zero=0.0, tank=0.0):
    """Both directions; `square` [m3/s/Pa2] adds to the internal leakage, `zero` [m3/s] to the drain meter.

    Without a seed the instruments have a thousandth of their noise and no converter.
    """
    random, found = np.random.default_rng(seed), []
    fine = {n: Sensor("fine", s.noise * 1e-3, 0.0, s.low, s.high) for n, s in SENSORS.items()}
    sensors = fine if seed is None else SENSORS
    for k, port in enumerate("ab"):
        other = np.full_like(TIME, low)
        a, b = (STEPPED, other) if port == "a" else (other, STEPPED)
        d = a - b
        flow = d / R_IN + square * d * np.abs(d) + a / R_EX + CAPACITANCE * np.gradient(a, TIME)
        signals = {"pressure_a": a + tank, "pressure_b": b + tank, "flow_a": flow}
        signals["drain_flow"] = (a + b) / R_EX + zero
        conditions = {"shaft": "locked"} | ({"tank_pressure": tank} if tank else {})
        about = (UNITS, sensors, random, "motor_leakage", conditions)
        found.append(recorded(f"motor_leakage_{k + 1}", TIME, signals, *about))
    return found


def assert_within_errors(result):
    """Each resistance within 3.3 standard deviations: 1 in 1000 by chance, and the seeds are fixed."""
    for e in result.estimates:
        assert abs(e.value - TRUTH[e.name]) < 3.3 * e.sd


@pytest.mark.parametrize("tank", [0.0, 4e5])
def test_precise_instruments_give_both_resistances(tank):
    """Rising pressures are left out, both directions agree, and pressures are relative to the return line."""
    result = MOTOR_LEAKAGE.identify(recordings(tank=tank), KNOWN)
    assert (result.figure, len(result.panels)) == (8, 4)
    for e in result.estimates:
        assert e.unit == "Pa.s/m3"
        # five standard deviations, 0.05 % over a thousand
        assert e.value == pytest.approx(TRUTH[e.name], rel=3e-6)


def test_intervals_have_their_coverage():
    """In 60 noisy data sets 95 % of the intervals cover the truth; values within 2 %, few false alarms."""
    results = [MOTOR_LEAKAGE.identify(recordings(seed), KNOWN) for seed in range(60)]
    for name, truth in TRUTH.items():
        estimates = [named(result)[name] for result in results]
        assert_coverage(truth, estimates)
        # what is asked for; a standard deviation is 0.05 % and less
        assert [e.value for e in estimates] == pytest.approx([truth] * 60, rel=0.02)
    # 1 % each time: 4 or more of 60 in 0.3 %
    assert sum(bool(tests.named(r.findings)) for r in results) < 4


def test_a_flow_that_the_laminar_law_neglects_is_reported():
    """A quadratic part of 3 % at full pressure."""
    found = tests.named(MOTOR_LEAKAGE.identify(recordings(1, square=1e-21), KNOWN).findings)
    assert any(f.fault == "model" and "quadratic part of the internal" in f.sentence for f in found)


def test_a_port_at_the_end_of_its_transducer_is_left_out():
    """A port at 0 bar reads noise cut at zero, whose mean is too high: no bias from it."""
    assert_within_errors(MOTOR_LEAKAGE.identify([*recordings(3), *recordings(4, low=0.0)], KNOWN))


def test_a_stretch_with_clipped_samples_is_left_out():
    """A meter whose range ends within the noise of the highest flow: the mean of the rest is too small."""
    top = (HIGH.max() - 1e6) / R_IN + HIGH.max() / R_EX
    clipped = [
        changed(with_sensors(r, "flow_a", high=top), {"flow_a": np.minimum(r["flow_a"], top)})
        for r in recordings(5)
    ]
    result = MOTOR_LEAKAGE.identify(clipped, KNOWN)
    assert_within_errors(result)
    assert "13 steady stretches" in result.remarks[0]  # of 14


def each(change, seed=1, **more):
    """The recordings, with signals changed by a function of the recording."""
    return [changed(r, change(r)) for r in recordings(seed, **more)]


def test_offsets_of_meters_and_transducers_are_subtracted():
    """A drain meter off by 3 mL/min and transducers off by 2 bar do not bias the resistances."""
    shifted = each(
        lambda r: {"pressure_a": r["pressure_a"] + 2e5, "pressure_b": r["pressure_b"] - 1e5}, zero=3e-6 / 60
    )
    result = MOTOR_LEAKAGE.identify(shifted, KNOWN)
    assert_within_errors(result)
    assert all(e.sd < 1e-3 * e.value for e in result.estimates)


def test_leakage_too_small_to_be_determined_is_not_estimated():
    """Meters that show only their noise: no estimate, and remarks say so."""
    random = np.random.default_rng(4)
    still = each(
        lambda r: {n: METER.noise * random.standard_normal(r.time.size) for n in ("flow_a", "drain_flow")}
    )
    result = MOTOR_LEAKAGE.identify(still, KNOWN)
    assert not result.estimates
    assert sum("do not determine" in text for text in result.remarks) == 2


def test_ripple_of_the_pump_does_not_hide_a_step():
    """1 bar at 40 Hz on the pressures, which is not white: the same steady stretches are detected."""
    rippled = each(
        lambda r: {n: r[n] + 1e5 * np.sin(2 * np.pi * 40 * r.time) for n in ("pressure_a", "pressure_b")}
    )
    plain, waved = (MOTOR_LEAKAGE.identify(some, KNOWN).remarks[0] for some in (recordings(1), rippled))
    assert waved == plain


@table(__file__, "mistakes", "change, message")
def test_wrong_data_are_refused_in_one_line(change, message):
    """A free shaft, no recording, no signal, another quantity."""
    assert message in problem(
        lambda: MOTOR_LEAKAGE.identify([replace(r, **change) for r in recordings()], KNOWN)
    )


@pytest.mark.parametrize(
    ("change", "message"),
    [
        # not a negative leakage, but a mistake
        (lambda r: {"drain_flow": -r["drain_flow"]}, r"leakage: expected positive, got -.*change the sign"),
        # a ramp has no steady point
        (
            lambda r: dict.fromkeys(("pressure_a", "pressure_b"), 1e6 + 1e6 * r.time),
            r"expected 3 or more stretches of .* with steady pressure_a, pressure_b, got 0",
        ),
    ],
)
def test_impossible_signals_are_refused_in_one_line(change, message):
    """A meter that counts backwards, pressures that never stand."""
    assert re.search(message, problem(lambda: MOTOR_LEAKAGE.identify(each(change), KNOWN)))
