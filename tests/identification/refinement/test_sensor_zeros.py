"""Zeros of sensors in the joint refinement: found, bounded by what the sensor declares, and subtracted."""

from dataclasses import replace

import numpy as np
import pytest
from identification.procedures.bench import changed, with_sensors
from identification.refinement.oscillator import NUMBERS, OSCILLATOR, recording, run
from identification.refinement.oscillator import problem as oscillator_problem
from identification.refinement.test_refine_machine import SOME, WHOLE, machine_recording
from kit import shards

from fmus.identification import machine
from fmus.identification.machine import nominal
from fmus.identification.refinement.compiled_model import zero_of
from fmus.identification.refinement.problem import FreeParameter, RecordingMap
from fmus.identification.refinement.refine import compiled, refine

BOOM = "manipulator.boom_angle"
OFF, DECLARED = np.radians(2.0), np.radians(3.0)


@pytest.mark.parametrize(
    ("names", "seconds", "least"),
    # of 17 intervals at 95 % at most 2 miss the truth in 95 of 100 sets of recordings, of 4 at most 1
    [(SOME, 8.0, 3), pytest.param(*WHOLE, 15, marks=shards.machine)],
    ids=["some", "all"],
)
def test_a_boom_encoder_two_degrees_off_leaves_the_truths_in_their_intervals(names, seconds, least) -> None:
    """All encoders declare 3 degrees: the boom's zero is found, the swing's, which nothing tells, is open."""
    clean = machine_recording(seconds)
    moved = changed(clean, {BOOM: clean[BOOM] + OFF})
    read = with_sensors(moved, "manipulator.", zero_error=DECLARED)  # of the angles
    task = machine.problem([read], nominal(), names)
    away = [
        f if f.name.startswith("zero_") else replace(f, value=f.value * k, sd=0.3 * f.value)
        for f, k in zip(task.free, [1.2, 0.85] * len(task.free), strict=False)
    ]
    task = replace(task, free=tuple(away))
    found = refine(task, compiled(task))
    assert found.converged
    estimates = machine.estimates(found)
    known = nominal()
    truth = {e.name: machine.lookup(e.name, known).value for e in estimates}
    assert len(estimates) in (len(SOME), 17)
    assert sum(e.low <= truth[e.name] <= e.high for e in estimates) >= least
    zeros = machine.zeros(found)
    assert zeros[BOOM].low <= OFF <= zeros[BOOM].high
    assert zeros[BOOM].high - zeros[BOOM].low < np.radians(0.1)
    # as declared: 1.96 standard deviations of half of it, or its bound if residuals widen the interval
    assert 0.979 * DECLARED < zeros["manipulator.swing_angle"].high <= DECLARED * (1 + 1e-9)
    assert any(s.startswith(f"zero of the sensor of {BOOM}: 2") for s in machine.sensor_sentences(found))
    (corrected,) = machine.corrected([read], found)
    # the interval of the zero
    np.testing.assert_allclose(corrected[BOOM], clean[BOOM], atol=np.radians(0.05))


def _with_zero(error: float, off: float):
    """The oscillator's problem with a position sensor that is `off`, and one more run held out."""
    base = oscillator_problem(run(recording()))
    mapping = RecordingMap(OSCILLATOR, base.outputs, values=NUMBERS)

    def shifted(seed: int):
        read = recording(seed)
        return mapping.run(changed(read, {"position": read["position"] + off}))

    zero = FreeParameter(zero_of("position"), 0.0, "m", error / 2, -error, error, scale=error)
    return replace(base, free=(*base.free, zero), training=(shifted(0),), held_out=(shifted(7),))


def test_a_zero_stays_within_what_its_sensor_declares() -> None:
    """A sensor ten times as far off as it declares: the zero stays within, the residual tells the rest."""
    found = refine(_with_zero(error=0.05, off=0.5))
    zero = next(e for e in found.estimates() if e.name == zero_of("position"))
    assert -0.05 <= zero.low <= zero.high <= 0.05
    # 0.45 m of 0.5 are left, 20 times the noise; the spring takes a part
    assert found.whiteness["position"].rms > 5


def test_a_held_out_run_begins_at_the_corrected_position() -> None:
    """With the zero found, the free simulation of the held-out run leaves the noise of the sensor only."""
    task = _with_zero(error=0.2, off=0.1)
    found = refine(task)
    zero = next(e for e in found.estimates() if e.name == zero_of("position"))
    assert zero.low <= 0.1 <= zero.high
    error = found.held_out[0].error[:, 0]
    # noise of the sensor, and that of the first sample, from which the run begins
    assert np.sqrt(np.nanmean(error**2)) < 2 / found.problem.held_out[0].weight.max()
