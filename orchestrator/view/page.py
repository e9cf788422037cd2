"""The page, and the stream of frames to all open pages.

A browser acknowledges the pictures that it has drawn. While `AHEAD` pictures are not acknowledged it gets no
further ones. So a slow browser shows fewer pictures, but no outdated ones, and does not load the server.
"""

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
from orchestrator.scene.drawing import colour, rings
from orchestrator.scene.view_description import ViewDescription
from orchestrator.view.driving.authority import ControlAuthority, OperatorStation
from orchestrator.view.driving.endpoint import mount
from orchestrator.view.panels.bar import Bar
from orchestrator.view.panels.charts import Charts, History
from orchestrator.view.panels.gauges import Gauges, RealTimeFactor, StatusLine, tip_limit
from orchestrator.view.scene.canvas import Canvas
from orchestrator.view.session import Session, SignalIndex
from orchestrator.view.task.training import Training
from orchestrator.view.task.training import mount as task


class SharedFigures:
    """Figures that all pages show: history of the charts and real-time factor. Reset for another machine.

    index   index of the signals that the history belongs to
    looks   number of updates
    """

    def __init__(self, session: Session) -> None:
        self._session = session
        self.looks = 0
        self._begin()

    def look(self, frame: Frame) -> None:
        """Update from a frame, before the pages show it."""
        if self.index is not self._session.index:
            self._begin()
        self.looks += 1
        self.history.look()
        self.clock.look(frame)

    def _begin(self) -> None:
        self.index = self._session.index
        self.history = History(self._session.machine, self.index, self._session.plan.description.curves)
        self.clock = RealTimeFactor()


RATE, FIGURES = 25.0, 4.0  # 1/s; rates of pictures and of figures
AHEAD = 8  # pictures sent to a browser and not yet drawn, at most
LOST = 2.0  # s; after this time without an acknowledgement, pictures count as lost
log = logging.getLogger(__name__)


class Viewer(Protocol):
    """Interface of a page. `picture` sends a pose that has changed; `figures` sends all else, less often.

    ready   True when the browser has built its scene
    """

    @property
    def ready(self) -> bool: ...
    def picture(self, number: int, frame: Frame) -> bool: ...
    def figures(self, frame: Frame, shared: SharedFigures) -> None: ...


