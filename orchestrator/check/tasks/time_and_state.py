"""States that are saved go on bit for bit, here, in another process, after a reset; time as masters count it.

A master sums its steps, starts at a time that is not zero, or knows no stop time.
"""

from __future__ import annotations

import ctypes
import math
from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import Any

from orchestrator.check.tasks.runner import Remark, Trial
from orchestrator.check.tasks.trial_run import (
    ContinuousStates,
    Rows,
    Simulation,
    bits,
    difference,
    experiment,
    flat,
    inner_step,
    numeric,
    scalars,
    usual_step,
    watched,
)
from orchestrator.fmi.instance import CallFailed
from orchestrator.fmi.library import find_library

BEFORE, AFTER = 7, 9  # steps before the state is saved, and after


def restore(trial: Trial) -> Iterator[Remark]:
    """Save, go on, restore, go on: the same bits, twice."""
    simulation = Simulation(trial).begin()
    simulation.run(BEFORE, trial.pokes)
    state, mark = simulation.instance.save(), simulation.mark()
    first = simulation.run(AFTER, trial.pokes)
    for _ in range(2):
        simulation.instance.restore(state)
        simulation.back(mark)
        again = simulation.run(AFTER, trial.pokes)
        if bits(first) != bits(again):
            text = difference(trial, first, again)
            yield "error", f"the run goes on in another way after its state was restored: {text}"
            break
    yield from _same_handle(simulation, state)
    simulation.instance.free_state(state)
    if state.value:
        yield "warning", "a freed state leaves its handle, expected NULL"
    simulation.close()


def _same_handle(simulation: Simulation, state: Any) -> Iterator[Remark]:
    """A handle may be used again for another state."""
    try:
        simulation.instance.call("GetFMUState", ctypes.byref(state))
        simulation.instance.restore(state)
    except CallFailed as failure:
        yield "warning", f"saving into a state that was used before: {failure}"


def reset(trial: Trial) -> Iterator[Remark]:
    """After a reset the first run comes again."""
    simulation = Simulation(trial).begin()
    first = [simulation.row(), *simulation.run(AFTER, trial.pokes)]
    try:
        simulation.instance.call("Reset")
    except CallFailed as failure:
        yield "warning", f"{failure}"
        return
    simulation.begin()
    again = [simulation.row(), *simulation.run(AFTER, trial.pokes)]
    if bits(first) != bits(again):
        yield "error", f"the run after a reset differs: {difference(trial, first, again)}"
    simulation.close()


# ---- in another process


def serialize(trial: Trial) -> Iterator[Remark]:
    """A state as bytes, twice the same, restored in another instance; handed over with the continuation."""
    simulation = Simulation(trial).begin()
    simulation.run(BEFORE, trial.pokes)
    state, mark = simulation.instance.save(), simulation.mark()
    data, twice = simulation.instance.serialize(state), simulation.instance.serialize(state)
    rows = simulation.run(AFTER, trial.pokes)
    simulation.instance.free_state(state)
    if data != twice:
        yield "warning", "the same state gives other bytes when it is serialised again"
    trial.result = {"data": data, "rows": rows, "mark": mark, "rest": simulation.rest}


def elsewhere(trial: Trial) -> Iterator[Remark]:
    """The second half, in a fresh process: after initialisation, and right after instantiation."""
    handed = trial.payload
    junk = [bytearray(1 << n) for n in range(6, 20)]  # the memory shall not look as in the first process
    for fresh in (False, True):
        simulation = Simulation(trial)
        trial.at(int(fresh))
        if int(fresh) < trial.first:
            continue
        try:
            again = _continue(trial, simulation, handed, fresh)
        except CallFailed as failure:
            where = "right after instantiation" if fresh else "after initialisation"
            severity = "warning" if fresh else "error"
            yield severity, f"a state from another process, restored {where}: {failure}"
            continue
        if bits(again) != bits(handed["rows"]):
            text = difference(trial, handed["rows"], again)
            yield "error", f"a state from another process goes on in another way: {text}"
            break
    del junk


