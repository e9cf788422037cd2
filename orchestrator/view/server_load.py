"""Connections that do not complete the header of a request in time are closed.

uvicorn closes a connection only after its first response (`timeout_keep_alive`).
"""

import asyncio
from typing import Any

from uvicorn.protocols.http.h11_impl import H11Protocol

HEADER_TIME = 10.0  # s for the header of a request; a browser sends it within a round trip
WAITING = 64  # connections without a request; a browser opens up to 6 ahead
REQUESTS = 256  # connections, above which requests are refused with status 503


class TimedConnection(H11Protocol):
    """An HTTP connection that closes without a complete header after `HEADER_TIME`.

    Of more than `WAITING` connections without a request, the oldest is closed.
    """

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
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
