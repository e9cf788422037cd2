"""The websocket between the sticks in a browser and the authority: `/controls?station=KEY`.

A socket of its own beside that of the page, because it must forget: the page's own channel keeps what could
not be sent and delivers it after a reconnection, which is right for a form and wrong for a lever. Here a
message is sent now or never, and the end of the socket is at once the end of driving.

The controls on the page: sticks, lamp, who drives, pattern and mode.

authority = ControlAuthority(machine)                  # one per server
endpoint.serve(app, authority)              # before the server starts
app.on_startup / lifespan: endpoint.watching(authority)
mount(machine, authority)                   # in each page
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
from orchestrator.view.driving.authority import ControlAuthority, OperatorStation
from orchestrator.view.driving.sticks import PATTERNS

PATH = "/controls"
WATCH = 0.05  # s between two looks of the watchdog
TELL = 0.1  # s between two answers to a page
# a client that had so many messages refused is cut off: 3 s of the fastest honest one
PATIENT = 100


def serve(app: FastAPI, authority: ControlAuthority) -> None:
    """Add the websocket to a server, before it starts."""

    @app.websocket(PATH)
    async def controls(socket: WebSocket) -> None:
        station = authority.station(socket.query_params.get("station", ""))
        if station is None:
            await socket.close(1008, "no such page: load it again")
            return
        await socket.accept()
        connection = authority.connect(station)
        telling = asyncio.create_task(_tell(socket, authority, station, connection))
        try:
            await _listen(socket, authority, station, connection)
        finally:
            telling.cancel()
            authority.disconnect(station, connection)


@contextlib.asynccontextmanager
async def watching(authority: ControlAuthority) -> AsyncIterator[None]:
    """The watchdog runs inside this block; at its end the machine rests."""

    async def watch() -> None:
        while True:
            authority.check()
            await asyncio.sleep(WATCH)

    task = asyncio.create_task(watch())
    try:
        yield
    finally:
        task.cancel()
        authority.stop()


async def _listen(
    socket: WebSocket, authority: ControlAuthority, station: OperatorStation, connection: int
) -> None:
    bad = 0
    while connection == station.connection and bad < PATIENT:
        try:
            event = await socket.receive()
        except (WebSocketDisconnect, RuntimeError):
            return
        if event["type"] != "websocket.receive":
            return
        raw = event.get("text")
        good = authority.hear(station, connection, raw if raw is not None else event.get("bytes") or b"")
        bad = max(0, bad - 1) if good else bad + 1
    with contextlib.suppress(RuntimeError, WebSocketDisconnect):
        await socket.close(1008, "too many messages that do not count" if bad else "opened again elsewhere")


async def _tell(
    socket: WebSocket, authority: ControlAuthority, station: OperatorStation, connection: int
) -> None:
    """What the page shows beside its sticks, ten times a second: also the sign that the server lives."""
    with contextlib.suppress(RuntimeError, WebSocketDisconnect, OSError):
        while connection == station.connection:
            await socket.send_text(json.dumps({"n": station.number, **asdict(authority.status(station))}))
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
    """The part in the browser; it speaks to the authority through its own websocket."""

    def __init__(self, station: OperatorStation) -> None:
        super().__init__()
        self._props.update({"station": station.key, "path": PATH, "legend": {}})

    def label(self, words: dict[str, str]) -> None:
        """What each end of each axis does."""
        if self._props["legend"] != words:
            self._props["legend"] = words
            self.update()


def mount(
    machine: Machine, authority: ControlAuthority, slow: Callable[[], object] = lambda: None
) -> OperatorStation:
    """The controls of one page, at this place of the page; they leave with the page.

    slow   called when the page was too busy to report its sticks
    """
    station = authority.join()
    ui.add_css(STYLE)
    with ui.column().classes("items-center gap-1").mark("controls"):
        sticks = SticksPanel(station)
        sticks.on("slow", lambda _: slow())
        with ui.row().classes("items-center gap-3"):
            take = ui.button(TAKE["free"], on_click=lambda: _take(authority, station, sticks)).mark("take")
            take.classes("take")
            patterns = ui.toggle(list(PATTERNS), on_change=lambda e: _choose(authority, station, e.value))
            modes = ui.toggle([], on_change=lambda e: _choose(authority, station, mode=e.value))
        asked = ui.label().classes("text-caption")
        _key_map()

    def show() -> None:
        status = authority.status(station)
        take.text = TAKE[status.role]
        take.set_enabled(machine.drives and bool(status.modes))
        others = status.asked and status.role == "driving"
        asked.text = "another page asks for the controls" if others else ""
        if modes.options != list(status.modes):
            modes.set_options(list(status.modes))
        for toggle, value in ((patterns, status.pattern), (modes, status.mode)):
            toggle.set_enabled(status.role != "watching")
            if toggle.value != value and value:
                toggle.value = value
        sticks.label(authority.legend)

    show()
    ui.timer(REFRESH, show)
    ui.context.client.on_delete(lambda: authority.leave(station))
    return station


def _key_map() -> None:
    with (
        ui.expansion("Keys").props("dense").classes("w-full text-caption"),
        ui.grid(columns=2).classes("gap-0"),
    ):
        for keys, meaning in KEYS:
            ui.label(keys)
            ui.label(meaning)


def _take(authority: ControlAuthority, station: OperatorStation, sticks: SticksPanel) -> None:
    if authority.status(station).role == "driving":
        authority.release(station)
    elif authority.take(station):
        sticks.run_method("focus")
    else:
        ui.notify("asked; who drives has to let go")


def _choose(
    authority: ControlAuthority,
    station: OperatorStation,
    pattern_name: str | None = None,
    mode: str | None = None,
) -> None:
    status = authority.status(station)
    if (pattern_name or status.pattern, mode or status.mode) == (status.pattern, status.mode):
        return
    try:
        authority.choose(station, pattern_name, mode)
    except Problem as error:
        ui.notify(str(error))
