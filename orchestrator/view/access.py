"""Who may talk to the server: an ASGI layer around everything, pages and websockets alike.

Host     a loopback name, an address in figures, or a name that was allowed: a page of a foreign name that
         was made to point here (DNS rebinding) comes with that foreign name
Origin   where it is sent, it must be the page's own host: no foreign page opens a websocket here
token    if one is needed: once in the address, `/?token=...`, then in a cookie that no script reads and no
         other site sends along (HttpOnly, SameSite=Strict)
"""

from __future__ import annotations

import ipaddress
import logging
import secrets
import socket
from collections.abc import Awaitable, Callable, MutableMapping
from dataclasses import dataclass, field
from http.cookies import CookieError, SimpleCookie
from typing import Any
from urllib.parse import parse_qs, parse_qsl, urlencode, urlsplit

Scope = MutableMapping[str, Any]
Receive = Callable[[], Awaitable[MutableMapping[str, Any]]]
Send = Callable[[MutableMapping[str, Any]], Awaitable[None]]
App = Callable[[Scope, Receive, Send], Awaitable[None]]


@dataclass(frozen=True)
class Rules:
    """What is asked of a request. `names`: further names of this host; `token`: empty if none is needed."""

    names: frozenset[str] = field(default_factory=frozenset)
    token: str = ""
    cookie: str = "harvester_view"


def rules(host: str, names: tuple[str, ...] = (), port: int = 0) -> Rules:
    """Rules for a server that listens on `host`: with a fresh token, unless it is a loopback address.

    Cookies are shared by all ports of a host, so the port is part of the cookie's name.
    """
    token = "" if is_loopback(host) else secrets.token_urlsafe(32)
    here = {socket.gethostname()} if token else set()
    own = {name.lower() for name in (host, *names, *here) if name}
    return Rules(frozenset(own), token, f"harvester_view_{port}")


def is_loopback(host: str) -> bool:
    """Whether only this computer can reach a server that listens there."""
    try:
        return ipaddress.ip_address(host.strip("[]")).is_loopback
    except ValueError:
        return host.lower() == "localhost"


class Guard:
    """`app.add_middleware(Guard, rules=rules(host))`."""

    def __init__(self, app: App, rules: Rules) -> None:
        self._app, self._rules = app, rules

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Let the request through, or answer it with one line."""
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        heads = _heads(scope)
        wrong = _foreign(heads, self._rules)
        if wrong:
            await refuse(scope, receive, send, 400, wrong)
        elif not self._rules.token or self._known(heads):
            await self._app(scope, receive, send)
        elif scope["type"] == "http" and self._brings_token(scope):
            await door(scope, send, self._rules.cookie, self._rules.token)
        else:
            told = "open the address with its token, as `harvester view` printed it"
            await refuse(scope, receive, send, 401, told)

    def _known(self, heads: dict[str, list[str]]) -> bool:
        found = SimpleCookie()
        try:
            found.load("; ".join(heads.get("cookie", ())))
        except CookieError:
            return False
        return self._rules.cookie in found and self._equal(found[self._rules.cookie].value)

    def _brings_token(self, scope: Scope) -> bool:
        query = parse_qs(scope.get("query_string", b"").decode("latin-1"))
        return any(self._equal(given) for given in query.get("token", ()))

    def _equal(self, given: str) -> bool:
        return secrets.compare_digest(given.encode(), self._rules.token.encode())


def _heads(scope: Scope) -> dict[str, list[str]]:
    found: dict[str, list[str]] = {}
    for name, value in scope["headers"]:
        found.setdefault(name.decode("latin-1").lower(), []).append(value.decode("latin-1"))
    return found


def _foreign(heads: dict[str, list[str]], rules: Rules) -> str:
    """What is wrong with Host and Origin, or nothing."""
    hosts = heads.get("host", [])
    if len(hosts) != 1 or not _is_ours(_name(hosts[0]), rules):
        return f"Host: expected a name or address of this server, found {_shown(hosts)}"
    origins = heads.get("origin", [])
    if any(_origin(origin) != hosts[0].lower() for origin in origins):
        return f"Origin: expected the page's own host {hosts[0]}, found {_shown(origins)}"
    return ""


def _is_ours(name: str, rules: Rules) -> bool:
    if is_loopback(name) or name in rules.names:
        return True
    try:  # an address in figures cannot be pointed elsewhere; without a token only the loopback is served
        ipaddress.ip_address(name)
    except ValueError:
        return False
    return bool(rules.token)


def _name(host: str) -> str:
    try:
        return (urlsplit(f"//{host}").hostname or "").lower()
    except ValueError:
        return ""


def _origin(origin: str) -> str:
    """`host:port` of an origin; `null` and what is no origin has none."""
    try:
        parts = urlsplit(origin)
    except ValueError:
        return ""
    return parts.netloc.lower() if parts.scheme in ("http", "https") else ""


def _shown(found: list[str]) -> str:
    return ascii(", ".join(found))[:80] if found else "none"


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


LIBRARIES = ("asyncio", "engineio.server", "socketio.server", "uvicorn.error")


def shorten() -> None:
    """From now on in one line each; may be repeated. What is ours has loggers of its own, with everything."""
    for name in LIBRARIES:
        logging.getLogger(name).addFilter(_one_line)


def _one_line(record: logging.LogRecord) -> bool:
    """Keeps the first line and the name of the error; the terminal cannot be filled by a page."""
    error = record.exc_info[1] if record.exc_info else None
    record.msg = record.getMessage().partition("\n")[0]
    if error is not None:
        record.msg += f": {type(error).__name__}"
    record.args, record.exc_info, record.exc_text = (), None, None
    return True
