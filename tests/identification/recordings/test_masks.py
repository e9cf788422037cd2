"""Masks of good samples, intervals with a constant command, and averages over them."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
import scipy.signal
from hypothesis import given
from hypothesis import strategies as st
from identification.recordings.conftest import GAUGE, SIZE, T, recording, rounded
from kit.mistakes import problem

from fmus.identification.recordings.masks import averages, faults, good, good_all, standard_error, steady
from fmus.identification.recordings.quality import examine
from fmus.identification.recordings.reading import add, split, take
from fmus.identification.refinement.problem import usable_samples
from orchestrator.data.recording import Sensor


def test_good_samples_are_there_in_range_and_out_of_the_dead_zone():
    """Each reason against a sample is enough to exclude it."""
    values = [np.nan, -20.0, 20.0, 5.0, -5.0, 0.0, 5.1, 12.0]
    made = recording(q=values, u=np.arange(8.0), sensors={"q": Sensor(low=-20, high=20, dead_zone=5)})
    expected = [False, False, False, False, False, False, True, True]
    assert good(made, "q").tolist() == expected
    assert good(made, "u").all()
    assert good_all(made, ["q", "u"]).tolist() == expected


@given(
    lengths=st.lists(st.integers(1, 60), min_size=1, max_size=8),
    settle=st.integers(0, 20),
    shortest=st.integers(0, 20),
)
def test_steady_stretches_are_those_of_the_steps(lengths, settle, shortest):
    """The intervals of a stepped command are its steps without settling time; short ones are left out."""
    levels = np.arange(len(lengths)) % 3 * 1.5
    starts = np.concatenate(([0], np.cumsum(lengths))).tolist()
    expected = [
        slice(start + settle, stop)
        for start, stop in pairwise(starts)
        if stop - start > settle and stop - 1 - start - settle >= shortest
    ]
    assert steady(recording(u=np.repeat(levels, lengths)), "u", settle / 200, shortest / 200) == expected


def test_steady_stretches_of_a_measured_command():
    """Sensor noise does not end an interval; a slow ramp and a gap do."""
    rng = np.random.default_rng(1)
    u = np.concatenate([np.zeros(200), np.linspace(0, 2, 200), np.full(200, 2.0)]) + rng.normal(0, 0.005, 600)
    u[500] = np.nan
    made = recording(u=u, sensors={"u": Sensor(noise=0.01)})
    edges = [(part.start, part.stop) for part in steady(made, "u", shortest=0.25)]
    # the ramp rises by 0.01 per sample, the tolerance is 0.04: some samples of it belong to the stretches
    assert len(edges) == 3
    assert edges[0] == (0, pytest.approx(200, abs=12))
    assert edges[1] == (pytest.approx(400, abs=12), 500)
    assert edges[2] == (501, 600)


def test_averages_of_good_samples_over_stretches():
    """Means use the good samples; with too few of them there is no mean."""
    values = np.concatenate([np.full(100, 1.0), np.full(100, 3.0)])
    values[:30], values[100:160] = np.nan, 900.0
    made = recording(x=values, sensors={"x": Sensor(high=900.0)})
    mean, error = averages(made, ["x"], [slice(0, 100), slice(100, 200), slice(180, 200)])
    assert mean[0].tolist() == pytest.approx([1.0, np.nan, 3.0], nan_ok=True)
    assert error[0].tolist() == pytest.approx([0.0, np.nan, 0.0], nan_ok=True)


@pytest.mark.parametrize("memory", [0.0, 0.9, -0.5])
def test_standard_error_counts_correlated_samples_for_what_they_are_worth(memory):
    """The standard error is the scatter of means over many runs of a first-order process."""
    rng = np.random.default_rng(2)
    pushes = rng.normal(size=(400, 1200))
    x = scipy.signal.lfilter([1.0], [1.0, -memory], pushes, axis=1)[:, 200:]
    stated = np.sqrt(np.mean([standard_error(run) ** 2 for run in x]))
    # scatter of 400 means: 1 / sqrt(800) = 3.5 %; the sum over a finite run loses a few per cent: 12 %
    assert stated == pytest.approx(x.mean(axis=1).std(), rel=0.12)


def test_standard_error_of_a_reading_that_does_not_leave_its_step():
    """The quantisation error remains if the noise does not reach the next step."""
    assert standard_error(np.full(100, 3.0), 0.1) == pytest.approx(0.1 / np.sqrt(12))
    assert standard_error(np.full(100, 3.0)) == 0.0


def test_parts_of_a_recording_keep_everything_else():
    """Splitting keeps all samples and instruments; an added signal has its unit."""
    sensor = Sensor(noise=1.0)
    made = recording(x=np.arange(100.0), sensors={"x": sensor})
    first, second = split(made, 0.2)
    assert (len(first.time), second.time[0], second["x"][0]) == (40, 0.2, 40.0)
    assert second.sensor("x") == sensor
    assert second.conditions == made.conditions
    assert made.window(0.1, 0.11).sensor("x") == sensor
    assert take(made, made["x"] > 97)["x"].tolist() == [98.0, 99.0]
    more = add(made, "v", np.zeros(100), "m/s")
    assert (more.units["v"], more.sensor("v"), more.sensor("x")) == ("m/s", Sensor(), sensor)
    assert add(made, "x", np.zeros(100), "m").sensor("x") == Sensor()
    problem(lambda: split(made, 3), r"expected samples before and from 3 s, got 0 s to 0\.495 s")
    problem(lambda: add(made, "v", np.zeros(3), "m/s"), r"signal v: expected shape \(100,\), got \(3,\)")


# ---- stuck


def made(sensor, values, name="pressure"):
    return replace(recording(sensors={name: sensor}, **{name: values}), procedure="machine")


def gauge(noise=0.1):
    rng = np.random.default_rng(1)
    return rounded(150 + 80 * np.sin(1.3 * T) + rng.normal(0, noise, SIZE), GAUGE.resolution)


def remarks(read):
    return " ".join(text for text in examine(read).remarks() if not text.startswith("The clock"))


@pytest.mark.parametrize("stop", [1100, 3800])
def test_stuck_samples_are_not_used(stop):
    """Samples of a gauge that is stuck for half a second, or for most of the recording, are not used."""
    values = gauge()
    values[1000:stop] = values[1000]
    read = made(GAUGE, values)
    used = good(read, "pressure")
    assert not used[1000:stop].any()
    # a neighbour may be equal by chance
    assert used[:990].all()
    assert used[stop + 10 :].all()
    # the refinement leaves ten samples about it out, too
    usable = usable_samples(read, "pressure")
    assert not usable[990 : stop + 10].any()
    assert usable[:980].all()
    told = remarks(read)
    assert told.count("pressure: ") == 1
    assert "stuck at one value" in told
    assert "first at 5 s" in told


@pytest.mark.parametrize(("size", "longest"), [(900, 3), (1050, 4)])
def test_a_run_is_stuck_if_chance_makes_one_in_a_thousand_recordings(size, longest):
    """Equal samples have a chance of 1 / 1000 at least: k of them, somewhere among n, n / 1000^k."""
    values = np.random.default_rng(0).normal(size=size)
    values[[10, 20]] = 9.0, -9.0
    for run in (longest, longest + 1):
        values[300 : 300 + run] = values[300]
        assert faults(recording(x=values), "x")["stuck"].sum() == run * (run > longest)


ROW = np.arange(SIZE)
SLOWER = {"all": ROW >= 0, "half": ROW % 2 == 0, "two thirds": ROW % 3 > 0, "fifth": ROW % 5 == 2}


@pytest.mark.parametrize("logged", SLOWER.values(), ids=SLOWER)
@pytest.mark.parametrize("sensor", [Sensor(), GAUGE], ids=["unknown", "known"])
def test_gaps_of_a_slower_group_do_not_hide_faults(logged, sensor):
    """Stuck and clipped samples are found as at the full rate of the logger."""
    stuck, top = (ROW >= 1000) & (ROW < 1300), 227.5
    values = np.where(stuck, 1500 * GAUGE.resolution, np.minimum(gauge(), top))
    found = faults(made(sensor, np.where(logged, values, np.nan)), "pressure")
    assert not (found["stuck"] ^ (logged & stuck)).any()
    # short runs at the limit, where the noise crosses it, may be chance
    limited = logged & (values == top)
    assert found["clipped"][~limited].sum() == 0
    assert found["clipped"].sum() > 0.8 * limited.sum() > 30


@pytest.mark.parametrize("logged", SLOWER.values(), ids=SLOWER)
@pytest.mark.parametrize("amplitude", [11.0, 100.0])
def test_an_undeclared_dead_zone_is_named(logged, amplitude):
    """The zeros are not used, also if they are most of the samples; the remark names the key."""
    rng = np.random.default_rng(3)
    flow = amplitude * np.sin(0.5 * T) + rng.normal(0, 0.3, SIZE)
    flow = np.where(logged, np.where(np.abs(flow) < 10, 0, np.round(flow, 2)), np.nan)
    meter = made(Sensor(), flow, "flow")
    np.testing.assert_array_equal(good(meter, "flow"), np.nan_to_num(flow) != 0)
    assert "flow: reads 0 or at least 10" in remarks(meter)
    assert "dead_zone" in remarks(meter)
    assert "clipped" not in remarks(meter) + remarks(made(Sensor(low=0.0), np.abs(flow), "flow"))
    smooth = made(Sensor(), np.where(logged, np.maximum(np.sin(T), 0), np.nan), "flow")
    assert "dead_zone" not in remarks(smooth)


@pytest.mark.parametrize(("noise", "named"), [(1e-7, False), (1e-5, True)])
def test_the_exact_zeros_of_a_computation_are_no_dead_zone(noise, named):
    """Its noise is below a millionth of the range; that of the finest converters is above."""
    exact = np.where(
        T < 5, 0.0, 1 + np.sin(T) ** 2 / 2 + noise * np.random.default_rng(4).standard_normal(SIZE)
    )
    assert ("dead_zone" in remarks(made(Sensor(noise=0.01), exact, "flow"))) == named


@pytest.mark.parametrize("noise", [0.0, 0.02, 20.0])
def test_an_encoder_at_rest_is_used(noise):
    """An encoder at rest for most of the time is not stuck, whatever noise is stated."""
    step = 0.044
    moving = np.clip(T - 5, 0, 4) * 20
    quiet = np.random.default_rng(2).normal(0, 0.005, SIZE)
    read = made(Sensor(noise=noise, resolution=step), rounded(moving + quiet, step), "angle")
    assert good(read, "angle").all()
    assert "stuck" not in remarks(read)


def test_commands_dead_zones_and_smooth_signals_may_stand_still():
    """Held commands, a meter in its dead zone, and a simulated angle at rest are not stuck."""
    command = made(Sensor(), np.where(T < 10, 5 * np.sin(T), 5.0), "swing.swing_command")
    assert good(command, "swing.swing_command").all()
    rng = np.random.default_rng(3)
    flow = 100 * np.sin(0.5 * T) + rng.normal(0, 0.3, SIZE)
    flow[np.abs(flow) < 10] = 0.0
    meter = made(Sensor(noise=0.3, dead_zone=10.0), flow, "flow")
    assert np.array_equal(good(meter, "flow"), flow != 0)
    assert "stuck" not in remarks(meter)
    read = made(Sensor(), np.where(T < 10, np.sin(T), np.sin(10.0)), "angle")
    assert good(read, "angle").all()


def test_overstated_noise_has_a_remark():
    """A stated noise of 0.5 instead of 0.1: good samples stay good, and a remark reports the value."""
    read = made(replace(GAUGE, noise=0.5), gauge())
    assert good(read, "pressure").all()
    text = remarks(read)
    assert "stuck" not in text
    assert "stated noise of 0.5, much larger than that of the samples" in text
    assert "noise" not in remarks(made(replace(GAUGE, noise=0.25), gauge()))  # 2.2 times as large
    small = made(replace(GAUGE, noise=0.001), gauge(1.0))
    assert "stated 0.001" in remarks(small)
    assert good(small, "pressure").all()
    assert "noise" not in remarks(made(GAUGE, gauge()))
