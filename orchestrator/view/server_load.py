"""Limits of the load that requests put on the event loop, on which the driver's commands arrive as well.

pages         are built at intervals: a build occupies the event loop for some 50 ms, and an authority that
              hears nothing for 250 ms stops the machine
connections   that do not complete the header of a request in time are closed; uvicorn closes a connection
              only after its first response (`timeout_keep_alive`)
"""

import asyncio
import time
from typing import Any

from uvicorn.protocols.http.auto import AutoHTTPProtocol

from orchestrator.view.access import App, Receive, Scope, Send, answer

INTERVAL = 0.5  # s between two page builds: a tenth of the event loop's time
QUEUE = 20  # pages that wait, at most: a class that opens the page at the same time, served within 10 s
AGAIN = "1"  # s after which a browser that was refused loads the page by itself
HEADER_TIME = 10.0  # s for the header of a request; a browser sends it within a round trip
WAITING = 64  # connections without a request; a browser opens up to 6 ahead
REQUESTS = 256  # connections, above which requests are refused with status 503; an open page has two


class PageInterval:
    """Middleware: passes requests for the page on at intervals; above `QUEUE` it refuses them."""

    def __init__(self, app: App, path: str = "/") -> None:
        self._app, self._path, self._next = app, path, 0.0

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Wait for this request's turn."""
        if scope["type"] == "http" and scope["path"] == self._path:
            begin = max(self._next, time.monotonic())
            wait = begin - time.monotonic()
            if wait > QUEUE * INTERVAL:
                message = "many pages are being opened: this one loads again by itself"
                await answer(send, 503, message, (b"refresh", AGAIN.encode()))
                return
            self._next = begin + INTERVAL
            await asyncio.sleep(wait)
        await self._app(scope, receive, send)


class TimedConnection(AutoHTTPProtocol):  # type: ignore[misc, valid-type]
    """An HTTP connection that closes without a complete header after `HEADER_TIME`.

    Of more than `WAITING` connections without a request, the oldest is closed.
    """

    def connection_made(self, transport: asyncio.Transport) -> None:
        """Start the time of the first header."""
        super().connection_made(transport)
        self._opened = self.loop.time()
        waiting = [c for c in self.connections if isinstance(c, TimedConnection) and c.waits]
        if len(waiting) > WAITING:
            min(waiting, key=lambda c: c._opened).transport.close()
        self._watch(None)

    @property
    def waits(self) -> bool:
        """Has no request arrived yet?"""
        return self.cycle is None and not self.transport.is_closing()

    def _watch(self, previous: Any) -> None:
        self.loop.call_later(HEADER_TIME, self._check, previous)

    def _check(self, previous: Any) -> None:
        """Close if no request has arrived since the last check, and none is being answered."""
        if self.transport.is_closing() or self.transport.get_protocol() is not self:  # now a websocket
            return
        if self.cycle is previous and (previous is None or previous.response_complete):
            self.transport.close()
        else:
            self._watch(self.cycle)
