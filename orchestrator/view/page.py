"""The page: the machine, its numbers, the bar, and the controls."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

from nicegui import ui

from orchestrator.realtime.setup import Frame
from orchestrator.view.driving.endpoint import mount
from orchestrator.view.driving.pilot import Pilot, Seat
from orchestrator.view.panels.bar import Bar
from orchestrator.view.panels.charts import Charts
from orchestrator.view.panels.gauges import Gauges, Line, limit
from orchestrator.view.readings import Reading
from orchestrator.view.scene.canvas import Canvas, rings
from orchestrator.view.session import Session
from orchestrator.view.stream import Shared, Stream
from orchestrator.view.task.training import Training
from orchestrator.view.task.training import mount as task

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

    def __init__(self, session: Session, stream: Stream, pilot: Pilot, training: Training) -> None:
        self._session, self._training = session, training
        self._geometry = session.plan.geometry
        self._exchange, self._slow = -1, False
        self._fitted: Reading | None = None
        ui.add_css(STYLE)
        ui.colors(primary=GREEN)
        ui.dark_mode(None)  # as the browser says
        credit = stream.join(self)
        with ui.element("main").classes("view"):
            with ui.element("div").classes("stage"):
                self._canvas = Canvas(session.plan.geometry, credit.shown, stream.refresh)
                with ui.element("section").classes("task") as self._task:
                    self._task.set_visibility(False)
                    table = session.folders[0] / TABLE if session.folders else None
                    self._opened = task(training, table, lambda: self._task.visible)
                self._banner = ui.label().classes("banner").props("role=alert")
            with ui.element("div").classes("hands"):
                seat = mount(session.machine, pilot, self._save_work)
                _hint()
            with ui.element("aside"):
                self._gauges, self._charts = Gauges(), Charts()
            with ui.element("header"):
                self._bar = Bar(session, self._canvas, partial(_refusal, pilot, seat), pilot)
                self._bar.extra("sports_score", "Training task", self._toggle, "Task")
            with ui.element("footer"):
                self._line = Line()
        self._client = ui.context.client
        self._client.on_delete(lambda: stream.leave(self))

    @property
    def ready(self) -> bool:
        """The browser has built its scene and listens."""
        return self._canvas.ready and bool(self._client.has_socket_connection)

    def picture(self, number: int, frame: Frame) -> bool:
        """The machine; False if it looks as before, so that nothing was sent."""
        session, again = self._session, self._exchange != self._session.machine.exchanges
        self._exchange = session.machine.exchanges
        pose = session.reading.pose(frame, session.plan.geometry, session.plan.start)
        return self._canvas.show(number, pose, session.reading.colours(frame), again)

    def figures(self, frame: Frame, shared: Shared) -> None:
        """Everything else; a machine of other sizes is built anew."""
        if self._geometry != self._session.plan.geometry:
            self._geometry = self._session.plan.geometry
            self._client.run_javascript("window.location.reload()")
        if self._fitted is not shared.reading:
            self._fitted = shared.reading
            self._gauges.fit(shared.reading)
        self._gauges.show(frame, shared.reading)
        self._bar.show(frame)
        self._tell(frame)
        self._canvas.marks(self._rings() if self._task.visible else [])
        if shared.looks % 2 == 0:
            held = limit(shared.reading, frame)
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


def _refusal(pilot: Pilot, seat: Seat) -> str:
    """Why the page of this seat may not decide for all; empty if it may."""
    watching = pilot.status(seat).role == "watching"
    return "another page drives and decides" if watching else ""
