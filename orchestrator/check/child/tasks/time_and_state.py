"""States that are saved: the continuation is the same bits, here, in another process, and after a reset.

Time as masters count it: summed steps, a start that is not zero, no stop time.
"""

from __future__ import annotations

import base64
import ctypes
import math
from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import Any

from orchestrator.check.child.binary import Refused, find
from orchestrator.check.child.main import Bench, Said
from orchestrator.check.child.model_exchange import Exchange
from orchestrator.check.child.player import Player, Values, bits

BEFORE, AFTER = 7, 9  # steps before the state is saved, and after


def restore(bench: Bench) -> Iterator[Said]:
    """Save, go on, restore, go on: the same bits, twice."""
    player = bench.player().begin()
    player.run(BEFORE, bench.pokes)
    state, mark = player.instance.save(), player.mark()
    first = player.run(AFTER, bench.pokes)
    for _ in range(2):
        player.instance.restore(state)
        player.back(mark)
        again = player.run(AFTER, bench.pokes)
        if bits(first) != bits(again):
            text = bench.difference(first, again)
            yield "error", f"the run goes on in another way after its state was restored: {text}"
            break
    yield from _same_handle(player, state)
    player.instance.forget(state)
    if state.value:
        yield "warning", "a freed state leaves its handle, expected NULL"
    player.close()


def _same_handle(player: Player, state: Any) -> Iterator[Said]:
    """A handle may be used again for another state."""
    try:
        player.instance.call("GetFMUState", ctypes.byref(state))
        player.instance.restore(state)
    except Refused as refusal:
        yield "warning", f"saving into a state that was used before: {refusal}"


def reset(bench: Bench) -> Iterator[Said]:
    """After a reset the first run comes again."""
    player = bench.player().begin()
    first = [player.row(), *player.run(AFTER, bench.pokes)]
    try:
        player.instance.call("Reset")
    except Refused as refusal:
        yield "warning", f"{refusal}"
        return
    player.begin()
    again = [player.row(), *player.run(AFTER, bench.pokes)]
    if bits(first) != bits(again):
        yield "error", f"the run after a reset differs: {bench.difference(first, again)}"
    player.close()


# ---- in another process


def serialize(bench: Bench) -> Iterator[Said]:
    """A state as bytes, twice the same, restored in another instance; handed over with the continuation."""
    player = bench.player().begin()
    player.run(BEFORE, bench.pokes)
    state, mark = player.instance.save(), player.mark()
    try:
        data, twice = player.instance.serialize(state), player.instance.serialize(state)
    except ValueError as problem:
        yield "error", f"serialising a state: {problem}"
        return
    rows = player.run(AFTER, bench.pokes)
    player.instance.forget(state)
    if data != twice:
        yield "warning", "the same state gives other bytes when it is serialised again"
    bench.result = {
        "data": base64.b64encode(data).decode(),
        "rows": rows,
        "mark": mark,
        "rest": player.rest,
    }


def elsewhere(bench: Bench) -> Iterator[Said]:
    """The second half, in a fresh process: after initialisation, and right after instantiation."""
    handed = bench.payload
    junk = [bytearray(1 << n) for n in range(6, 20)]  # the memory shall not look as in the first process
    for fresh in (False, True):
        player = bench.player()
        bench.at(int(fresh))
        if int(fresh) < bench.first:
            continue
        try:
            again = _continue(bench, player, handed, fresh)
        except Refused as refusal:
            where = "right after instantiation" if fresh else "after initialisation"
            yield (
                "warning" if fresh else "error",
                f"a state from another process, restored {where}: {refusal}",
            )
            continue
        if bits(again) != bits(handed["rows"]):
            text = bench.difference(handed["rows"], again)
            yield "error", f"a state from another process goes on in another way: {text}"
            break
    del junk


def _continue(bench: Bench, player: Player, handed: Any, fresh: bool) -> list[list[float]]:
    if fresh and bench.side == "me":
        player.exchange = Exchange(player.instance)
    if not fresh:
        player.begin()
    player.rest = handed["rest"]
    state = player.instance.deserialize(base64.b64decode(handed["data"]))
    player.instance.restore(state)
    player.instance.forget(state)
    player.back(handed["mark"])
    rows = player.run(AFTER, bench.pokes)
    player.close()
    return rows


Rows = list[list[float]]
STEPS = 60
LATE = 1000.0  # s
FEW = 20
LEAP = 10  # times the largest step of the usual start: nothing in a model that runs on is as sudden


def drift(bench: Bench) -> Iterator[Said]:
    """Communication points are accepted, whether they are counted or summed up and so drift by rounding."""
    own = bench.declared.step
    lengths = [own]
    if bench.can("canHandleVariableCommunicationStepSize"):
        # much longer steps than the FMU recommends may fail for other reasons
        lengths += [own / 3, *(x for x in (0.1, 1 / 60) if x <= 20 * own)]
    for length in lengths:
        (counted, plain), (summed, drifted) = (_played(bench, length, way) for way in (False, True))
        if not counted and not summed:
            yield "error", f"a communication step of {length:.9g} s is refused: {plain}"
            continue
        yield from (("error", text) for text in (plain, drifted) if text)
        if not plain and not drifted and len(counted) == len(summed):
            yield from _lost_step(bench.names(), length, counted, summed)