def _continue(trial: Trial, simulation: Simulation, handed: Any, fresh: bool) -> Rows:
    if fresh and trial.kind == "ModelExchange":
        simulation.exchange = ContinuousStates(simulation.instance, trial.description)
    if not fresh:
        simulation.begin()
    simulation.rest = handed["rest"]
    state = simulation.instance.deserialize(handed["data"])
    simulation.instance.restore(state)
    simulation.instance.free_state(state)
    simulation.back(handed["mark"])
    rows = simulation.run(AFTER, trial.pokes)
    simulation.close()
    return rows


STEPS = 60
LATE = 1000.0  # s
FEW = 20
LEAP = 10  # times the largest step of the usual start: nothing in a model that runs on is as sudden


def drift(trial: Trial) -> Iterator[Remark]:
    """Communication points are accepted, whether they are counted or summed up and so drift by rounding."""
    own = usual_step(trial.description)
    lengths = [own]
    if trial.able.declares("canHandleVariableCommunicationStepSize"):
        # much longer steps than the FMU recommends may fail for other reasons
        lengths += [own / 3, *(x for x in (0.1, 1 / 60) if x <= 20 * own)]
    for length in lengths:
        (counted, plain), (summed, drifted) = (_run(trial, length, way) for way in (False, True))
        if not counted and not summed:
            yield "error", f"a communication step of {length:.9g} s is refused: {plain}"
            continue
        yield from (("error", text) for text in (plain, drifted) if text)
        if not plain and not drifted and len(counted) == len(summed):
            yield from _lost_step(scalars(watched(trial.description)), length, counted, summed)


def _run(trial: Trial, length: float, summed: bool) -> tuple[Rows, str]:
    """Rows, and where it ends in a failure that in words."""
    simulation = Simulation(trial, step=length, summed=summed)
    simulation.stop = simulation.start + STEPS * length
    rows: Rows = []
    try:
        simulation.begin()
        for _ in range(STEPS):
            rows += simulation.run(1)
        simulation.close()
    except CallFailed:
        n = len(rows)
        counted, ways = simulation.start + n * length, ("counted", "summed")
        exact = sum([length] * n, simulation.start)
        there, other = (exact, counted) if summed else (counted, exact)
        text = f"step {n + 1} of {length:.9g} s is refused at the {ways[summed]} time {there:.17g} s"
        return rows, f"{text} ({ways[not summed]} {other:.17g} s){simulation.instance.log.quoted_messages()}"
    return rows, ""


def _lost_step(names: Sequence[str], length: float, counted: Rows, summed: Rows) -> Iterator[Remark]:
    """Outputs that are a whole step apart."""
    for i, name in enumerate(names):
        column, x = [row[i] for row in counted], summed[-1][i]
        moves = max((abs(b - a) for a, b in pairwise(column)), default=0.0)
        if abs(x - column[-1]) > max(0.9 * moves, 1e-6 * abs(x)):
            text = f"after {len(counted)} steps of {length:.9g} s with summed times {name} is {x:.9g}"
            yield "warning", f"{text}, with counted times {column[-1]:.9g}"
            return


def start_time(trial: Trial) -> Iterator[Remark]:
    """A start at t = 1000 s works, and its first step is one step."""
    early = Simulation(trial).begin()
    first = early.row()
    rows = [first, *early.run(FEW)]
    early.close()
    late = Simulation(trial, start=early.start + LATE)
    late.stop = late.start + FEW * late.step
    try:
        late.begin()
        found = list(_clock(late))
        begin = late.row()
        after = late.run(1)
        found += _clock(late)
        after += late.run(FEW - 2)
        late.close()
    except CallFailed as failure:
        yield "error", f"a start at t = {late.start:g} s does not work: {failure}"
        return
    if trial.kind == "CoSimulation" and after:
        found = found or list(_leap(late, rows, begin, after[0]))
        if not found and _timeless(trial):
            found += _other(late, rows, [begin, *after])
    yield from found


