"""The first values, right at once, before any step; and the default experiment."""

from __future__ import annotations

import ctypes
import math
from collections.abc import Iterator, Sequence

from orchestrator.check.tasks.runner import OnlyOnce, Remark, Trial
from orchestrator.check.tasks.trial_run import (
    Rows,
    Simulation,
    experiment,
    flat,
    inner_step,
    not_finite,
    numeric,
    usual_step,
)
from orchestrator.fmi.instance import LAST_TIME, CallFailed
from orchestrator.fmi.messages import FATAL


def first_output(trial: Trial) -> Iterator[Remark]:
    """Values are right at once after initialisation, those that depend on inputs, too."""
    simulation = Simulation(trial).begin()
    yield from _starts(simulation)
    before = simulation.row()
    if simulation.inputs.names:
        simulation.inputs.set(simulation.rest)
        yield from _settled(simulation, before, "inputs keep their start values")
    if trial.pokes:
        yield from _set_before(trial)
    if trial.kind == "CoSimulation" and trial.able.declares("canHandleVariableCommunicationStepSize"):
        yield from _tiny_step(trial, before)


def _settled(simulation: Simulation, before: Sequence[float], case: str) -> Iterator[Remark]:
    after = simulation.row()
    scales = [v.scale for v in flat(simulation.outputs.variables)]
    for name, a, b, scale in zip(simulation.outputs.names, before, after, scales, strict=True):
        if abs(a - b) > 1e-9 * max(abs(a), abs(b), 1e-6 * scale):
            text = f"{name} is {a:.9g} after initialisation and {b:.9g} when the inputs are set again to"
            yield "error", f"{text} the same values ({case}): it is not evaluated at initialisation"
            return


def _set_before(trial: Trial) -> Iterator[Remark]:
    simulation = Simulation(trial)
    simulation.instance.setup(simulation.start)
    simulation.instance.enter()
    simulation.rest = simulation.inputs.get()
    simulation.poke(0)
    moved = simulation.inputs.get()
    simulation.instance.leave()
    simulation.settle()
    before = simulation.row()
    if simulation.inputs.names:
        simulation.inputs.set(moved)
        yield from _settled(simulation, before, "inputs were set in initialisation mode")


def _tiny_step(trial: Trial, first: Sequence[float]) -> Iterator[Remark]:
    """An output of exactly 0 that jumps within no time and then hardly moves was not evaluated."""
    simulation = Simulation(trial, step=1e-6 * usual_step(trial.description)).begin()
    rows = simulation.run(2)
    if len(rows) < 2:
        return
    variables = flat(simulation.outputs.variables)
    for v, name, a, b, c in zip(variables, simulation.outputs.names, first, *rows, strict=True):
        steady = v.is_float and v.variability == "continuous"
        if steady and a == 0.0 and abs(b) > 1e-3 * v.nominal and abs(c - b) < 0.1 * abs(b):
            text = f"{name} is 0 after initialisation and {b:.6g} after a step of {simulation.step:.3g} s"
            yield "warning", f"{text}: it is not evaluated at initialisation"


def _starts(simulation: Simulation) -> Iterator[Remark]:
    """Parameters and inputs read what modelDescription.xml says."""
    known = [v for v in numeric(simulation.trial.description, "parameter", "input") if v.start]
    values = simulation.values(known)
    wanted = [s for v in known for s in (v.start if len(v.start) == v.size else v.start[:1] * v.size)]
    for name, x, start in zip(values.names, values.get(), wanted, strict=True):
        # single precision holds seven digits
        if abs(x - start) > 1e-6 * max(abs(x), abs(start)) or math.isnan(x) != math.isnan(start):
            text = f"{name} starts at {start:.9g} in modelDescription.xml and at {x:.9g} in the binary"
            yield "error", text
            return


HUGE = 1e30  # times the nominal value: a model that runs away
MOST = 20_000  # steps


def default(trial: Trial) -> Iterator[Remark]:
    """Default values: everything finite, no error; hands over whether small changes of inputs are taken."""
    start = experiment(trial.description, "startTime") or 0.0
    stop = experiment(trial.description, "stopTime")
    endless = stop is None or math.isinf(stop)
    most = MOST if stop is None or endless else int((stop - start) / usual_step(trial.description) + 1e-9)
    simulation, first, rows = _run(trial, stop if most else None, max(most, 1))
    if bad := not_finite(simulation.outputs.names, [first]):
        yield "error", f"after initialisation {bad}"
    yield from _unsound(simulation, rows)
    yield from _reached(simulation)
    simulation.close()
    trial.summed = simulation.summed
    trial.result = {"pokes": _pokes(trial), "summed": simulation.summed}


def _run(trial: Trial, stop: float | None, most: int) -> tuple[Simulation, list[float], Rows]:
    """Row after initialisation, and rows of the steps; with the points as the FMU takes them."""
    simulation = Simulation(trial, stop=stop).begin()
    first = simulation.row()
    try:
        return simulation, first, simulation.run(most, seconds=trial.seconds)
    except CallFailed as failure:
        if failure.status == FATAL or trial.kind == "ModelExchange":
            raise
        try:
            other = Simulation(trial, stop=stop, summed=True).begin()
            return other, first, other.run(most, seconds=trial.seconds)
        except (CallFailed, OnlyOnce):
            raise failure from None


def _unsound(simulation: Simulation, rows: Rows) -> Iterator[Remark]:
    """The first step whose outputs are not numbers, or beyond all bounds."""
    names, limits = simulation.outputs.names, [HUGE * v.nominal for v in flat(simulation.outputs.variables)]
    for n, row in enumerate(rows, 1):
        time = simulation.start + n * simulation.step
        when = f"at t = {time:.9g} s with default values, and the status is OK"
        if bad := not_finite(names, [row]):
            yield "error", f"{bad} {when}"
            return
        grown = [i for i, (x, limit) in enumerate(zip(row, limits, strict=True)) if abs(x) > limit]
        if grown:
            yield "error", f"{names[grown[0]]} has grown to {row[grown[0]]:.3g} {when}"
            return


def _reached(simulation: Simulation) -> Iterator[Remark]:
    """The FMU's own idea of the time, where it has one."""
    instance, expected = simulation.instance, simulation.time
    if simulation.exchange is not None or simulation.ended:
        return
    reached = simulation.reached
    if instance.fmi == 2 and instance.library.has("GetRealStatus"):
        value = ctypes.c_double(math.nan)
        if instance.status("GetRealStatus", LAST_TIME, ctypes.byref(value)) == 0:
            reached = value.value
    inner = max(simulation.step, inner_step(simulation.trial.description))  # by which it may be late
    if not -inner * 1.001 <= reached - expected <= 1e-6 * max(simulation.step, abs(expected)):
        yield "error", f"the last successful time is {reached:.9g} s, expected {expected:.9g} s"


def _pokes(trial: Trial) -> bool:
    """Are small changes of the inputs taken?"""
    try:
        simulation = Simulation(trial).begin()
        rows = simulation.run(10, poke=True)
        simulation.close()
    except (CallFailed, OnlyOnce):
        return False
    return not not_finite(simulation.outputs.names, rows)
