"""From one start of a live machine to the next: its process, and all that is known of its frames."""

from __future__ import annotations

import json
import time
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orchestrator.files.trace import Trace
from orchestrator.live.board import HEAD, NUMBER, TIME, Board, News, size
from orchestrator.live.latency import quantile
from orchestrator.live.memory import Memory
from orchestrator.live.process import Process
from orchestrator.live.setup import Array, Frame, Pulse, Setup

KEPT = 1800.0  # [s] of frames that are kept
MOST = 256 << 20  # bytes that they may take
MARGIN = 200  # of the oldest frames, which may be overwritten while they are read
SILENT = 5.0  # [s] without a sign of life: an FMU does not return


class Session:
    """One session. Memory for all of its frames is reserved, and taken as it fills.

    board    the shared memory, which stays readable when the process has ended
    closed   it was ended on purpose
    """

    def __init__(self, setup: Setup, first: int, serial: int) -> None:
        """first: number of the first frame; serial: of the last command that is not for this session."""
        self.setup, self.first, self.closed = setup, first, False
        self.axes = tuple(axis.name for axis in setup.axes)
        sizes = len(setup.axes), len(setup.signals)
        rows = max(2, min(int(KEPT / setup.frame), MOST // (8 * (HEAD + sum(sizes)))))
        memory = Memory(size(*sizes, rows))
        self.board = Board(memory.map, *sizes, rows)
        self._process = Process(setup, memory, rows, first, serial)
        self._beat, self._heard = -1, time.monotonic()

    def close(self) -> None:
        """End the process. May be repeated."""
        self.closed = True
        self._process.end()

    @property
    def pid(self) -> int:
        """Number of its process."""
        return self._process.pid

    # ---- what there is to say

    @property
    def units(self) -> Mapping[str, str]:
        """Of axes and signals; empty until the machine is ready."""
        return dict(_said(self.board.news()).get("units", {}))

    @property
    def notes(self) -> tuple[str, ...]:
        """How it runs, what it could not keep up with, and what is no longer kept."""
        news = self.board.news()
        notes = [str(note) for note in _said(news).get("notes", ())]
        if news.slipped > 0:
            notes.append(f"the machine could not keep up: its clock was stopped for {news.slipped:.3g} s")
        if (lost := self._oldest(news) - self.first) > 0:
            notes.append(f"the first {lost} frames are no longer in memory")
        return tuple(notes)

    # ---- frames

    def latest(self) -> Frame:
        """What is known now."""
        news, n = self.board.news(), len(self.axes)
        known = news.last >= self.first
        row = self._row(news.last) if known else np.full(self.board.rows.shape[1], np.nan)
        number = news.last if known else self.first - 1
        state, message = self._state(news)
        axes, values = row[HEAD : HEAD + n], row[HEAD + n :]
        return Frame(number, float(row[TIME]), axes, values, state, message, _pulse(news))

    def since(self, number: int) -> tuple[NDArray[np.int64], Array, Array, Array]:
        """Numbers (n,), times (n,), axes (n, axes), values (n, signals) of the frames after a number."""
        news, rows, n = self.board.news(), self.board.rows, len(self.axes)
        begin = max(number + 1, self._oldest(news))
        numbers = np.arange(begin, max(news.last + 1, begin))
        found = rows[numbers % len(rows)]
        kept = found[:, NUMBER] == numbers  # but for those that were overwritten in the meantime
        found = found[kept]
        return numbers[kept], found[:, TIME], found[:, HEAD : HEAD + n], found[:, HEAD + n :]

    def trace(self) -> Trace:
        """All frames that are in memory: axes and signals over time."""
        _, times, axes, values = self.since(-1)
        table = dict(zip(self.axes, np.ascontiguousarray(axes.T), strict=True))
        table |= dict(zip(self.setup.signals, np.ascontiguousarray(values.T), strict=True))
        return Trace(np.ascontiguousarray(times), table, self.units)

    def _row(self, number: int) -> Array:
        return np.array(self.board.rows[number % len(self.board.rows)])

    def _oldest(self, news: News) -> int:
        """Number of the first frame that is in memory."""
        room = len(self.board.rows)
        full = news.last - self.first >= room
        return news.last - room + 1 + min(MARGIN, room // 4) if full else self.first

    def _state(self, news: News) -> tuple[str, str]:
        """The state, and why it failed: it says so itself, or it ended, or it is silent."""
        if news.state == "failed":
            return "failed", str(_said(news).get("message", ""))
        if self.closed:
            return "ended", ""
        if fate := self._process.fate:
            return "failed", fate
        now = time.monotonic()
        if news.beat != self._beat or news.state == "starting":
            self._beat, self._heard = news.beat, now
        if (silent := now - self._heard) > SILENT:
            return "failed", f"the machine has not answered for {silent:.0f} s"
        return news.state, ""


def _said(news: News) -> dict[str, Any]:
    """What the process said of itself; nothing if it died over it."""
    try:
        return dict(json.loads(news.text or "{}"))
    except ValueError:
        return {}


def _pulse(news: News) -> Pulse:
    middle, most = (min(quantile(news.latencies, share), news.worst) for share in (0.5, 0.99))
    return Pulse(news.frames, news.missed, (middle, most, news.worst), news.load)