def _clock(simulation: Simulation) -> Iterator[Remark]:
    """The independent variable, where there is one, and the time the FMU says it reached."""
    times = [v for v in numeric(simulation.trial.description, "independent") if v.is_float]
    for v in times[:1]:
        (value,) = simulation.values([v]).get()
        if not _timely(simulation, value):
            yield "error", f"{v.name} is {value:.9g} s at t = {simulation.time:.9g} s"
    tells = simulation.number and simulation.instance.fmi == 3 and simulation.exchange is None
    if tells and not _timely(simulation, simulation.reached):
        yield (
            "error",
            f"the last successful time is {simulation.reached:.9g} s at t = {simulation.time:.9g} s",
        )


def _timely(simulation: Simulation, value: float) -> bool:
    """Not early; late by no more than an inner step, of which little may be known."""
    late = max(50 * simulation.step, inner_step(simulation.trial.description))
    return -late <= value - simulation.time <= 1e-9 * abs(simulation.time)


def _leap(late: Simulation, rows: Rows, begin: list[float], after: list[float]) -> Iterator[Remark]:
    """One step that changes an output far more than any step of the run from the usual start."""
    for i, (name, a, b) in enumerate(zip(late.outputs.names, begin, after, strict=True)):
        usual = max((abs(y[i] - x[i]) for x, y in pairwise(rows)), default=0.0)
        if abs(b - a) > LEAP * usual and abs(b - a) > 1e-3 * max(abs(a), 1e-6) and not math.isinf(b):
            text = f"the first step from t = {late.start:g} s changes {name} by {b - a:.3g}"
            cause = "the start time is ignored, or outputs are not computed at the start"
            yield "error", f"{text}, from the default start by up to {usual:.3g}: {cause}"
            return


def _timeless(trial: Trial) -> bool:
    """Does the model not depend on time? Its model exchange tells, if it has one; else nobody knows."""
    able = trial.description.interfaces.get("ModelExchange")
    name = able.get("modelIdentifier") if able else ""
    if able is None or find_library(trial.folder, name, trial.description.major) is None:
        return False
    library = None if name == trial.able.get("modelIdentifier") else trial.load(trial.folder, name)
    simulation = Simulation(trial, kind="ModelExchange", library=library).begin()
    exchange = simulation.exchange
    assert exchange is not None
    if exchange.next < math.inf:  # events at times
        return False
    x = exchange.states()
    rows = []
    for time in (simulation.start, simulation.start + LATE / 3, simulation.start + LATE):
        rows.append([*exchange.derivatives_at(time, x), *simulation.row()])
    return bits(rows[:1]) == bits(rows[1:2]) == bits(rows[2:])


def _other(late: Simulation, rows: Rows, found: Rows) -> Iterator[Remark]:
    """Another run from t = 1000 s, of a model that does not depend on time."""
    for i, (v, name) in enumerate(zip(flat(late.outputs.variables), late.outputs.names, strict=True)):
        spread = max(row[i] for row in rows) - min(row[i] for row in rows)
        for n, (a, b) in enumerate(zip(rows, found, strict=False)):
            # rounding of times changes the lengths of inner steps a little
            if abs(a[i] - b[i]) > 1e-3 * spread + 1e-6 * max(abs(a[i]), v.nominal):
                text = f"{name} is {b[i]:.9g} after {n} steps from t = {late.start:g} s"
                yield "error", f"{text}, and {a[i]:.9g} from the default start; nothing else depends on time"
                return


def stop_time(trial: Trial) -> Iterator[Remark]:
    """Without a stop time the FMU runs on, beyond the stop time of the default experiment, too."""
    start, stop = experiment(trial.description, "startTime") or 0.0, experiment(trial.description, "stopTime")
    late = start if stop is None else max(start, stop - usual_step(trial.description))
    simulation = Simulation(trial, start=late)
    try:
        simulation.begin()
        simulation.run(3)
        simulation.close()
    except CallFailed as failure:
        yield "error", f"without a stop time, from t = {late:.9g} s: {failure}"
