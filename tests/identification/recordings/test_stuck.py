"""A stuck interval is detected and not used; a signal that may be constant is used."""

from dataclasses import replace

import numpy as np
import pytest
from identification.recordings.conftest import GAUGE, SIZE, T, recording, rounded

from fmus.identification.recordings.masks import good
from fmus.identification.recordings.quality import examine
from fmus.identification.refinement.problem import usable_samples
from orchestrator.data.recording import Sensor


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
    assert "stuck at one value" in remarks(read)


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
    """A stated noise of 100 instead of 0.1: good samples stay good, and a remark reports the value."""
    read = made(replace(GAUGE, noise=100.0), gauge())
    assert good(read, "pressure").all()
    text = remarks(read)
    assert "stuck" not in text
    assert "stated noise of 100, much larger than that of the samples" in text
    small = made(replace(GAUGE, noise=0.001), gauge(1.0))
    assert "stated 0.001" in remarks(small)
    assert good(small, "pressure").all()
    assert "noise" not in remarks(made(GAUGE, gauge()))
