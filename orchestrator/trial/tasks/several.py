"""More than one instance: side by side, and in threads."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor

from orchestrator.trial.bench import Bench, Said
from orchestrator.trial.binary import Refused
from orchestrator.trial.player import Player, bits

STEPS = 12
THREADS = 4


def instances(bench: Bench) -> Iterator[Said]:
    """Runs one after the other and side by side give the same bits as a run alone."""
    alone = _alone(bench, 0)
    other = _alone(bench, 5)
    again = _alone(bench, 0)
    if bits(alone) != bits(again):
        yield "error", f"a second run in the same process differs: {bench.difference(alone, again)}"
        return
    try:
        first, second = bench.player().begin(), bench.player(name="second").begin()
    except Refused as refusal:
        yield "error", f"a second instance cannot be made: {refusal}"
        return
    rows: tuple[list[list[float]], list[list[float]]] = ([first.row()], [second.row()])
    for n in range(STEPS):  # the second one is a step behind
        rows[0].append(_one(bench, first, n))
        rows[1].append(_one(bench, second, n + 5))
    for found, expected, which in ((rows[0], alone, "first"), (rows[1], other, "second")):
        if bits(found) != bits(expected):
            text = bench.difference(expected, found)
            yield "error", f"two instances disturb each other: in the {which} {text}"
            return


def _one(bench: Bench, player: Player, shift: int) -> list[float]:
    if bench.pokes:
        player.poke(shift)
    player.advance()
    return player.row()


def _alone(bench: Bench, shift: int, count: int = STEPS) -> list[list[float]]:
    player = bench.player().begin()
    rows = [player.row()]
    for n in range(count):
        if player.instance.ended:
            break
        rows.append(_one(bench, player, n + shift))
    player.close()
    return rows


def threads(bench: Bench) -> Iterator[Said]:
    """Instances in threads of their own give the serial bits."""
    count = 60
    serial = [_alone(bench, n, count) for n in range(THREADS)]
    before = sys.getswitchinterval()
    sys.setswitchinterval(1e-5)  # change threads between almost all calls
    with ThreadPoolExecutor(THREADS) as pool:
        parallel = list(pool.map(lambda n: _alone(bench, n, count), range(THREADS)))
    sys.setswitchinterval(before)
    for n in range(THREADS):
        if bits(serial[n]) != bits(parallel[n]):
            text = bench.difference(serial[n], parallel[n])
            yield "error", f"{THREADS} instances in {THREADS} threads: {text}"
            return
