"""Delays of inputs in the joint refinement: found from early time stamps, bounded, and taken out."""

from dataclasses import replace

import numpy as np
import pytest
from identification.procedures.bench import changed
from identification.refinement.oscillator import FREE, TRUTH, problem, recording, run
from identification.refinement.test_refine_machine import SOME, machine_recording
from kit.mistakes import problem as problem_of
from kit.mistakes import table

from fmus.identification import machine
from fmus.identification.machine import COMMANDS, nominal
from fmus.identification.pipeline import check_names
from fmus.identification.refinement.compiled_model import CompiledModel, delay_of, delayed_inputs
from fmus.identification.refinement.problem import FreeParameter
from fmus.identification.refinement.refine import compiled, refine
from orchestrator.data.recording import Recording, Sensor

RATE = 50  # Hz, of the oscillator's recordings
MOST = 0.2  # s


def logged_early(read: Recording, rows: dict[str, int]) -> Recording:
    """The log in which some inputs have the time of their request, so many rows before they act."""
    return changed(read, {n: np.append(read[n][k:], np.full(k, read[n][-1])) for n, k in rows.items()})


def with_delay(*rows: int, most: float = MOST):
    """The oscillator's problem with recordings whose input was logged so many rows early."""
    runs = [run(logged_early(recording(seed), {"push": k})) for seed, k in enumerate(rows)]
    base = problem(*runs)
    free = FreeParameter(delay_of("push"), 0.0, "s", most / 3**0.5, -most, most, scale=most)
    return replace(base, free=(*base.free, free), held_out=(base.training[0],))


@pytest.mark.parametrize("rows", [0, 1, 5])
def test_a_delay_and_the_parameters_are_found_together(rows: int) -> None:
    """Of 0 to 100 ms at 50 Hz; without it the fit is off by far more than its interval."""
    task = with_delay(rows)
    found = refine(task)
    truth = [*(np.log(TRUTH[name]) for name in FREE), rows / RATE / MOST]
    # four normal numbers exceed 4.5 standard deviations once in 40 000 times
    assert np.max(np.abs(found.z - truth) / found.statistics.sd(False)) < 4.5
    assert found.converged
    # 601 samples: three standard deviations of a root mean square
    assert found.history[-1].residual == pytest.approx(1, abs=3 / np.sqrt(2 * 601))
    error = found.held_out[0].error[:, 0] * task.training[0].weight.max()
    # noise of the sensor, and that of the first samples, from which the run begins
    assert np.sqrt(np.nanmean(error**2)) < 1.5
    without = refine(problem(*task.training))
    assert (without.history[-1].residual > 3) == (rows == 5)


def test_a_delay_stays_within_what_is_declared() -> None:
    """An input 100 ms late that declares 20 ms: the delay is at its bound, which is reported."""
    found = refine(with_delay(5, most=0.02))
    assert found.values[delay_of("push")] == pytest.approx(0.02)
    assert found.at_bound == (delay_of("push"),)


def test_sensitivities_by_a_delay_are_those_of_the_simulation() -> None:
    """Of outputs and of the last state, over a part of the run."""
    task = with_delay(0)
    model, read = compiled(task, 1e-9), task.training[0]
    assert isinstance(model, CompiledModel)
    u, part = read.input_matrix(model.inputs), slice(100, 200)

    def segment(delay: float):
        p = np.array([*(TRUTH[name] for name in FREE), delay])
        inputs = delayed_inputs(model, p, read.time, u)[..., part, :]
        return model.segment(np.array([0.1, 0.2]), p, read.time[part], inputs)

    early, late, middle = (segment(0.05 + d) for d in (-2e-3, 2e-3, 0.0))
    by_delay, end_by_delay = (late.y - early.y) / 4e-3, (late.x - early.x) / 4e-3
    # a forward quotient over 1 ms: half of that times the second derivative, 12 / s2 times the amplitude, and
    # the corners that an interpolated step passes
    np.testing.assert_allclose(middle.y_p[..., -1], by_delay, atol=0.05 * np.abs(by_delay).max())
    np.testing.assert_allclose(middle.x_p[:, -1], end_by_delay, atol=0.05 * np.abs(end_by_delay).max())


def test_the_delays_of_all_commands_are_found_and_taken_out() -> None:
    """Each by itself, 20 to 100 ms at 200 Hz; named by a test, not if there is none; commands are moved."""
    names = [*COMMANDS.values()]
    rows = dict(zip(names, (4, 0, 20), strict=True))
    clean = machine_recording(8.0)
    early = logged_early(clean, rows)
    declared = {n: replace(early.sensor(n), delay_error=MOST) for n in names}
    read = replace(early, sensors={**early.sensors, **declared})
    task = machine.problem([read], nominal(), SOME)
    assert [f.name for f in task.free[-3:]] == [delay_of(n) for n in COMMANDS]
    assert [(f.value, f.sd, f.low, f.high) for f in task.free[-3:]] == [(0.0, MOST / 3**0.5, -MOST, MOST)] * 3
    found = refine(task, compiled(task))
    assert found.converged
    delays = machine.delays(found)
    assert list(delays) == names
    for name, estimate in delays.items():
        # 4.5 standard deviations; a lever that does not move in these seconds tells less
        assert abs(estimate.value - rows[name] / 200) < 4.5 * estimate.sd
        assert estimate.sd < 1e-3
    assert {e.name for e in machine.estimates(found)} == set(SOME)
    told = {f.sentence.split()[0]: f.p for f in machine.findings(found) if f.fault == "time shift"}
    # half a sample is no fault
    assert {name: p < 1e-6 for name, p in told.items()} == {name: k > 0 for name, k in rows.items()}
    assert sum(s.startswith("delay of ") for s in machine.sensor_sentences(found)) == 3
    (moved,) = machine.corrected([read], found)
    for name in names:
        # linear between samples at a hundredth of a period
        np.testing.assert_allclose(moved[name][50:], clean[name][50:], atol=0.01)


@table(__file__, "declared", "procedure, signal, unit, refused")
def test_a_delay_is_declared_at_what_drives_the_machine(procedure, signal, unit, refused) -> None:
    """At an output, or on a bench, one line names the signal."""
    time, sensors = np.arange(3.0), {signal: Sensor(delay_error=0.1)}
    read = Recording(time, {signal: time}, {signal: unit}, procedure=procedure, sensors=sensors)
    signals = {"valve": {"command": "V"}}
    if refused:
        told = problem_of(lambda: check_names([read], signals))
        assert told.startswith(f"recording: signal {signal}: delay_error: only that of a command or ")
    else:
        check_names([read], signals)
