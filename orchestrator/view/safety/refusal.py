"""Answers without a page: a refusal in one line, and the door where a token becomes a cookie."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, MutableMapping
from typing import Any
from urllib.parse import parse_qsl, urlencode

Scope = MutableMapping[str, Any]
Receive = Callable[[], Awaitable[MutableMapping[str, Any]]]
Send = Callable[[MutableMapping[str, Any]], Awaitable[None]]

# the address with the token stays out of caches and out of what other sites are told
QUIET = [(b"cache-control", b"no-store"), (b"referrer-policy", b"no-referrer")]


async def refuse(scope: Scope, receive: Receive, send: Send, status: int, text: str) -> None:
    """Tell why in one line; a websocket is closed before it is open (the browser sees 403)."""
    if scope["type"] == "websocket":
        await receive()
        await send({"type": "websocket.close", "code": 1008, "reason": text[:100]})
    else:
        await _answer(send, status, f"{text}\n", [(b"content-type", b"text/plain; charset=utf-8"), *QUIET])


async def door(scope: Scope, send: Send, cookie: str, token: str) -> None:
    """Set the cookie and go on to the same address without the token.

    A page that moves on by itself, not a redirect: after a click on a link elsewhere, a redirect would still
    belong to that other site, and a SameSite=Strict cookie would not be sent with it.
    """
    rest = [(k, v) for k, v in parse_qsl(scope.get("query_string", b"").decode("latin-1")) if k != "token"]
    # a relative address stays on this host, whatever the path was
    there = f"?{urlencode(rest)}" if rest else "."
    page = f'<!doctype html><meta http-equiv="refresh" content="0; url={there}"><title>harvester</title>\n'
    keep = f"{cookie}={token}; Path=/; HttpOnly; SameSite=Strict".encode()
    heads = [(b"content-type", b"text/html; charset=utf-8"), (b"set-cookie", keep), *QUIET]
    await _answer(send, 200, page, heads)


async def _answer(send: Send, status: int, text: str, heads: list[tuple[bytes, bytes]]) -> None:
    body = text.encode()
    length = (b"content-length", str(len(body)).encode())
    await send({"type": "http.response.start", "status": status, "headers": [*heads, length]})
    await send({"type": "http.response.body", "body": body})
