"""The websocket between the sticks in a browser and the pilot: `/controls?seat=KEY`.

A socket of its own beside that of the page, because it must forget: the page's own channel keeps what could
not be sent and delivers it after a reconnection, which is right for a form and wrong for a lever. Here a
message is sent now or never, and the end of the socket is at once the end of driving.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
from collections.abc import AsyncIterator
from dataclasses import asdict

from fastapi import FastAPI, WebSocket, WebSocketDisconnect

from orchestrator.view.safety.pilot import Pilot
from orchestrator.view.safety.seat import Seat

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
