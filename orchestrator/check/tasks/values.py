"""Tasks on the outputs after initialisation and on the default experiment."""

import math
from collections.abc import Iterator

import numpy as np

from orchestrator.check.tasks.runner import OnlyOnce, Remark, Trial
from orchestrator.check.tasks.trial_run import (
    Rows,
    Simulation,
    Vector,
    inner_step,
    not_finite,
    numeric,
    usual_step,
)
from orchestrator.fmi.instance import CallFailed
from orchestrator.fmi.messages import FATAL


def first_output(trial: Trial) -> Iterator[Remark]:
    """Outputs are correct right after initialisation, also those that depend on inputs."""
    simulation = Simulation(trial).begin()
    yield from _start_values(simulation)
    before = simulation.row()
    if simulation.inputs.names:
        simulation.inputs.set(simulation.initial_inputs)
        yield from _reevaluated(simulation, before, "inputs keep their start values")
    if trial.perturbable:
        try:
            yield from _inputs_in_initialisation(trial)
        except CallFailed as failure:
            yield "warning", f"with inputs changed in initialisation mode: {failure}"
    if trial.kind == "CoSimulation" and trial.interface.declares("canHandleVariableCommunicationStepSize"):
        yield from _tiny_step(trial, before)


def _reevaluated(simulation: Simulation, before: Vector, case: str) -> Iterator[Remark]:
    """Outputs do not change after the inputs were set to the values that they have."""
    after = simulation.row()
    outputs = simulation.outputs
    for name, a, b, scale in zip(outputs.names, before, after, outputs.scale, strict=True):
        if abs(a - b) > 1e-9 * max(abs(a), abs(b), 1e-6 * scale):
            text = f"{name} is {a:.9g} after initialisation and {b:.9g} after the inputs are set again to the"
            yield "error", f"{text} same values ({case}): the output is not evaluated at initialisation"
            return


def _inputs_in_initialisation(trial: Trial) -> Iterator[Remark]:
    """Outputs are correct after inputs were set in initialisation mode."""
    simulation = Simulation(trial)
    simulation.instance.setup(simulation.start)
    simulation.instance.enter()
    simulation.initial_inputs = simulation.inputs.get()
    simulation.perturb(0)
    inputs = simulation.inputs.get()
    simulation.leave()
    simulation.begin_steps()
    before = simulation.row()
    if simulation.inputs.names:
        simulation.inputs.set(inputs)
        yield from _reevaluated(simulation, before, "inputs were set in initialisation mode")


def _tiny_step(trial: Trial, first: Vector) -> Iterator[Remark]:
    """An output that is exactly 0, jumps in a tiny step and then hardly changes was not evaluated."""
    simulation = Simulation(trial, step=1e-6 * usual_step(trial.description)).begin()
    rows = simulation.run(2)
    if len(rows) < 2:
        return
    outputs = simulation.outputs
    for v, name, a, b, c in zip(outputs.elements, outputs.names, first, *rows, strict=True):
        if v.is_continuous and a == 0.0 and abs(b) > 1e-3 * v.magnitude and abs(c - b) < 0.1 * abs(b):
            text = f"{name} is 0 after initialisation and {b:.6g} after a step of {simulation.step:.3g} s"
            yield "warning", f"{text}: the output is not evaluated at initialisation"


def _start_values(simulation: Simulation) -> Iterator[Remark]:
    """Parameters and inputs have the start values of modelDescription.xml."""
    variables = [v for v in numeric(simulation.trial.description, "parameter", "input") if v.start_values]
    values = simulation.values(variables)
    given = [(v.start_values, v.size) for v in variables]
    starts = [x for start, size in given for x in (start if len(start) == size else start[:1] * size)]
    for name, x, start in zip(values.names, values.get(), starts, strict=True):
        # single precision has seven digits
        if abs(x - start) > 1e-6 * max(abs(x), abs(start)) or math.isnan(x) != math.isnan(start):
            text = f"{name} starts at {start:.9g} in modelDescription.xml and at {x:.9g} in the binary"
            yield "error", text
            return


HUGE = 1e30  # relative to nominal; a larger output means that the model diverges
MAX_STEPS = 20_000  # if the default experiment has no stop time


def default(trial: Trial) -> Iterator[Remark]:
    """The default experiment runs with finite values; the result has the options for the other tasks."""
    start = trial.description.experiment.number("startTime") or 0.0
    stop = trial.description.experiment.number("stopTime")
    duration = math.inf if stop is None else stop - start
    steps = int(duration / usual_step(trial.description) + 1e-9) if math.isfinite(duration) else MAX_STEPS
    simulation, initial, rows = _run(trial, stop if steps else None, max(steps, 1))
    if problem := not_finite(simulation.outputs.names, [initial]):
        yield "error", f"after initialisation {problem}"
    yield from _invalid_outputs(simulation, rows)
    sampled = simulation.events.sampled if simulation.events else {}
    if problem := not_finite([*sampled], [np.array([*sampled.values()])]):
        yield "error", f"at the latest tick of its clock {problem}"
    yield from _last_time(simulation)
    simulation.close()
    trial.summed = simulation.summed
    trial.result = {"perturbable": _perturbable(trial), "summed": simulation.summed}


def _run(trial: Trial, stop: float | None, steps: int) -> tuple[Simulation, Vector, Rows]:
    """The run, its row after initialisation, and its rows after the steps.

    If the FMU rejects communication points start + n h, the run is repeated with summed points.
    """
    simulation = Simulation(trial, stop=stop).begin()
    initial = simulation.row()
    try:
        return simulation, initial, simulation.run(steps, seconds=trial.seconds)
    except CallFailed as failure:
        if failure.status == FATAL or trial.kind == "ModelExchange":
            raise
        try:
            summed = Simulation(trial, stop=stop, summed=True).begin()
            return summed, initial, summed.run(steps, seconds=trial.seconds)
        except (CallFailed, OnlyOnce):
            raise failure from None


def _invalid_outputs(simulation: Simulation, rows: Rows) -> Iterator[Remark]:
    """The first step after which an output is not finite, or huge."""
    names, limits = simulation.outputs.names, HUGE * simulation.outputs.nominal
    for n, row in enumerate(rows, 1):
        huge = np.flatnonzero(~np.isfinite(row) | (np.abs(row) > limits))
        if not len(huge):
            continue
        time = simulation.start + n * simulation.step
        when = f"at t = {time:.9g} s with default values, although the status is OK"
        if problem := not_finite(names, [row]):
            yield "error", f"{problem} {when}"
            return
        yield "warning", f"{names[huge[0]]} has grown to {row[huge[0]]:.3g} {when}"
        return


def _last_time(simulation: Simulation) -> Iterator[Remark]:
    """The last successful time that the FMU reports is less than a step from the end of the last step."""
    instance, expected = simulation.instance, simulation.time
    if simulation.integrator is not None or (simulation.ended and instance.fmi == 3):
        return
    reached = simulation.reached
    lag = max(simulation.step, inner_step(simulation.trial.description))
    if not abs(reached - expected) <= lag * 1.001:
        yield "error", f"the last successful time is {reached:.9g} s, expected {expected:.9g} s"


def _perturbable(trial: Trial) -> bool:
    """The FMU accepts small changes of its inputs, and its outputs stay finite."""
    try:
        simulation = Simulation(trial).begin()
        rows = simulation.run(10, perturb=True)
        simulation.close()
    except (CallFailed, OnlyOnce):
        return False
    return not not_finite(simulation.outputs.names, rows)
