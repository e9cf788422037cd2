"""The page, and the stream of frames to all open pages.

A browser tells which pictures it has drawn. Where more than `AHEAD` are on the way it gets no more until it
has caught up, so a slow one sees fewer pictures, never old ones, and costs the server nothing.
"""

from __future__ import annotations

import asyncio
import logging
import math
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, Protocol

from nicegui import ui

from orchestrator.realtime.setup import Frame
from orchestrator.view.driving.authority import ControlAuthority, OperatorStation
from orchestrator.view.driving.endpoint import mount
from orchestrator.view.panels.bar import Bar
from orchestrator.view.panels.charts import Charts, History
from orchestrator.view.panels.gauges import Gauges, RealTimeFactor, StatusLine, limit
from orchestrator.view.scene.canvas import Canvas, colour, rings
from orchestrator.view.scene.pose import Angles, pose
from orchestrator.view.session import Session
from orchestrator.view.task.training import Training
from orchestrator.view.task.training import mount as task
from orchestrator.view.view_description import SignalIndex


class SharedFigures:
    """Renewed at each look; begins anew with another machine.

    index   the one that the history belongs to
    looks     how many there were
    """

    def __init__(self, session: Session) -> None:
        self._session = session
        self.looks = 0
        self._begin()

    def look(self, frame: Frame) -> None:
        """Before the pages are told."""
        if self.index is not self._session.index:
            self._begin()
        self.looks += 1
        self.history.look()
        self.clock.look(frame)

    def _begin(self) -> None:
        self.index = self._session.index
        self.history = History(self._session.machine, self.index, self._session.plan.description.curves)
        self.clock = RealTimeFactor()


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
    def figures(self, frame: Frame, shared: SharedFigures) -> None: ...


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

    def __init__(self, session: Session, shared: SharedFigures, figures: float = FIGURES) -> None:
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


STYLE = Path(__file__).with_name("page.css")
GREEN = "#2f5a45"
TABLE = "training.csv"
HINT = (
    ("Space", "hold: dead-man"),
    ("W A S D", "left stick"),
    ("arrows", "right stick"),
    ("P", "pause"),
    ("Home", "begin again"),
)
LEVER = "Arrow up (SAE: W) pushes the boom's lever away: boom or tip goes down"
STANDING = {  # what to do about a machine that stands still
    "starting": "starting",
    "paused": "paused: P goes on",
    "ended": "the end: P plays it again",
    "failed": "Home begins again",
}


class Page:
    """One open page; a `Viewer` of the stream."""

    def __init__(
        self, session: Session, stream: Stream, authority: ControlAuthority, training: Training
    ) -> None:
        self._session, self._training = session, training
        self._built = session.plan.description, session.plan.geometry
        self._exchange, self._slow = -1, False
        self._fitted: SignalIndex | None = None
        ui.add_css(STYLE)
        ui.colors(primary=GREEN)
        ui.dark_mode(None)  # as the browser says
        credit = stream.join(self)
        with ui.element("main").classes("view"):
            with ui.element("div").classes("stage"):
                sizes = session.plan.geometry
                self._canvas = Canvas(sizes, credit.shown, stream.refresh) if sizes else None
                with ui.element("section").classes("task") as self._task:
                    self._task.set_visibility(False)
                    table = session.folders[0] / TABLE if session.folders else None
                    self._opened = task(training, table, lambda: self._task.visible)
                self._banner = ui.label().classes("banner").props("role=alert")
            with ui.element("div").classes("hands"):
                station = mount(session.machine, authority, self._save_work)
                _hint()
            with ui.element("aside"):
                self._gauges, self._charts = Gauges(), Charts(session.plan.description.charts)
            with ui.element("header"):
                self._bar = Bar(session, self._canvas, partial(_refusal, authority, station), authority)
                self._bar.extra("sports_score", "Training task", self._toggle, "Task")
            with ui.element("footer"):
                self._line = StatusLine()
        self._client = ui.context.client
        self._client.on_delete(lambda: stream.leave(self))

    @property
    def ready(self) -> bool:
        """The browser has built its scene and listens."""
        drawn = self._canvas is None or self._canvas.ready
        return drawn and bool(self._client.has_socket_connection)

    def picture(self, number: int, frame: Frame) -> bool:
        """The machine; False if it looks as before or has no drawing, so that nothing was sent.

        A joint whose angle is not known stays as at the start.
        """
        session, again = self._session, self._exchange != self._session.machine.exchanges
        self._exchange = session.machine.exchanges
        plan, value = session.plan, partial(session.index.value, frame)
        scene, full = plan.description.scene, plan.description.full_pressure
        if self._canvas is None or scene is None or plan.geometry is None:
            return False
        usual = (plan.start.swing, plan.start.boom, plan.start.stick, 0.0, 0.0)
        angles = [v if math.isfinite(v) else u for v, u in zip(map(value, scene.joints), usual, strict=True)]
        colours = {part: colour(value(name), full) for part, name in scene.pressures.items()}
        return self._canvas.show(number, pose(Angles(*angles), plan.geometry), colours, again)

    def figures(self, frame: Frame, shared: SharedFigures) -> None:
        """Everything else; a machine of other sizes is built anew."""
        plan = self._session.plan
        if self._built != (plan.description, plan.geometry):
            self._built = plan.description, plan.geometry
            self._client.run_javascript("window.location.reload()")
        if self._fitted is not shared.index:
            self._fitted = shared.index
            self._gauges.fit(shared.index, plan.description)
        self._gauges.show(frame, shared.index)
        self._bar.show(frame)
        self._tell(frame)
        if self._canvas is not None:
            self._canvas.marks(self._rings() if self._task.visible else [])
        if shared.looks % 2 == 0:
            held = limit(shared.index, frame)
            self._line.show(frame, shared.clock.factor, self._session.machine.drives, held)
            self._charts.show(shared.history, one=self._slow)

    def _save_work(self) -> None:
        """The browser is slow: a driver needs the sticks more than the charts."""
        self._slow = True

    def _tell(self, frame: Frame) -> None:
        """Over the picture: that it stands still, and why."""
        text = "; ".join(filter(None, (frame.message, STANDING.get(frame.state, ""))))
        self._banner.set_text(text)
        self._banner.set_visibility(bool(text))
        self._banner.classes(**{"add" if frame.state == "failed" else "remove": "bad"})

    def _rings(self) -> list[dict[str, Any]]:
        """The targets that are left."""
        found, left = self._training.exercise, self._training.status()["target"]
        names = [target.name for target in found.targets]
        done = names.index(left["name"]) if left else len(names)
        return rings([target.at for target in found.targets], found.radius, done)

    def _toggle(self) -> None:
        self._task.set_visibility(not self._task.visible)
        self._opened()


def _hint() -> None:
    """The keys that a driver needs first."""
    with ui.element("div").classes("keyhint"):
        for key, meaning in HINT:
            with ui.element("div"):
                ui.label(key).classes("key")
                ui.label(meaning)
        ui.label(LEVER).classes("lever")


def _refusal(authority: ControlAuthority, station: OperatorStation) -> str:
    """Why the page of this station may not decide for all; empty if it may."""
    watching = authority.status(station).role == "watching"
    return "another page drives and decides" if watching else ""
