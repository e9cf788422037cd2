"""Each planted fault is reported with its position, and a clean recording has no remarks."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from identification.recordings.conftest import GAUGE, RATE, SIZE, T, recording, rounded
from kit.mistakes import table

from fmus.identification.pipeline import hum_findings
from fmus.identification.recordings.masks import faults, noise, step
from fmus.identification.recordings.quality import examine, hum
from fmus.identification.recordings.reading import take
from orchestrator.data.recording import Recording, Sensor

METER = Sensor("turbine", noise=0.3, resolution=600 / 4096, low=-300.0, high=300.0, dead_zone=10.0)
ENCODER = Sensor("encoder", resolution=2 * np.pi / 65536)
SENSORS = {"pressure": GAUGE, "flow": METER, "angle": ENCODER}


@pytest.fixture
def clean():
    """A machine that rests, moves and holds, measured by three instruments, with an exact command."""
    rng, t = np.random.default_rng(3), T
    swing = np.where((t > 1) & (t < 16), np.sin(2 * np.pi * 0.2 * (t - 1)), 0.0)
    pressure = rounded(150 + 80 * swing + rng.normal(0, 0.1, SIZE), GAUGE.resolution)
    flow = rounded(120 * swing + rng.normal(0, 0.3, SIZE), METER.resolution)
    flow[np.abs(flow) <= 10] = 0.0
    angle = rounded(np.cumsum(swing) / RATE, ENCODER.resolution)
    command = np.select([t < 1, t < 8, t < 12, t < 16], [0.0, 4.0, -4.0, 8.0], 0.0)
    made = recording(sensors=SENSORS, pressure=pressure, flow=flow, angle=angle, command=command)
    return replace(made, units={"pressure": "1", "flow": "1", "angle": "rad", "command": "V"})


def plant(made, name, values, where):
    changed = made[name].copy()
    changed[where] = values
    return replace(made, signals={**made.signals, name: changed})


def test_nothing_is_found_on_a_clean_recording(clean):
    """Rest, steps of a command, a constant encoder and a meter at zero are not faults."""
    found = examine(clean)
    # the dead zone is not a fault, but a remark reports its samples
    assert [text for text in found.remarks() if "dead zone" not in text] == []
    assert found.rate == pytest.approx(RATE, rel=1e-12)  # stamps are exact: rounding only
    dead = next(text for text in found.remarks() if "dead zone of 10, not used" in text)
    assert dead.startswith(f"flow: {np.sum(clean['flow'] == 0)} samples")


def jitter_of(made):
    """The jitter [s] in the remark on it."""
    (text,) = (text for text in examine(made).clock if "jitter" in text)
    return 1e-3 * float(text.split()[4])


def remarks_on(made, name):
    """The remarks on one signal (or "The clock"), except the one on its dead zone."""
    texts = [text for text in examine(made).remarks() if text.startswith(f"{name}:")]
    return [text for text in texts if "dead zone" not in text]


def test_gaps_are_found_with_time_and_length(clean):
    """Missing samples are reported with number, intervals, time and length."""
    made = plant(plant(clean, "pressure", np.nan, slice(1000, 1040)), "pressure", np.nan, [2000])
    (text,) = remarks_on(made, "pressure")
    assert text == "pressure: 41 samples (1 %; in 2 parts, first at 5 s, longest 0.2 s) without a sample."


def test_clipping_at_the_end_of_the_range_and_below(clean):
    """Exactly the samples at the end of a range; an amplifier that saturates below stays at its extreme."""
    top = 200.0
    made = replace(clean, sensors={**clean.sensors, "pressure": replace(GAUGE, high=top)})
    made = plant(made, "pressure", np.minimum(made["pressure"], top), slice(None))
    assert np.array_equal(faults(made, "pressure")["clipped"], made["pressure"] == top)
    (text,) = remarks_on(made, "pressure")
    assert "clipped" in text
    made = plant(clean, "pressure", np.maximum(clean["pressure"], 100.0), slice(None))
    found = faults(made, "pressure")["clipped"]
    assert np.array_equal(found, made["pressure"] == 100.0)
    assert ["clipped" in text for text in remarks_on(made, "pressure")] == [True]


def test_the_zero_of_a_range_from_zero_on_is_not_a_fault(clean):
    """Half of the noise of a gauge without pressure is cut off; a broken cable reads zero all the time."""
    cut = rounded(np.maximum(np.random.default_rng(6).normal(0, 0.1, SIZE), 0), GAUGE.resolution)
    rest = plant(clean, "pressure", cut[:1500], slice(0, 1500))
    assert faults(rest, "pressure")["clipped"].sum() > 700
    assert remarks_on(rest, "pressure") == []
    broken = plant(rest, "pressure", 0.0, slice(200, 270))
    assert ["clipped" in text for text in remarks_on(broken, "pressure")] == [True]


def test_noise_and_steps_other_than_stated(clean):
    """A sensor with three times the stated noise, one with fewer bits, one with more bits than stated."""
    rng = np.random.default_rng(4)
    loud = plant(clean, "pressure", clean["pressure"] + rng.normal(0, 0.3, SIZE), slice(None))
    (text,) = remarks_on(loud, "pressure")
    assert "noise of 0.3" in text
    assert "stated 0.1" in text
    coarse = plant(clean, "angle", rounded(clean["angle"], 2 * ENCODER.resolution), slice(None))
    assert any("coarser than the stated resolution" in text for text in remarks_on(coarse, "angle"))
    stated = replace(clean, sensors={**clean.sensors, "angle": Sensor(resolution=2 * ENCODER.resolution)})
    assert any("finer than the stated resolution" in text for text in remarks_on(stated, "angle"))
    silent = replace(coarse, sensors={})
    assert any("without a stated resolution" in text for text in remarks_on(silent, "angle"))


def test_signal_that_does_not_move(clean):
    """A cable that is not plugged in, a column that is empty."""
    dull = plant(clean, "pressure", 0.5, slice(None))
    assert examine(dull).remarks()[-1] == "One value throughout: pressure (0.5)."
    (text,) = remarks_on(plant(clean, "pressure", np.nan, slice(None)), "pressure")
    assert text == "pressure: 4000 samples (all; first at 0 s, longest 20 s) without a sample."


def test_samples_that_are_lost_or_follow_too_soon(clean):
    """Number and longest interval; two stamps in quick succession are of one sample, written twice."""
    kept = np.ones(SIZE, dtype=bool)
    kept[[500, 501, 502, 2500]] = False
    (text,) = remarks_on(take(clean, kept), "The clock")
    told = "4 samples are missing; the longest interval is 20 ms at 2.495 s, the usual one 5 ms."
    assert text == f"The clock: {told}"
    soon = clean.time.copy()
    soon[[10, 20]] = soon[[9, 19]] + 0.0005
    texts = remarks_on(replace(clean, time=soon), "The clock")
    assert any("2 time stamps are less than half a period" in text for text in texts)


def test_jitter_and_drift_of_the_clock(clean):
    """Jitter of a computer that is late at times; one that is 0.4 of a period off has a drift."""
    rng = np.random.default_rng(5)
    made = replace(clean, time=clean.time + rng.normal(0, 0.0005, SIZE))
    assert ["jitter" in text for text in remarks_on(made, "The clock")] == [True]
    # standard deviation from 4000 samples: 1 / sqrt(8000) = 1.1 %, four times that
    assert jitter_of(made) == pytest.approx(0.0005, rel=0.045)
    x = np.arange(SIZE) / SIZE
    made, less = (replace(clean, time=SIZE / RATE * (x + bow * x**2)) for bow in (0.0008, 0.0004))
    (text,) = remarks_on(made, "The clock")
    # the parabola 0.0008 x^2 of 20 s is at most 0.0008 / 4 / 2 * 20 s off the line through it
    assert "changes by 0.16 % from start to end, which is 2 ms off" in text
    assert remarks_on(less, "The clock") == []


@pytest.mark.parametrize(("jitter", "lost"), [(0.0005, 40), (0.001, 40), (0.0015, 0), (0.0015, 40)])
def test_late_samples_are_no_lost_ones(clean, jitter, lost):
    """Jitter of up to 30 % of a period has its size, and no remark on stamps that follow too closely."""
    rng = np.random.default_rng(3)
    kept = np.sort(rng.permutation(SIZE)[lost:])
    time = np.sort((clean.time + rng.normal(0, jitter, SIZE))[kept])
    made = replace(take(clean, kept), time=time)
    texts = remarks_on(made, "The clock")
    assert not any("half a period" in text for text in texts)
    # a median of 4000 sixth differences, which are correlated: four times 1.8 / sqrt(4000)
    assert jitter_of(made) == pytest.approx(jitter, rel=0.12)
    told = [int(text.split()[2]) for text in texts if "missing" in text]
    if jitter < 0.0012:
        # at 20 % one of 25 stamps after a lost sample is so early that the loss is not seen
        assert told == [pytest.approx(lost, abs=4)]
        assert examine(made).rate == pytest.approx(RATE, rel=1e-3)  # a sample or two of 4000
    else:
        assert told == []  # lost samples cannot be told from late ones


def twice(made, rows):
    """A recording in which rows repeat the row before."""
    order = np.arange(SIZE)
    order[rows] -= 1
    return replace(take(made, order), time=made.time)


def test_rows_written_twice(clean):
    """A signal without steps is never equal by chance, so a single row is found."""
    smooth = clean["pressure"] + np.random.default_rng(8).normal(0, 0.01, SIZE)
    fine = replace(clean, signals={**clean.signals, "pressure": smooth}, sensors={})
    assert remarks_on(fine, "The clock") == []
    (text,) = remarks_on(twice(fine, [1900]), "The clock")
    assert text == "The clock: 1 rows repeat the row before, first at 9.5 s."


@table(__file__, "equal_rows", "chance, planted, told")
def test_equal_rows_are_counted_against_chance(chance, planted, told):
    """A step over 2 root pi sd is the probability of two equal samples of a constant."""
    sd = 1 / (2 * np.sqrt(np.pi) * chance)
    values = np.round(np.random.default_rng(0).normal(0, sd, SIZE))
    made = recording(sensors={"x": Sensor(noise=sd, resolution=1.0)}, x=values)
    rows = np.arange(100, SIZE, SIZE // planted)[:planted]
    assert any("repeat" in text for text in remarks_on(twice(made, rows), "The clock")) == told


@pytest.mark.parametrize("sd", [0.02, 0.1, 1.0])
def test_noise_is_estimated_behind_motion(sd):
    """The noise of a signal that oscillates at 5 Hz is estimated from the samples alone."""
    rng = np.random.default_rng(6)
    t = T
    values = 20 * np.sin(2 * np.pi * t) + np.sin(2 * np.pi * 5 * t) + rng.normal(0, sd, SIZE)
    # the sixth difference passes a sine by (2 sin(pi f))^6, and white noise by the root of 924 = 12 over 6
    sine = noise(np.sin(2 * np.pi * np.arange(4001) / 20.37))
    passed = (2 * np.sin(np.pi / 20.37)) ** 6 * np.sqrt(0.5) / (0.67449 * np.sqrt(924))
    assert sine == pytest.approx(passed, rel=1e-3)  # the median of a sine over 200 periods
    # a median of 4000 values of which about one in six is independent: 1.17 / sqrt(4000 / 6) = 4.5 %, twice
    assert noise(values) == pytest.approx(sd, rel=0.09)


def test_step_is_estimated_exactly_and_only_if_there_is_one():
    """Values of a converter, written with four digits, have its step; other values have the step 0."""
    rng = np.random.default_rng(7)
    values = 100 * np.sin(np.arange(SIZE) / 50) + rng.normal(0, 0.3, SIZE)
    written = np.round(rounded(values, 600 / 4096), 4)
    # rounding to 1e-4 over some thousand steps
    assert step(written) == pytest.approx(600 / 4096, rel=1e-5)
    assert step(values) == 0.0
    # eight levels or more, which change in every fiftieth sample or more often
    for count, length, expected in ((8, 1, 1.0), (7, 1, 0.0), (10, 33, 1.0), (10, 66, 0.0)):
        assert step(np.repeat(np.arange(120.0) % count, length)) == pytest.approx(expected)


@table(__file__, "units", "unit, factor, limits")
def test_an_implausible_unit_has_a_remark(clean, unit, factor, limits):
    """A remark on 150 of a quantity that is never that large or small; none on the right unit and on zero."""
    made = replace(clean, units={**clean.units, "pressure": unit}, sensors={})
    texts = remarks_on(plant(made, "pressure", factor * clean["pressure"], slice(None)), "pressure")
    (text,) = [text for text in texts if "is its unit right?" in text]
    assert limits in text
    usual = {"Pa": 1e5, "V": 0.05, "rad": 0.01, "rad/s": 0.01, "m3/s": 1e-5}[unit]
    sd, noise = clean.sensor("pressure").sd, np.random.default_rng(3).normal(size=clean.time.size)
    for values in (usual * clean["pressure"], 0.0 * clean["pressure"], sd * noise):
        made = plant(replace(made, sensors=SENSORS), "pressure", values, slice(None))
        assert not [text for text in remarks_on(made, "pressure") if "unit" in text]


@pytest.mark.parametrize(("unit", "doubt"), [(1000, True), (15, False), (0.003, False), (0.0015, True)])
def test_a_clock_in_milliseconds_has_a_remark(clean, unit, doubt):
    """0.2 Hz of a time in ms declared as s, and 133 kHz; none on 13 Hz and 67 kHz."""
    texts = examine(replace(clean, time=unit * clean.time)).remarks()
    assert any(f"{RATE / unit:.3g} Hz" in text and "unit of time" in text for text in texts) == doubt


@pytest.mark.parametrize(("sd", "doubt"), [(0.005, True), (0.01, False)])
def test_a_signal_that_is_noise_has_no_unit(sd, doubt):
    """0.05 V is less than any command; ten standard deviations of the sensor are no zero, five are."""
    made = recording(sensors={"u": Sensor(noise=sd)}, u=0.05 * np.sin(T))
    texts = examine(replace(made, units={"u": "V"})).remarks()
    assert any("is its unit right?" in text for text in texts) == doubt


def hummed(rate, rms, frequency):
    """A flow with steps, noise of one, and a sine."""
    time = np.arange(0, 20, 1 / rate)
    steps, noise = 50 * np.floor(time / 2), np.random.default_rng(0).standard_normal(time.size)
    values = steps + noise + math.sqrt(2) * rms * np.sin(2 * math.pi * frequency * time)
    about = {"sensors": {"flow": Sensor(noise=1.0)}, "procedure": "valve"}
    return Recording(time, {"flow": values}, {"flow": "1"}, Path("a.csv"), **about)


@pytest.mark.parametrize(("rate", "frequency"), [(100, 44.3), (200, 50), (1000, 150)])
def test_a_hum_is_found_with_its_frequency_and_size(rate, frequency):
    """One as large as the noise, among steps; half as large it hardly changes an interval."""
    p, found, rms = hum(hummed(rate, 1.0, frequency), "flow")
    assert p < 1e-9
    assert found == pytest.approx(frequency, abs=0.4)  # the resolution of an eighth of 20 s
    assert rms == pytest.approx(1.0, rel=0.1)  # noise in the line's five frequencies
    assert hum(hummed(rate, 0.3, frequency), "flow")[0] == 1.0
    ((procedure, finding),) = hum_findings([hummed(rate, 1.0, frequency), hummed(rate, 0.0, 1.0)])
    assert (procedure, finding.fault) == ("valve", "periodic disturbance")


def test_noise_is_no_hum():
    """White and integrated noise, whose size is no reason: p is as small as p in p of the cases."""
    time = np.arange(0, 10, 0.005)
    least = []
    for seed in range(100):
        noise = np.random.default_rng(seed).standard_normal(time.size)
        sensors = {n: Sensor(noise=1e-9) for n in ("a", "b")}
        both = {"a": noise, "b": np.cumsum(noise)}
        recording = Recording(time, both, dict.fromkeys(both, "1"), Path("a.csv"), sensors=sensors)
        least += [hum(recording, name)[0] for name in both]
    assert np.mean(np.array(least) < 0.05) < 0.1  # 0.05 with a standard deviation of 0.015
    assert min(least) > 1e-5