class Credit:
    """Flow control for one browser: number of pictures sent and drawn."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self.sent = self.drawn = 0
        self._heard = clock()

    def next(self) -> int:
        """Number of the next picture, or 0 if the browser must catch up first."""
        if self.sent - self.drawn >= AHEAD:
            if self._clock() - self._heard < LOST:
                return 0
            self.drawn = self.sent
        if self.sent == self.drawn:
            self._heard = self._clock()
        return self.sent + 1

    def shown(self, number: int) -> None:
        """The browser has drawn this picture."""
        if self.drawn < number <= self.sent:
            self.drawn, self._heard = number, self._clock()


class Stream:
    """Reads frames of the machine and sends them to all viewers."""

    def __init__(self, session: Session, shared: SharedFigures, figures: float = FIGURES) -> None:
        """figures: rate at which gauges and charts are updated [1/s]."""
        self._session, self.shared = session, shared
        self._every = max(1, round(RATE / figures))
        self._viewers: dict[Viewer, Credit] = {}
        self._seen: tuple[int, int, str] = (-1, -1, "")
        self._ticks = 0

    def join(self, viewer: Viewer) -> Credit:
        """Add a page."""
        self._viewers[viewer] = Credit()
        return self._viewers[viewer]

    def refresh(self) -> None:
        """Send a picture to all pages at the next tick, even if nothing has changed."""
        self._seen = (-1, -1, "")

    def leave(self, viewer: Viewer) -> None:
        """Remove a page."""
        self._viewers.pop(viewer, None)

    def tick(self) -> None:
        """Read the machine once and update the pages."""
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
            except Exception:  # an error of one page must not affect the others
                log.exception("a frame could not be sent to a page")
                self.leave(viewer)

    async def run(self) -> None:
        """Tick until cancelled."""
        due = time.monotonic()
        while True:
            try:
                self.tick()
            except Exception:  # otherwise one error would stop the pictures of all pages for good
                log.exception("a frame could not be shown")
            due = max(due + 1 / RATE, time.monotonic() + 0.2 / RATE)
            await asyncio.sleep(due - time.monotonic())

    def _fresh(self) -> bool:
        """Has the frame or the machine changed since the last tick?"""
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
    ("Arrows", "right stick"),
    ("P", "pause"),
    ("Home", "start again"),
)
LEVER = "Arrow up (SAE: W) pushes the boom's lever away: boom or tip goes down"
STANDING = {  # banner for each state in which the machine does not move
    "starting": "starting",
    "paused": "paused: press P to continue",
    "ended": "end of the replay: press P to repeat it",
    "failed": "press Home to start again",
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
        ui.dark_mode(None)  # as set in the browser, the picture of the machine included
        ui.run_javascript("document.documentElement.lang = 'en'")
        credit = stream.join(self)
        ui.html('<a class="skip" href="#drive">Skip to the controls</a>', sanitize=False)
        with ui.element("div").classes("view"):
            with ui.element("section").classes("stage").props('aria-label="Machine"'):
                sizes = session.plan.geometry
                self._canvas = Canvas(sizes, credit.shown, stream.refresh) if sizes else None
                with ui.element("section").classes("task").props('aria-label="Training task"') as self._task:
                    self._task.set_visibility(False)
                    table = session.folders[0] / TABLE if session.folders else None
                    self._opened = task(training, table, lambda: self._task.visible)
                self._banner = ui.label().classes("banner").props("role=alert")
            with ui.element("section").classes("hands").props('id=drive tabindex=-1 aria-label="Controls"'):
                station = mount(session.machine, authority, self._reduce_load)
                _hint()
            with ui.element("aside").props('tabindex=0 aria-label="Gauges and charts"'):
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
        """Has the browser built its scene, and is it connected?"""
        drawn = self._canvas is None or self._canvas.ready
        return drawn and bool(self._client.has_socket_connection)

    def picture(self, number: int, frame: Frame) -> bool:
        """Send the pose. Returns False if it has not changed or there is no drawing, so that nothing was
        sent.

        A joint without a known angle keeps its initial angle.
        """
        session, again = self._session, self._exchange != self._session.machine.exchanges
        self._exchange = session.machine.exchanges
        plan, value = session.plan, partial(session.index.value, frame)
        scene, full = plan.description.scene, plan.description.full_pressure
        if self._canvas is None or scene is None or plan.geometry is None:
            return False
        initial = (plan.start.swing, plan.start.boom, plan.start.stick, 0.0, 0.0)
        angles = [
            v if math.isfinite(v) else u for v, u in zip(map(value, scene.joints), initial, strict=True)
        ]
        colours = {part: colour(value(name), full) for part, name in scene.pressures.items()}
        return self._canvas.show(number, angles, colours, again)

    def figures(self, frame: Frame, shared: SharedFigures) -> None:
        """Update all but the drawing. For another geometry the page is loaded again.

        A page that is not connected is left out: a hundred of them would occupy the event loop.
        """
        if not self._client.has_socket_connection:
            return
        plan = self._session.plan
        if self._built != (plan.description, plan.geometry):
            self._built = plan.description, plan.geometry
            self._client.run_javascript("window.location.reload()")
        if self._fitted is not shared.index:
            self._fitted = shared.index
            self._gauges.fit(shared.index, plan.description)
            self._charts.fit(shared.index)
        self._gauges.show(frame, shared.index)
        self._bar.show(frame)
        self._show_banner(frame, shared.index)
        if self._canvas is not None:
            self._canvas.marks(self._rings() if self._task.visible else [])
        if shared.looks % 2 == 0:
            limited = tip_limit(shared.index, frame)
            self._line.show(frame, shared.clock.factor, self._session.machine.drives, limited)
            self._charts.show(shared.history, one=self._slow)

    def _reduce_load(self) -> None:
        """Update one chart at a time, for a slow browser: a driver needs the sticks more than charts."""
        self._slow = True

    def _show_banner(self, frame: Frame, index: SignalIndex) -> None:
        """Show over the drawing why the machine does not move."""
        ends = notices(self._session.plan.description, index, frame)
        text = "; ".join(filter(None, (frame.message, STANDING.get(frame.state, ""), *ends)))
        self._banner.set_text(text)
        self._banner.set_visibility(bool(text))
        self._banner.classes(**{"add" if frame.state == "failed" else "remove": "bad"})

    def _rings(self) -> list[dict[str, Any]]:
        """Rings of the remaining targets."""
        exercise, target = self._training.exercise, self._training.status()["target"]
        names = [t.name for t in exercise.targets]
        done = names.index(target["name"]) if target else len(names)
        return rings([t.at for t in exercise.targets], exercise.radius, done)

    def _toggle(self) -> None:
        self._task.set_visibility(not self._task.visible)
        self._opened()


def notices(description: ViewDescription, index: SignalIndex, frame: Frame) -> list[str]:
    """Texts of the notices whose signal is above its value; none if the machine lacks the signal."""
    return [n.text for n in description.notices if abs(index.value(frame, n.name)) > n.above]


def _hint() -> None:
    """Show the keys that a driver needs first."""
    with ui.element("div").classes("keyhint"):
        for key, meaning in HINT:
            with ui.element("div"):
                ui.label(key).classes("key")
                ui.label(meaning)
        ui.label(LEVER).classes("lever")


def _refusal(authority: ControlAuthority, station: OperatorStation) -> str:
    """Reason why this page may not change what all pages show; empty if it may."""
    watching = authority.status(station).role == "watching"
    return "another page drives the machine and decides" if watching else ""
