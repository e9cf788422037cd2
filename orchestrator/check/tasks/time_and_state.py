"""Tasks on saved states and reset, which must reproduce a run bit by bit, and on the handling of time.

Time: summed communication points, a start time other than zero, no stop time.
"""

import ctypes
import math
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from orchestrator.check.tasks.runner import Remark, Trial
from orchestrator.check.tasks.trial_run import (
    EventMode,
    Integrator,
    Rows,
    Simulation,
    Vector,
    difference,
    inner_step,
    numeric,
    observed,
    scalars,
    severity,
    usual_step,
)
from orchestrator.fmi.instance import CallFailed
from orchestrator.fmi.library import find_library

STEPS_BEFORE, STEPS_AFTER = 7, 9  # before and after the state is saved


def restore(trial: Trial) -> Iterator[Remark]:
    """After its state is restored the FMU repeats the steps bit by bit, twice."""
    simulation = Simulation(trial).begin()
    simulation.run(STEPS_BEFORE, trial.perturbable)
    state, bookmark = simulation.instance.save(), simulation.bookmark()
    expected = simulation.run(STEPS_AFTER, trial.perturbable)
    for _ in range(2):
        simulation.instance.restore(state)
        simulation.return_to(bookmark)
        repeated = simulation.run(STEPS_AFTER, trial.perturbable)
        if text := difference(trial, expected, repeated):
            text = f"the run continues differently after its state was restored: {text}"
            yield severity(trial, expected, repeated), text
            break
    yield from _same_handle(simulation, state)
    simulation.instance.free_state(state)
    if state.value:
        yield "warning", "the handle of a freed state is not NULL"
    simulation.close()


def _same_handle(simulation: Simulation, state: Any) -> Iterator[Remark]:
    """The handle of a saved state can be reused for another state."""
    try:
        simulation.instance.call("GetFMUState", ctypes.byref(state))
        simulation.instance.restore(state)
    except CallFailed as failure:
        yield "warning", f"saving into the handle of an earlier state: {failure}"


def reset(trial: Trial) -> Iterator[Remark]:
    """After a reset the FMU repeats the first run bit by bit."""
    simulation = Simulation(trial).begin()
    expected = [simulation.row(), *simulation.run(STEPS_AFTER, trial.perturbable)]
    try:
        simulation.instance.call("Reset")
    except CallFailed as failure:
        yield "warning", f"{failure}"
        return
    simulation.begin()
    repeated = [simulation.row(), *simulation.run(STEPS_AFTER, trial.perturbable)]
    if text := difference(trial, expected, repeated):
        yield "warning", f"the run after a reset differs: {text}"
    simulation.close()


# ---- in another process


def serialize(trial: Trial) -> Iterator[Remark]:
    """Serialising a state twice gives the same bytes; state and following rows are passed to `elsewhere`."""
    simulation = Simulation(trial).begin()
    simulation.run(STEPS_BEFORE, trial.perturbable)
    state, bookmark = simulation.instance.save(), simulation.bookmark()
    data, repeated = simulation.instance.serialize(state), simulation.instance.serialize(state)
    rows = simulation.run(STEPS_AFTER, trial.perturbable)
    simulation.instance.free_state(state)
    if data != repeated:
        yield "warning", "serialising the same state twice gives different bytes"
    trial.result = {
        "data": data,
        "rows": [row.tolist() for row in rows],
        "bookmark": bookmark,
        "initial_inputs": simulation.initial_inputs.tolist(),
    }


def elsewhere(trial: Trial) -> Iterator[Remark]:
    """A serialised state continues in a new process, after initialisation and right after instantiation."""
    if (saved := trial.payload) is None:  # it could not be serialised
        return
    blocks = [bytearray(1 << n) for n in range(6, 20)]  # memory addresses shall differ from the first process
    for fresh in (False, True):
        simulation = Simulation(trial)
        trial.begin_case(int(fresh))
        if int(fresh) < trial.first_case:
            continue
        try:
            rows = _continue(trial, simulation, saved, fresh)
        except CallFailed as failure:
            where = "right after instantiation" if fresh else "after initialisation"
            yield "warning", f"a state from another process, restored {where}: {failure}"
            continue
        if text := difference(trial, saved["rows"], rows):
            yield "warning", f"a run from the state of another process differs: {text}"
            break
    del blocks


