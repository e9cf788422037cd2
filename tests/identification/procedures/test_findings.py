"""Faults of a bench are named by the test that sees them; a rest recording tells zeros."""

from dataclasses import replace

import numpy as np
import pytest
from identification.procedures import bench, lumped_machine
from identification.procedures.bench import BAR, changed, with_sensors

from fmus.identification import pipeline, results
from fmus.identification.procedures import damping, rest
from fmus.identification.procedures.hoses import HOSE_DYNAMICS, HOSE_RESISTANCE

UP_AND_DOWN = (*np.linspace(15.0, 275.0, 14), *np.linspace(265.0, 25.0, 12))  # L/min


def names(result):
    return {f.fault for f in results.named(result.findings)}


def hose(change=lambda r: r, flows=UP_AND_DOWN):
    """Faults of a hose at stepped flows."""
    (record,) = bench.steady_hose(1, bench.friction, flows)
    return names(HOSE_RESISTANCE.identify([change(record)], bench.KNOWN))


def falling(r, course):
    """The pressure drop falls by 3 % in a course from 0 to 1."""
    drop = r["pressure_in"] - r["pressure_out"]
    return changed(r, {"pressure_out": r["pressure_in"] - drop * (1 - 0.03 * course)})


def warmer(r):
    """It falls over the whole recording."""
    return falling(r, r.time / r.time[-1])


FAULTS = {
    "oil temperature": warmer,
    "zero of a pressure sensor": lambda r: changed(
        with_sensors(r, "pressure", zero_error=0.5 * BAR), {"pressure_out": r["pressure_out"] + 2 * BAR}
    ),
    "noise": lambda r: with_sensors(r, "flow", noise=1e-7),
    "saturated signal": lambda r: changed(r, {"flow": np.minimum(r["flow"], 250 * bench.LITRES)}),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_of_a_hose_is_named(fault):
    """Each fault alone, in a recording that is clean without it."""
    assert fault in hose(FAULTS[fault])
    assert not hose()


def test_a_recorded_temperature_takes_the_place_of_time():
    """A drop that follows the temperature, which rises at the end, is named with it."""
    (r,) = bench.steady_hose(1, bench.friction, UP_AND_DOWN)
    course = np.clip(2 * r.time / r.time[-1] - 1, 0.0, 1.0)
    r = replace(r, units={**r.units, "oil_temperature": "K"})
    heated = changed(falling(r, course), {"oil_temperature": 310 + 9 * course})
    found = results.named(HOSE_RESISTANCE.identify([heated], bench.KNOWN).findings)
    assert any("changes with the oil temperature by -" in f.sentence for f in found)


def test_angles_that_are_late_are_named():
    """Angles of a joint that are a sample late."""
    record = lumped_machine.recording("boom", seed=1)
    late = changed(record, {n: np.roll(record[n], 1) for n in record.signals if n.startswith("manipulator")})
    assert "time shift" in names(damping.identify([late], lumped_machine.KNOWN))


def at_rest(seed=0, **zeros):
    """Ten seconds without pressure and flow, read by instruments with these zeros."""
    return bench.recording("rest", {}, {n: np.full(2001, zero) for n, zero in zeros.items()}, seed)


def test_a_rest_recording_tells_zeros_also_at_the_end_of_a_range():
    """Zeros of +-0.05 bar, of which a transducer from 0 bar on cuts the lower half, over 20 seeds."""
    z, zeros = [], {"pressure_in": 5e3, "pressure_out": -5e3}
    for seed in range(20):
        result = rest.identify([at_rest(seed, **zeros, flow=0.0)], {})
        found = {e.name: e for e in result.others}
        assert set(found) == set(zeros)  # the turbine stands still
        z += [(found[n].value - true) / found[n].sd for n, true in zeros.items()]
        assert not names(result)
    # mean and mean square of 40 normal errors, four standard deviations
    assert abs(np.mean(z)) < 4 / np.sqrt(40)
    assert np.mean(np.square(z)) < 1 + 4 * np.sqrt(2 / 40)


def test_zeros_at_rest_are_subtracted_before_the_procedures():
    """Transducers 3 bar apart: C_R is right with a rest recording, whose finding names them."""
    (record,) = bench.steady_hose(1, bench.friction, UP_AND_DOWN)
    moved = changed(record, {"pressure_in": record["pressure_in"] + 3 * BAR})
    still = at_rest(2, pressure_in=3 * BAR, pressure_out=0.0)
    found = pipeline.identify([moved, still])
    at, hoses = found.results
    assert "zero of a pressure sensor" in names(at)
    assert not names(hoses)
    resistance = bench.named(hoses)["C_R"]
    assert abs(resistance.value - bench.RESISTANCE) < 4 * resistance.sd


def test_a_noise_that_is_described_wrongly_does_not_narrow_the_interval():
    """Noise described as a tenth of what the data show: the interval is that of the data, within a fifth."""
    groups = bench.moving_hose(3)
    sensors = groups[0].sensors.items()
    told = {n: replace(s, noise=s.noise / 10, resolution=s.resolution / 10) for n, s in sensors}
    wrong = [replace(g, sensors=told) for g in groups]
    right, other = (bench.named(HOSE_DYNAMICS.identify(g, bench.KNOWN))["I"] for g in (groups, wrong))
    assert other.sd == pytest.approx(right.sd, rel=0.2)
