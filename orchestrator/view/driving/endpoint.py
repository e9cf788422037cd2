"""The controls on the page, and the websocket between its sticks and the authority: `/controls?station=KEY`.

The controls have a websocket of their own. The channel of the page keeps messages that could not be sent and
delivers them after a reconnection, which is right for a form and wrong for a lever. Here a message is sent at
once or dropped, and the end of the connection ends driving.

    authority = ControlAuthority(machine, modes)   one per server
    serve(app, authority)                          before the server starts
    async with watching(authority): ...            while the server runs
    mount(machine, authority)                      in each page
"""

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
WATCH = 0.05  # s between two checks of the watchdog
TELL = 0.1  # s between two status messages to a page
PATIENT = 100  # ignored messages after which a client is disconnected: 3 s at the usual rate


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
        sending = asyncio.create_task(_send_status(socket, authority, station, connection))
        try:
            await _listen(socket, authority, station, connection)
        finally:
            sending.cancel()
            authority.disconnect(station, connection)


@contextlib.asynccontextmanager
async def watching(authority: ControlAuthority) -> AsyncIterator[None]:
    """Run the watchdog inside this block. At its end the machine rests."""

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
    ignored = 0
    while connection == station.connection and ignored < PATIENT:
        try:
            event = await socket.receive()
        except (WebSocketDisconnect, RuntimeError):
            return
        if event["type"] != "websocket.receive":
            return
        raw = event.get("text")
        accepted = authority.hear(station, connection, raw if raw is not None else event.get("bytes") or b"")
        ignored = max(0, ignored - 1) if accepted else ignored + 1
    with contextlib.suppress(RuntimeError, WebSocketDisconnect):
        await socket.close(1008, "too many invalid messages" if ignored else "opened again elsewhere")


async def _send_status(
    socket: WebSocket, authority: ControlAuthority, station: OperatorStation, connection: int
) -> None:
    """Send the status to the page ten times a second; it is also the heartbeat of the server."""
    with contextlib.suppress(RuntimeError, WebSocketDisconnect, OSError):
        while connection == station.connection:
            await socket.send_text(json.dumps({"n": station.number, **asdict(authority.status(station))}))
            await asyncio.sleep(TELL)


LIBRARY = {"harvester-sticks": "assets/lib"}
REFRESH = 0.2  # s
TAKE = {"driving": "Release controls", "watching": "Request controls", "free": "Take controls"}
KEYS = (
    ("Space or Shift, held", "dead-man: the machine rests without it"),
    ("W A S D", "left stick"),
    ("Arrows or I J K L", "right stick"),
    ("Esc", "focus back to the sticks"),
    ("gamepad", "both sticks; a bumper is the dead-man"),
    ("touch or mouse", "drag the sticks; holding one is the dead-man"),
)
STYLE = Path(__file__).with_name("assets") / "sticks.css"


class SticksPanel(Element, component="assets/sticks.js", esm=LIBRARY):
    """The sticks in the browser; they use the websocket of the controls."""

    def __init__(self, station: OperatorStation) -> None:
        super().__init__()
        self._props.update({"station": station.key, "path": PATH, "legend": {}})

    def label(self, labels: dict[str, str]) -> None:
        """Set the labels of both ends of each axis."""
        if self._props["legend"] != labels:
            self._props["legend"] = labels
            self.update()


def mount(
    machine: Machine, authority: ControlAuthority, slow: Callable[[], object] = lambda: None
) -> OperatorStation:
    """Add the controls to the current page. They are removed with the page.

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
            patterns.props('no-caps role=group aria-label="Control pattern"')
            modes = ui.toggle({}, on_change=lambda e: _choose(authority, station, mode=e.value))
            modes.props('no-caps role=group aria-label="What the sticks move"')
        asked = ui.label().classes("text-caption")
        _key_map()

    def show() -> None:
        status = authority.status(station)
        take.text = TAKE[status.role]
        take.set_enabled(machine.drives and bool(status.modes))
        requested = status.asked and status.role == "driving"
        asked.text = "another page requests the controls" if requested else ""
        if list(modes.options) != list(status.modes):
            modes.set_options({mode: mode.capitalize() for mode in status.modes})
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
        ui.notify("requested; the driver has to release the controls")


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
