"""The default experiment."""

from __future__ import annotations

import ctypes
import math
from collections.abc import Iterator, Sequence

from orchestrator.trial.bench import Bench, Said
from orchestrator.trial.binary import FATAL, Refused
from orchestrator.trial.instance import Spent
from orchestrator.trial.player import Player, odd

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
