"""The websocket between the sticks in a browser and the pilot: `/controls?seat=KEY`.

A socket of its own beside that of the page, because it must forget: the page's own channel keeps what could
not be sent and delivers it after a reconnection, which is right for a form and wrong for a lever. Here a
message is sent now or never, and the end of the socket is at once the end of driving.

The controls on the page: sticks, lamp, who drives, pattern and mode.

pilot = Pilot(machine)                  # one per server
endpoint.serve(app, pilot)              # before the server starts
app.on_startup / lifespan: endpoint.watching(pilot)
mount(machine, pilot)                   # in each page
"""

from __future__ import annotations

import asyncio
import contextlib
import json
from collections.abc import AsyncIterator, Callable
from dataclasses import asdict
from pathlib import Path

from fastapi import FastAPI, WebSocket, WebSocketDisconnect
from nicegui import ui
from nicegui.element import Element

from orchestrator.base.errors import Problem
from orchestrator.realtime.setup import Machine
from orchestrator.view.driving.pilot import Pilot, Seat
from orchestrator.view.driving.sticks import PATTERNS, legend, pattern

PATH = "/controls"
WATCH = 0.05  # s between two looks of the watchdog
TELL = 0.1  # s between two answers to a page
# a client that had so many messages refused is cut off: 3 s of the fastest honest one
PATIENT = 100


def serve(app: FastAPI, pilot: Pilot) -> None:
    """Add the websocket to a server, before it starts."""

    @app.websocket(PATH)
    async def controls(socket: WebSocket) -> None:
        seat = pilot.seat(socket.query_params.get("seat", ""))
        if seat is None:
            await socket.close(1008, "no such page: load it again")
            return
        await socket.accept()
        connection = pilot.connect(seat)
        telling = asyncio.create_task(_tell(socket, pilot, seat, connection))
        try:
            await _listen(socket, pilot, seat, connection)
        finally:
            telling.cancel()
            pilot.disconnect(seat, connection)


@contextlib.asynccontextmanager
async def watching(pilot: Pilot) -> AsyncIterator[None]:
    """The watchdog runs inside this block; at its end the machine rests."""

    async def watch() -> None:
        while True:
            pilot.check()
            await asyncio.sleep(WATCH)

    task = asyncio.create_task(watch())
    try:
        yield
    finally:
        task.cancel()
        pilot.stop()


async def _listen(socket: WebSocket, pilot: Pilot, seat: Seat, connection: int) -> None:
    bad = 0
    while connection == seat.connection and bad < PATIENT:
        try:
            event = await socket.receive()
        except (WebSocketDisconnect, RuntimeError):
            return
        if event["type"] != "websocket.receive":
            return
        raw = event.get("text")
        good = pilot.hear(seat, connection, raw if raw is not None else event.get("bytes") or b"")
        bad = max(0, bad - 1) if good else bad + 1
    with contextlib.suppress(RuntimeError, WebSocketDisconnect):
        await socket.close(1008, "too many messages that do not count" if bad else "opened again elsewhere")


async def _tell(socket: WebSocket, pilot: Pilot, seat: Seat, connection: int) -> None:
    """What the page shows beside its sticks, ten times a second: also the sign that the server lives."""
    with contextlib.suppress(RuntimeError, WebSocketDisconnect, OSError):
        while connection == seat.connection:
            await socket.send_text(json.dumps({"n": seat.number, **asdict(pilot.status(seat))}))
            await asyncio.sleep(TELL)


LIBRARY = {"harvester-sticks": "assets/lib"}
REFRESH = 0.2  # s
TAKE = {"driving": "Let go", "watching": "Ask for controls", "free": "Take controls"}
KEYS = (
    ("Space or Shift, held", "dead-man: without it the machine rests"),
    ("W A S D", "left stick"),
    ("arrows or I J K L", "right stick"),
    ("Esc", "back from a button to the sticks"),
    ("gamepad", "both sticks, a bumper is the dead-man"),
    ("touch or mouse", "on the sticks; holding one is the dead-man"),
)
STYLE = Path(__file__).with_name("assets") / "sticks.css"


class SticksPanel(Element, component="assets/sticks.js", esm=LIBRARY):
    """The part in the browser; it speaks to the pilot through its own websocket."""

    def __init__(self, seat: Seat) -> None:
        super().__init__()
        self._props.update({"seat": seat.key, "path": PATH, "legend": {}})

    def label(self, words: dict[str, str]) -> None:
        """What each end of each axis does."""
        if self._props["legend"] != words:
            self._props["legend"] = words
            self.update()


def mount(machine: Machine, pilot: Pilot, slow: Callable[[], object] = lambda: None) -> Seat:
    """The controls of one page, at this place of the page; they leave with the page.

    slow   called when the page was too busy to say what the hands do
    """
    seat = pilot.join()
    ui.add_css(STYLE)
    with ui.column().classes("items-center gap-1").mark("controls"):
        sticks = SticksPanel(seat)
        sticks.on("slow", lambda _: slow())
        with ui.row().classes("items-center gap-3"):
            take = ui.button(TAKE["free"], on_click=lambda: _take(pilot, seat, sticks)).mark("take")
            take.classes("take")
            patterns = ui.toggle(list(PATTERNS), on_change=lambda e: _choose(pilot, seat, e.value))
            modes = ui.toggle([], on_change=lambda e: _choose(pilot, seat, mode=e.value))
        asked = ui.label().classes("text-caption")
        _key_map()

    def show() -> None:
        status = pilot.status(seat)
        take.text = TAKE[status.role]
        take.set_enabled(machine.drives)
        others = status.asked and status.role == "driving"
        asked.text = "another page asks for the controls" if others else ""
        if modes.options != list(status.modes):
            modes.set_options(list(status.modes))
        for toggle, value in ((patterns, status.pattern), (modes, status.mode)):
            toggle.set_enabled(status.role != "watching")
            if toggle.value != value and value:
                toggle.value = value
        sticks.label(legend(pattern(status.pattern), status.mode))

    show()
    ui.timer(REFRESH, show)
    ui.context.client.on_delete(lambda: pilot.leave(seat))
    return seat


def _key_map() -> None:
    with (
        ui.expansion("Keys").props("dense").classes("w-full text-caption"),
        ui.grid(columns=2).classes("gap-0"),
    ):
        for keys, meaning in KEYS:
            ui.label(keys)
            ui.label(meaning)


def _take(pilot: Pilot, seat: Seat, sticks: SticksPanel) -> None:
    if pilot.status(seat).role == "driving":
        pilot.release(seat)
    elif pilot.take(seat):
        sticks.run_method("focus")
    else:
        ui.notify("asked; who drives has to let go")


def _choose(pilot: Pilot, seat: Seat, pattern_name: str | None = None, mode: str | None = None) -> None:
    status = pilot.status(seat)
    if (pattern_name or status.pattern, mode or status.mode) == (status.pattern, status.mode):
        return
    try:
        pilot.choose(seat, pattern_name, mode)
    except Problem as error:
        ui.notify(str(error))
