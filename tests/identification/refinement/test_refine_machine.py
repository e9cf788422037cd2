"""Joint refinement of the harvester: its lumped model against its own simulation with the paper's sensors."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from identification.procedures.bench import recorded
from identification.procedures.lumped_machine import ENCODER, PRESSURE
from kit import shards
from kit.mistakes import problem as problem_of

from fmus.identification import machine
from fmus.identification.machine import FREE, nominal, parameter_names, signal_names
from fmus.identification.refinement.compiled_model import CompiledModel
from fmus.identification.refinement.refine import RefinementResult, compiled, refine
from fmus.machine.one_block import HARVESTER
from fmus.operator_input.work_cycle import WORK_CYCLE
from fmus.parameters import values
from orchestrator.data.recording import Recording, Sensor

SIDES = ("swing_{}_a", "swing_{}_b", "boom_head_{}", "boom_rod_{}", "stick_head_{}", "stick_rod_{}")
PRESSURES = tuple(side.format("pressure") for side in SIDES)
ANGLES = ("swing_angle", "boom_angle", "stick_angle")
FLOWS = ("swing_flow_a", "boom_head_flow", "stick_head_flow")
# noise as large as the error of an encoder, which is one and the same in all samples at rest: its root mean
# square over some seconds is anything up to that of half a count
SENSORS = {
    **dict.fromkeys(PRESSURES, PRESSURE),
    **dict.fromkeys(ANGLES, Sensor("encoder", ENCODER.sd)),
    **dict.fromkeys(FLOWS, Sensor("turbine", 5e-6, 1e-2 / 4096, -5e-3, 5e-3, 1.67e-4)),
}


@cache
def machine_recording(seconds: float) -> Recording:
    """The beginning of the work cycle with noise, quantisation and the dead zones of the flow meters."""
    time = np.arange(round(200 * seconds) + 1) / 200
    model = CompiledModel(HARVESTER, tuple(SENSORS), (), tolerance=1e-9)
    usual = values(HARVESTER).u
    inputs = {n: np.full(len(time), usual[n]) for n in model.inputs}
    for move in WORK_CYCLE:
        if move.start < seconds - 4:
            inputs[f"{move.axis}_command"] += move.sample(time)
    columns = np.column_stack([inputs[n] for n in model.inputs])
    start = model.start(model.p0, columns[0])[0]
    y = model.segment(start, model.p0, time, columns, False).y
    names = signal_names()
    true = {names[n]: u for n, u in inputs.items() if n != "tank_pressure"}
    true |= {names[n]: x for n, x in zip(SENSORS, y.T, strict=True)}
    sensors = {names[n]: s for n, s in SENSORS.items()}
    return recorded("machine", time, true, {}, sensors, 0, "machine")


SOME = ("valve_area", "boom_piston_damping", "head_mass", "bulk_modulus")
# the free parameters and the length of the recording; in 18 s all axes move both ways
WHOLE = (FREE, 18.0)


@pytest.fixture(scope="module", params=[(SOME, 8.0), pytest.param(WHOLE, marks=shards.machine)], ids=len)
def refined(request: pytest.FixtureRequest) -> RefinementResult:
    """From 30 % above or below the truth, in turn, without priors."""
    names, seconds = request.param
    task = machine.problem([machine_recording(seconds)], nominal(), names)
    factors = [1.3, 0.7] * len(task.free)
    free = [replace(f, value=f.value * k, sd=None) for f, k in zip(task.free, factors, strict=False)]
    task = replace(task, free=tuple(free))
    return refine(task, compiled(task))


def test_machine_is_found_from_far_away(refined: RefinementResult) -> None:
    """All parameters are estimated within their errors, and the sensors explain the residuals."""
    truth = values(HARVESTER).p
    assert refined.converged
    away = [np.log(refined.values[n] / truth[n]) for n in refined.problem.names]
    # 17 normal numbers exceed 4.5 standard deviations once in ten thousand times
    assert np.max(np.abs(away) / refined.statistics.sd(True)) < 4.5
    assert abs(away[refined.problem.names.index("valve_area")]) < 1e-3
    # root mean square of 15 500 samples or more: four standard deviations
    assert refined.history[-1].residual == pytest.approx(1, abs=4 / np.sqrt(2 * 15500))
    ratio = refined.statistics.sd(True) / refined.statistics.sd(False)
    # for the right model both differ by chance only: of nine segments a standard deviation is known to a
    # quarter, and a jackknife errs to the safe side
    assert 0.6 < np.median(ratio) < 2
    assert refined.unidentified == ()


def test_estimates_are_called_as_parameter_files_call_them(refined: RefinementResult) -> None:
    """Names contain the component only if components differ; intervals contain the values."""
    found = {e.name: e for e in refined.estimates()}
    assert {"valve_area", "boom_piston_damping", "head_mass"} <= set(found)
    assert parameter_names()["swing_initial_preload"] == "swing.initial_preload"
    assert all(e.low < e.value < e.high and e.sd > 0 for e in found.values())
    assert found["valve_area"].unit == "m2"
    assert f"{len(found)} parameters on 1 recording" in found["valve_area"].number().note
    assert len(found) in (len(SOME), 17)


# ---- incomplete recordings, and what was known before

COMMANDS = ("swing_command", "boom_command", "stick_command")


def still(*outputs: str, use: str = "train") -> Recording:
    """One second without motion, measured by sensors of some outputs."""
    names = signal_names()
    true = {names[n]: np.zeros(200) for n in COMMANDS} | {names[n]: np.full(200, 1e6) for n in outputs}
    sensors = {names[n]: Sensor("transducer", 1e4) for n in outputs}
    return replace(recorded(use, np.arange(200) / 200, true, {}, sensors, 0, "machine"), use=use)


def test_a_signal_may_be_missing_in_one_of_the_recordings() -> None:
    """An output is fitted in the recordings that contain it; elsewhere it has no weight and no error."""
    full, less = still("swing_pressure_a", "boom_head_pressure"), still("swing_pressure_a", use="test")
    task = machine.problem([full, less], nominal())
    assert task.outputs == ("swing_pressure_a", "boom_head_pressure")
    assert task.training[0].weight.all()
    assert task.held_out[0].weight.any(axis=0).tolist() == [True, False]
    assert task.held_out[0].compared.any(axis=0).tolist() == [True, False]


def test_what_the_machine_knows_before() -> None:
    """A tenth to ten times a value, 30 % if not measured; half of a declared zero; lines smoothed: 20 s."""
    time, name = np.arange(6000) / 200, signal_names()["supply_pressure"]
    read = still("swing_pressure_a")
    supply = 2e7 + 1e4 * np.random.default_rng(0).standard_normal(6000)
    signals = {n: np.resize(s, 6000) for n, s in read.signals.items()} | {name: supply}
    sensors = {n: replace(s, zero_error=1e5) for n, s in read.sensors.items()} | {name: Sensor(noise=1e4)}
    read = replace(read, time=time, signals=signals, sensors=sensors, units={**read.units, name: "Pa"})
    task = machine.problem([read], nominal(), ["head_mass"])
    mass, zero = task.free
    known = nominal()["manipulator.head_mass"]
    assert (mass.sd, mass.high) == pytest.approx((known.sd or 0.3 * known.value, 10 * known.value))
    assert mass.low == pytest.approx(known.value / 10)
    assert (zero.value, zero.sd, zero.low, zero.high) == (0.0, 1e5 / 3**0.5, -1e5, 1e5)
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
