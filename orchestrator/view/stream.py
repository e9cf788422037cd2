"""What all pages show alike and is computed once: the history and the pace.

Frames to the pages: as many as each of them can draw, at most `RATE` a second.

A browser tells which frames it has drawn. Where more than `AHEAD` are on the way it gets no more until it
has caught up, so a slow one sees fewer pictures, never old ones, and costs the server nothing.
"""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import Callable
from typing import Protocol

from orchestrator.realtime.setup import Frame
from orchestrator.view.panels.charts import NAMES, History
from orchestrator.view.panels.gauges import Clock
from orchestrator.view.session import Session


class Shared:
    """Renewed at each look; begins anew with another machine.

    reading   the one that the history belongs to
    looks     how many there were
    """

    def __init__(self, session: Session) -> None:
        self._session = session
        self.looks = 0
        self._begin()

    def look(self, frame: Frame) -> None:
        """Before the pages are told."""
        if self.reading is not self._session.reading:
            self._begin()
        self.looks += 1
        self.history.look()
        self.clock.look(frame)

    def _begin(self) -> None:
        self.reading = self._session.reading
        self.history = History(self._session.machine, self.reading, NAMES)
        self.clock = Clock()


RATE, FIGURES = 25.0, 4.0  # 1/s
AHEAD = 8  # pictures on the way to a browser
LOST = 2.0  # s; after that a picture is taken for lost
log = logging.getLogger(__name__)


class Viewer(Protocol):
    """A page. `picture` sends the machine, if it has moved; `figures` everything else, less often.

    ready   the browser has built its scene
    """

    @property
    def ready(self) -> bool: ...
    def picture(self, number: int, frame: Frame) -> bool: ...
    def figures(self, frame: Frame, shared: Shared) -> None: ...


class Credit:
    """How many pictures are on the way to one browser."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self.sent = self.drawn = 0
        self._heard = clock()

    def next(self) -> int:
        """The number of the next picture, or 0 if there are enough on the way."""
        if self.sent - self.drawn >= AHEAD:
            if self._clock() - self._heard < LOST:
                return 0
            self.drawn = self.sent
        if self.sent == self.drawn:
            self._heard = self._clock()
        return self.sent + 1

    def shown(self, number: int) -> None:
        """The browser has drawn this one."""
        if self.drawn < number <= self.sent:
            self.drawn, self._heard = number, self._clock()


class Stream:
    """Looks at the machine and hands its frames to all viewers."""

    def __init__(self, session: Session, shared: Shared, figures: float = FIGURES) -> None:
        """figures: how often numbers and charts are renewed [1/s]."""
        self._session, self.shared = session, shared
        self._every = max(1, round(RATE / figures))
        self._viewers: dict[Viewer, Credit] = {}
        self._seen: tuple[int, int, str] = (-1, -1, "")
        self._ticks = 0

    def join(self, viewer: Viewer) -> Credit:
        """A page that opens."""
        self._viewers[viewer] = Credit()
        return self._viewers[viewer]

    def refresh(self) -> None:
        """Everybody gets a picture at the next look, also if nothing moves."""
        self._seen = (-1, -1, "")

    def leave(self, viewer: Viewer) -> None:
        """A page that is gone."""
        self._viewers.pop(viewer, None)

    def tick(self) -> None:
        """One look."""
        self._ticks += 1
        slow = self._ticks % self._every == 0
        if not self._viewers or not (slow or self._fresh()):
            return
        frame = self._session.machine.latest()
        if slow:
            self.shared.look(frame)
        for viewer, credit in list(self._viewers.items()):
            try:
                if viewer.ready and (number := credit.next()) and viewer.picture(number, frame):
                    credit.sent = number
                if slow:
                    viewer.figures(frame, self.shared)
            except Exception:  # one broken page must not take the picture from the others
                log.exception("a page takes no frame")
                self.leave(viewer)

    async def run(self) -> None:
        """Until cancelled."""
        due = time.monotonic()
        while True:
            try:
                self.tick()
            except (
                Exception
            ):  # the next look may go well; without this no page would ever get a picture again
                log.exception("a frame is not shown")
            due = max(due + 1 / RATE, time.monotonic() + 0.2 / RATE)
            await asyncio.sleep(due - time.monotonic())

    def _fresh(self) -> bool:
        """Has anything changed since the last look?"""
        frame = self._session.machine.latest()
        now = (self._session.machine.exchanges, frame.number, frame.state)
        changed, self._seen = now != self._seen, now
        return changed
