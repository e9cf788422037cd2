"""Incomplete recordings: they begin in motion, lack a signal, or contain too little information."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from identification.refinement.oscillator import TRUTH, problem, recording, run
from kit.mistakes import problem as problem_of

from fmus.identification import machine
from fmus.identification.machine import nominal, signal_names
from fmus.identification.recordings.reading import window
from fmus.identification.refinement.refine import refine
from orchestrator.data.recording import Recording, Sensor

COMMANDS = ("swing_command", "boom_command", "stick_command")


def still(*outputs: str, use: str = "train") -> Recording:
    """One second without motion, measured by sensors of some outputs."""
    names, noise = signal_names(), np.random.default_rng(0)
    read = {names[n]: np.zeros(200) for n in COMMANDS}
    read |= {names[n]: 1e6 + 1e4 * noise.standard_normal(200) for n in outputs}
    sensors = {names[n]: Sensor("transducer", 1e4) for n in outputs}
    time = np.arange(200) / 200
    return Recording(Path(f"{use}.csv"), time, read, {}, procedure="machine", use=use, sensors=sensors)


def test_a_recording_may_begin_in_motion() -> None:
    """An initial speed that is not zero is not forced to zero, and the parameters stay right."""
    moving = run(window(recording(), 2.5, 12.0))
    found = refine(problem(moving))
    assert (run(recording()).at_rest, moving.at_rest) == (("speed",), ())
    assert found.converged
    truth = np.log([TRUTH[name] for name in found.problem.names])
    away = found.z - truth
    # chi square with three degrees of freedom stays below 21 with 99.99 %
    assert away @ np.linalg.solve(found.statistics.covariance, away) < 21
    held = refine(problem(replace(moving, at_rest=("speed",))))
    away = held.z - truth
    assert away @ np.linalg.solve(held.statistics.covariance, away) > 21


def test_a_signal_may_be_missing_in_one_of_the_recordings() -> None:
    """An output is fitted in the recordings that contain it; elsewhere it has no weight and no error."""
    full, less = still("swing_pressure_a", "boom_head_pressure"), still("swing_pressure_a", use="test")
    task = machine.problem([full, less], nominal())
    assert task.outputs == ("swing_pressure_a", "boom_head_pressure")
    assert task.training[0].weight.all()
    assert task.held_out[0].weight.any(axis=0).tolist() == [True, False]
    assert task.held_out[0].compared.any(axis=0).tolist() == [True, False]


def test_what_the_machine_knows_before() -> None:
    """Values within a factor of ten, 30 % without a measurement; zeros within half of what is declared; the
    pressures of the lines smoothed over 20 s."""
    time, name = np.arange(6000) / 200, signal_names()["supply_pressure"]
    read = still("swing_pressure_a")
    supply = 2e7 + 1e4 * np.random.default_rng(0).standard_normal(6000)
    signals = {n: np.resize(s, 6000) for n, s in read.signals.items()} | {name: supply}
    sensors = {n: replace(s, zero_error=1e5) for n, s in read.sensors.items()} | {name: Sensor(noise=1e4)}
    units = {**read.units, name: "Pa"}
    task = machine.problem(
        [replace(read, time=time, signals=signals, sensors=sensors, units=units)], nominal(), ["head_mass"]
    )
    mass, zero = task.free
    known = nominal()["manipulator.head_mass"]
    assert (mass.sd, mass.high) == pytest.approx((known.sd or 0.3 * known.value, 10 * known.value))
    assert mass.low == pytest.approx(known.value / 10)
    assert (zero.value, zero.sd, zero.low, zero.high) == (0.0, 5e4, -1e5, 1e5)
    assert task.training[0].input_noise["supply_pressure"] == (1e4, 3999)


def test_insufficient_recordings_are_refused() -> None:
    """No measured output, no training recording, a drive that would be simulated at rest: one line each."""
    read, held_out = (still("swing_pressure_a", use=use) for use in ("train", "test"))
    less = {n: s for n, s in read.signals.items() if n != signal_names()["boom_command"]}
    for wrong, message in (
        (still(), "train.csv: measured signals: expected one of swing.swing_pressure_a, "),
        (held_out, "expected a recording of the machine to train with"),
        (replace(read, signals=less), "expected the signal boom_stick.boom_command"),
    ):
        assert message in problem_of(lambda wrong=wrong: machine.problem([wrong], nominal()))