def _continue(trial: Trial, simulation: Simulation, saved: Any, fresh: bool) -> Rows:
    """Rows after the saved state; `fresh`: it is restored right after instantiation."""
    if fresh and trial.kind == "ModelExchange":
        simulation.integrator = Integrator(simulation.instance, trial.description)
    if fresh and simulation.instance.events:
        simulation.events = EventMode(trial, simulation.instance, simulation.start)
    elif not fresh:
        simulation.begin()
    simulation.initial_inputs = np.array(saved["initial_inputs"])
    state = simulation.instance.deserialize(saved["data"])
    simulation.instance.restore(state)
    simulation.instance.free_state(state)
    simulation.return_to(saved["bookmark"])
    rows = simulation.run(STEPS_AFTER, trial.perturbable)
    simulation.close()
    return rows


# ---- time

DRIFT_STEPS = 60
LATE_START = 1000.0  # later than the default start time [s]
START_STEPS = 20
JUMP = 10  # a change in one step, relative to the largest one of the run from the default start time


def drift(trial: Trial) -> Iterator[Remark]:
    """Communication points are accepted as start + n h, and as sums of the steps, which drift by rounding."""
    usual = usual_step(trial.description)
    lengths = [usual]
    if trial.interface.declares("canHandleVariableCommunicationStepSize"):
        # much longer steps than the FMU recommends may fail for other reasons
        lengths += [usual / 3, *(x for x in (0.1, 1 / 60) if x <= 20 * usual)]
    for length in lengths:
        grave = "error" if length == usual else "warning"
        (counted, problem), (summed, summed_problem) = (_run(trial, length, way) for way in (False, True))
        if not counted and not summed:
            yield grave, f"a communication step of {length:.9g} s is rejected: {problem}"
            continue
        yield from ((grave, text) for text in (problem, summed_problem) if text)
        if not problem and not summed_problem and len(counted) == len(summed):
            yield from _lost_step(scalars(observed(trial.description)), length, counted, summed)


def _run(trial: Trial, length: float, summed: bool) -> tuple[list[Vector], str]:
    """Rows, and the message about a step that fails; empty if none does."""
    simulation = Simulation(trial, step=length, summed=summed)
    rows: list[Vector] = []
    try:
        simulation.begin()
        for _ in range(DRIFT_STEPS):
            rows += simulation.run(1)
        simulation.close()
    except CallFailed:
        n = len(rows)
        times = simulation.start + n * length, sum([length] * n, simulation.start)
        labels = "counted", "summed"
        text = (
            f"step {n + 1} of {length:.9g} s is rejected at the {labels[summed]} time {times[summed]:.17g} s"
        )
        other = f"({labels[not summed]} {times[not summed]:.17g} s)"
        return rows, f"{text} {other}{simulation.instance.log.quoted_messages()}"
    return rows, ""


def _lost_step(names: Sequence[str], length: float, counted: Rows, summed: Rows) -> Iterator[Remark]:
    """An output that differs between both runs by as much as a whole step changes it."""
    for name, x, expected, change in zip(
        names, summed[-1], counted[-1], _largest_change(counted), strict=True
    ):
        if abs(x - expected) > max(0.9 * change, 1e-6 * abs(x)):
            text = f"after {len(counted)} steps of {length:.9g} s with summed times {name} is {x:.9g}"
            yield "warning", f"{text}, with counted times {expected:.9g}"
            return


def _largest_change(rows: Rows) -> Vector:
    """The largest change of each output in one step."""
    changes: Vector = np.max(np.abs(np.diff(rows, axis=0)), axis=0, initial=0.0)
    return changes


def start_time(trial: Trial) -> Iterator[Remark]:
    """A start at t = 1000 s works, and the first step has the usual length."""
    early = Simulation(trial).begin()
    rows = [early.row(), *early.run(START_STEPS)]
    early.close()
    late = Simulation(trial, start=early.start + LATE_START)
    late.stop = late.start + START_STEPS * late.step
    try:
        late.begin()
        remarks = list(_time_remarks(late))
        initial = late.row()
        late_rows = late.run(1)
        remarks += _time_remarks(late)
        late_rows += late.run(START_STEPS - 2)
        late.close()
    except CallFailed as failure:
        yield "warning", f"a start at t = {late.start:g} s fails: {failure}"
        return
    if trial.kind == "CoSimulation" and late_rows:
        remarks = remarks or list(_jump(late, rows, initial, late_rows[0]))
        if not remarks and _time_invariant(trial):
            remarks += _different_run(late, rows, [initial, *late_rows])
    yield from remarks


