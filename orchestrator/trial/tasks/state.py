"""States that are saved: the continuation is the same bits, here, in another process, and after a reset."""

from __future__ import annotations

import base64
import ctypes
from collections.abc import Iterator
from typing import Any

from orchestrator.trial.bench import Bench, Said
from orchestrator.trial.binary import Refused
from orchestrator.trial.exchange import Exchange
from orchestrator.trial.player import Player, bits

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