def _played(bench: Bench, length: float, summed: bool) -> tuple[list[list[float]], str]:
    """Rows, and where it ends in a refusal that in words."""
    player = bench.player(step=length, summed=summed)
    player.stop = player.start + STEPS * length
    rows: list[list[float]] = []
    try:
        player.begin()
        for _ in range(STEPS):
            rows += player.run(1)
        player.close()
    except Refused as refusal:
        n = len(rows)
        counted, ways = player.start + n * length, ("counted", "summed")
        exact = sum([length] * n, player.start)
        there, other = (exact, counted) if summed else (counted, exact)
        more = f": {refusal.said}" if refusal.said else ""
        text = f"step {n + 1} of {length:.9g} s is refused at the {ways[summed]} time {there:.17g} s"
        return rows, f"{text} ({ways[not summed]} {other:.17g} s){more}"
    return rows, ""


def _lost_step(names: Sequence[str], length: float, counted: Rows, summed: Rows) -> Iterator[Said]:
    """Outputs that are a whole step apart."""
    for i, name in enumerate(names):
        column, x = [row[i] for row in counted], summed[-1][i]
        moves = max((abs(b - a) for a, b in pairwise(column)), default=0.0)
        if abs(x - column[-1]) > max(0.9 * moves, 1e-6 * abs(x)):
            text = f"after {len(counted)} steps of {length:.9g} s with summed times {name} is {x:.9g}"
            yield "warning", f"{text}, with counted times {column[-1]:.9g}"
            return


def start_time(bench: Bench) -> Iterator[Said]:
    """A start at t = 1000 s works, and its first step is one step."""
    early = bench.player().begin()
    first = early.row()
    rows = [first, *early.run(FEW)]
    early.close()
    late = bench.player(start=early.start + LATE)
    late.stop = late.start + FEW * late.step
    try:
        late.begin()
        found = list(_clock(late))
        begin = late.row()
        after = late.run(1)
        found += _clock(late)
        after += late.run(FEW - 2)
        late.close()
    except Refused as refusal:
        yield "error", f"a start at t = {late.start:g} s does not work: {refusal}"
        return
    if bench.side == "cs" and after:
        found = found or list(_leap(late, rows, begin, after[0]))
        if not found and _timeless(bench):
            found += _other(late, rows, [begin, *after])
    yield from found


def _clock(player: Player) -> Iterator[Said]:
    """The independent variable, where there is one, and the time the FMU says it reached."""
    times = [v for v in player.instance.declared.of("independent") if v.is_float]
    for v in times[:1]:
        (value,) = Values(player.instance, [v]).get()
        if not _timely(player, value):
            yield "error", f"{v.name} is {value:.9g} s at t = {player.time:.9g} s"
    tells = player.number and player.instance.declared.major == 3 and player.instance.side == "cs"
    if tells and not _timely(player, player.reached):
        yield "error", f"the last successful time is {player.reached:.9g} s at t = {player.time:.9g} s"


def _timely(player: Player, value: float) -> bool:
    """Not early; late by no more than an inner step, of which little may be known."""
    late = max(50 * player.step, player.instance.declared.inner_step)
    return -late <= value - player.time <= 1e-9 * abs(player.time)


def _leap(late: Player, rows: list[list[float]], begin: list[float], after: list[float]) -> Iterator[Said]:
    """One step that changes an output far more than any step of the run from the usual start."""
    for i, (name, a, b) in enumerate(zip(late.outputs.names, begin, after, strict=True)):
        usual = max((abs(y[i] - x[i]) for x, y in pairwise(rows)), default=0.0)
        if abs(b - a) > LEAP * usual and abs(b - a) > 1e-3 * max(abs(a), 1e-6) and not math.isinf(b):
            text = f"the first step from t = {late.start:g} s changes {name} by {b - a:.3g}"
            cause = "the start time is ignored, or outputs are not computed at the start"
            yield "error", f"{text}, from the default start by up to {usual:.3g}: {cause}"
            return


def _timeless(bench: Bench) -> bool:
    """Does the model not depend on time? Its model exchange tells, if it has one; else nobody knows."""
    if "me" not in bench.declared.sides or find(bench.folder, bench.declared, "me") is None:
        return False
    player = bench.player(side="me").begin()
    exchange = player.exchange
    assert exchange is not None
    if exchange.next < math.inf:  # events at times
        return False
    x = exchange.states()
    rows = []
    for time in (player.start, player.start + LATE / 3, player.start + LATE):
        exchange.put(time, x)
        rows.append([*exchange.derivatives(), *player.row()])
    return bits(rows[:1]) == bits(rows[1:2]) == bits(rows[2:])


def _other(late: Player, rows: Rows, found: Rows) -> Iterator[Said]:
    """Another run from t = 1000 s, of a model that does not depend on time."""
    flat = [v for v in late.outputs.variables for _ in range(v.size)]
    for i, (v, name) in enumerate(zip(flat, late.outputs.names, strict=True)):
        spread = max(row[i] for row in rows) - min(row[i] for row in rows)
        for n, (a, b) in enumerate(zip(rows, found, strict=False)):
            # rounding of times changes the lengths of inner steps a little
            if abs(a[i] - b[i]) > 1e-3 * spread + 1e-6 * max(abs(a[i]), v.nominal):
                text = f"{name} is {b[i]:.9g} after {n} steps from t = {late.start:g} s"
                yield "error", f"{text}, and {a[i]:.9g} from the default start; nothing else depends on time"
                return


def stop_time(bench: Bench) -> Iterator[Said]:
    """Without a stop time the FMU runs on, beyond the stop time of the default experiment, too."""
    start, stop = bench.declared.experiment.get("startTime", 0.0), bench.declared.experiment.get("stopTime")
    late = start if stop is None else max(start, stop - bench.declared.step)
    player = bench.player(start=late)
    try:
        player.begin()
        player.run(3)
        player.close()
    except Refused as refusal:
        yield "error", f"without a stop time, from t = {late:.9g} s: {refusal}"