def _time_remarks(simulation: Simulation) -> Iterator[Remark]:
    """The independent variable and the time that the FMU reports fit the simulation time."""
    times = [v for v in numeric(simulation.trial.description, "independent") if v.is_real]
    for v in times[:1]:
        (value,) = simulation.values([v]).get()
        if not _fits_time(simulation, value):
            yield "warning", f"{v.name} is {value:.9g} s at t = {simulation.time:.9g} s"
    reports = simulation.step_count and simulation.instance.fmi == 3 and simulation.integrator is None
    if reports and not _fits_time(simulation, simulation.reached):
        yield (
            "warning",
            f"the last successful time is {simulation.reached:.9g} s at t = {simulation.time:.9g} s",
        )


def _fits_time(simulation: Simulation, value: float) -> bool:
    """A time is not ahead of the simulation, and lags by no more than an internal step."""
    lag = max(50 * simulation.step, inner_step(simulation.trial.description))
    return -lag <= value - simulation.time <= 1e-9 * abs(simulation.time)


def _jump(late: Simulation, rows: Rows, initial: Vector, row: Vector) -> Iterator[Remark]:
    """The first step changes an output far more than any step of the run from the default start time."""
    for name, a, b, usual in zip(late.outputs.names, initial, row, _largest_change(rows), strict=True):
        if abs(b - a) > JUMP * usual and abs(b - a) > 1e-3 * max(abs(a), 1e-6) and not math.isinf(b):
            text = f"the first step from t = {late.start:g} s changes {name} by {b - a:.3g}"
            cause = "the start time is ignored, or outputs are not computed at the start"
            yield "warning", f"{text}, from the default start by up to {usual:.3g}: {cause}"
            return


def _time_invariant(trial: Trial) -> bool:
    """The derivatives and outputs in Model Exchange do not depend on time; False without Model Exchange."""
    interface = trial.description.interfaces.get("ModelExchange")
    name = interface.get("modelIdentifier") if interface else ""
    if interface is None or find_library(trial.folder, name, trial.description.major) is None:
        return False
    library = None if name == trial.interface.get("modelIdentifier") else trial.load(trial.folder, name)
    simulation = Simulation(trial, kind="ModelExchange", library=library).begin()
    integrator = simulation.integrator
    assert integrator is not None
    if integrator.next_event < math.inf:
        return False
    x = integrator.states()
    times = (simulation.start, simulation.start + LATE_START / 3, simulation.start + LATE_START)
    rows = (np.array([*integrator.derivatives_at(t, x), *simulation.row()]) for t in times)
    return len({row.tobytes() for row in rows}) == 1


def _different_run(late: Simulation, rows: Rows, late_rows: Rows) -> Iterator[Remark]:
    """The run from t = 1000 s differs, although the model does not depend on time."""
    count = min(len(rows), len(late_rows))
    a, b = np.array(rows[:count]), np.array(late_rows[:count])
    # rounding of times changes the lengths of internal steps a little
    allowed = 1e-3 * np.ptp(rows, axis=0) + 1e-6 * np.maximum(np.abs(a), late.outputs.nominal)
    for i, n in np.argwhere((np.abs(a - b) > allowed).T)[:1]:
        text = f"{late.outputs.names[i]} is {b[n, i]:.9g} after {n} steps from t = {late.start:g} s"
        expected = f"expected {a[n, i]:.9g} as from the default start, because nothing depends on time"
        yield "warning", f"{text}, {expected}"


def stop_time(trial: Trial) -> Iterator[Remark]:
    """Without a stop time the FMU continues, also beyond the stop time of the default experiment."""
    experiment = trial.description.experiment
    start, stop = experiment.number("startTime") or 0.0, experiment.number("stopTime")
    late = start if stop is None else max(start, stop - usual_step(trial.description))
    simulation = Simulation(trial, start=late)
    try:
        simulation.begin()
        simulation.run(3)
        simulation.close()
    except CallFailed as failure:
        yield "warning", f"without a stop time, from t = {late:.9g} s: {failure}"
