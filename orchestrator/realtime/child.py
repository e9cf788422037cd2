"""The process of a machine in real time: reads its setup, opens the FMUs, and goes frame by frame."""

from __future__ import annotations

import json
import tempfile
import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from orchestrator.base.errors import Problem
from orchestrator.realtime import shared_memory as b
from orchestrator.realtime.frames import Hand, Limits, Linger
from orchestrator.realtime.pace import Pace, bin_of, urgent
from orchestrator.realtime.process import Task
from orchestrator.realtime.shared_memory import attach
from orchestrator.worker.main import Channel

if TYPE_CHECKING:
    from orchestrator.realtime.frames import Engine

GRACE = 2.0  # [s] for the last frame and for closing the FMUs
LOOK = 0.01  # [s] between two looks at the orders while the machine is paused
SECOND = 1.0  # [s] over which the load is averaged


def main(channel: Channel) -> None:
    """Run until the parent does not need this process any more."""
    task: Task = channel.get()
    channel.grace = GRACE
    tempfile.tempdir = str(channel.folder)  # where the FMUs are unpacked
    board = b.Board(attach(task.address), len(task.setup.axes), len(task.setup.signals), task.rows)
    said: dict[str, Any] = {}
    try:
        _live(task, board, said, lambda: not channel.ended.is_set())
    except Exception as problem:
        text = str(problem) if isinstance(problem, Problem) else f"{type(problem).__name__}: {problem}"
        board.say("failed", json.dumps(said | {"message": " ".join(text.split())}))
    channel.ended.wait()


def _live(task: Task, board: b.Board, said: dict[str, Any], wanted: Callable[[], bool]) -> None:
    """Open the machine, and go on as long as it is wanted."""
    from orchestrator.realtime.frames import Engine

    engine = Engine(task.setup)
    try:
        said |= {"units": dict(engine.units), "notes": [*engine.notes, urgent()]}
        board.put(task.first, engine.t, engine.axes, engine.values)
        with board.writing() as (counts, _):
            counts[b.LAST] = task.first
        board.say("paused", json.dumps(said))
        _loop(engine, task, board, json.dumps(said), wanted)
    finally:
        engine.close()


def _loop(engine: Engine, task: Task, board: b.Board, said: str, wanted: Callable[[], bool]) -> None:
    """One frame after the other, each when it is due."""
    setup, pace, number = task.setup, Pace(), task.first
    limits, linger = Limits(setup.axes, setup.frame), Linger(setup.axes, setup.frame)
    orders = b.Orders(False, 1.0, 0, limits.rest)
    hand, running = Hand(limits.rest, setup.patience, task.serial), False
    while wanted():
        if running:
            pace.wait()
        else:
            time.sleep(LOOK)
        began = time.monotonic()
        orders = board.orders() or orders  # none while they are being written
        board.alive()
        aim, length = hand.wanted(orders, began), setup.frame / orders.speed
        if orders.playing != running:
            running = orders.playing
            board.say("running" if running else "paused", said)
            pace.begin(length)
        elif running:
            now = engine.axes
            engine.advance(limits.toward(now, linger.outlast(now, aim)))
            number += 1
            board.put(number, engine.t, engine.axes, engine.values)
            _tell(board, number, pace, began, length)
            pace.done(length)


def _tell(board: b.Board, number: int, pace: Pace, began: float, length: float) -> None:
    """Let the frame be read, and note how late that is."""
    with board.writing() as (counts, reals):
        now = time.monotonic()
        latency, load = now - pace.due, (now - began) / length
        board.latencies[bin_of(latency)] += 1
        counts[b.LAST] = number
        counts[b.FRAMES] += 1
        counts[b.MISSED] += latency > length
        reals[b.LOAD] += (load - reals[b.LOAD]) * min(length / SECOND, 1.0)
        reals[b.WORST], reals[b.SLIPPED] = max(reals[b.WORST], latency), pace.slipped
