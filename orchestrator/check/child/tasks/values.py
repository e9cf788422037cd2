"""The first values: right at once, before any step.

The default experiment.
"""

from __future__ import annotations

import ctypes
import math
from collections.abc import Iterator, Sequence

from orchestrator.check.child.binary import FATAL, Refused
from orchestrator.check.child.description import Variable
from orchestrator.check.child.instance import Instance, Spent
from orchestrator.check.child.main import Bench, Said
from orchestrator.check.child.player import Player, Values, odd


def first_output(bench: Bench) -> Iterator[Said]:
    """Values are right at once after initialisation, those that depend on inputs, too."""
    player = bench.player().begin()
    yield from _starts(bench, player.instance)
    before = player.row()
    if player.inputs.names:
        player.inputs.set(player.rest)
        yield from _settled(player, before, "inputs keep their start values")
    if bench.pokes:
        yield from _set_before(bench)
    if bench.side == "cs" and bench.can("canHandleVariableCommunicationStepSize"):
        yield from _tiny_step(bench, before)


def _settled(player: Player, before: Sequence[float], case: str) -> Iterator[Said]:
    after = player.row()
    scales = [v.scale for v in player.outputs.variables for _ in range(v.size)]
    for name, a, b, scale in zip(player.outputs.names, before, after, scales, strict=True):
        if abs(a - b) > 1e-9 * max(abs(a), abs(b), 1e-6 * scale):
            text = f"{name} is {a:.9g} after initialisation and {b:.9g} when the inputs are set again to"
            yield "error", f"{text} the same values ({case}): it is not evaluated at initialisation"
            return


def _set_before(bench: Bench) -> Iterator[Said]:
    player = bench.player()
    player.instance.enter(player.start)
    player.rest = player.inputs.get() if player.inputs.names else []
    player.poke(0)
    moved = player.inputs.get() if player.inputs.names else []
    player.instance.leave()
    player.settle()
    before = player.row()
    if player.inputs.names:
        player.inputs.set(moved)
        yield from _settled(player, before, "inputs were set in initialisation mode")


def _tiny_step(bench: Bench, first: Sequence[float]) -> Iterator[Said]:
    """An output of exactly 0 that jumps within no time and then hardly moves was not evaluated."""
    player = bench.player(step=1e-6 * bench.declared.step).begin()
    rows = player.run(2)
    if len(rows) < 2:
        return
    flat = [v for v in player.outputs.variables for _ in range(v.size)]
    for v, name, a, b, c in zip(flat, player.outputs.names, first, *rows, strict=True):
        steady = v.is_float and v.variability == "continuous"
        if steady and a == 0.0 and abs(b) > 1e-3 * v.nominal and abs(c - b) < 0.1 * abs(b):
            text = f"{name} is 0 after initialisation and {b:.6g} after a step of {player.step:.3g} s"
            yield "warning", f"{text}: it is not evaluated at initialisation"


def _starts(bench: Bench, instance: Instance) -> Iterator[Said]:
    """Parameters and inputs read what modelDescription.xml says."""
    known = [v for v in bench.declared.of("parameter", "input") if v.start]
    if not known:
        return
    values = Values(instance, known)
    wanted = [s for v in known for s in _spread(v)]
    for name, x, start in zip(values.names, values.get(), wanted, strict=True):
        # single precision holds seven digits
        if abs(x - start) > 1e-6 * max(abs(x), abs(start)) or math.isnan(x) != math.isnan(start):
            yield (
                "error",
                f"{name} starts at {start:.9g} in modelDescription.xml and at {x:.9g} in the binary",
            )
            return


def _spread(v: Variable) -> Sequence[float]:
    return v.start if len(v.start) == v.size else v.start[:1] * v.size


HUGE = 1e30  # times the nominal value: a model that runs away
MOST = 20_000  # steps


def default(bench: Bench) -> Iterator[Said]:
    """Default values: everything finite, no error; hands over whether small changes of inputs are taken."""
    start = bench.declared.experiment.get("startTime", 0.0)
    stop = bench.declared.experiment.get("stopTime")
    most = MOST if stop is None or math.isinf(stop) else int((stop - start) / bench.declared.step + 1e-9)
    player, first, rows = _run(bench, stop if most else None, max(most, 1))
    names = player.outputs.names
    if odd(names, first):
        yield "error", f"after initialisation {odd(names, first)}"
    limits = [HUGE * v.nominal for v in player.outputs.variables for _ in range(v.size)]
    yield from _unsound(player, rows, limits)
    yield from _reached(player)
    player.close()
    bench.summed = player.summed
    bench.result = {"pokes": _pokes(bench), "summed": player.summed}


def _run(bench: Bench, stop: float | None, most: int) -> tuple[Player, list[float], list[list[float]]]:
    """Row after initialisation, and rows of the steps; with the points as the FMU takes them."""
    player = bench.player(stop=stop).begin()
    first = player.row()
    try:
        return player, first, player.run_for(bench.seconds, most)
    except Refused as refusal:
        if refusal.status == FATAL or bench.side == "me":
            raise
        try:
            other = bench.player(stop=stop, summed=True).begin()
            return other, first, other.run_for(bench.seconds, most)
        except (Refused, Spent):
            raise refusal from None


def _unsound(player: Player, rows: Sequence[Sequence[float]], limits: Sequence[float]) -> Iterator[Said]:
    """The first step whose outputs are not numbers, or beyond all bounds."""
    names = player.outputs.names
    for n, row in enumerate(rows, 1):
        when = f"at t = {player.start + n * player.step:.9g} s with default values, and the status is OK"
        if odd(names, row):
            yield "error", f"{odd(names, row)} {when}"
            return
        grown = [i for i, (x, limit) in enumerate(zip(row, limits, strict=True)) if abs(x) > limit]
        if grown:
            yield "error", f"{names[grown[0]]} has grown to {row[grown[0]]:.3g} {when}"
            return


def _reached(player: Player) -> Iterator[Said]:
    """The FMU's own idea of the time, where it tells."""
    instance, expected = player.instance, player.time
    if instance.side == "me" or instance.ended:
        return
    reached = player.reached
    if instance.declared.major == 2 and instance.binary.has("GetRealStatus"):
        value = ctypes.c_double(math.nan)
        if instance.status("GetRealStatus", 2, ctypes.byref(value)) == 0:
            reached = value.value
    inner = max(player.step, instance.declared.inner_step)  # by which it may be late
    if not -inner * 1.001 <= reached - expected <= 1e-6 * max(player.step, abs(expected)):
        yield "error", f"the last successful time is {reached:.9g} s, expected {expected:.9g} s"


def _pokes(bench: Bench) -> bool:
    """Are small changes of the inputs taken?"""
    try:
        player = bench.player().begin()
        rows = player.run(10, poke=True)
        player.close()
    except (Refused, Spent):
        return False
    return all(not odd(player.outputs.names, r) for r in rows)
