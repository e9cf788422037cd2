"""Access control of the server: an ASGI middleware that checks each request for a page or a websocket.

Host     must be a loopback name, a numeric address or an allowed name; a page under a foreign name that
         resolves to this computer (DNS rebinding) is refused
method   GET or HEAD without content, which could be slow to arrive; the page's own messages come over
         websockets
Origin   if present, must be the page's own host, so that no foreign page opens a websocket
site     a request that another site has caused (link, image, frame, script) is refused, by Sec-Fetch-Site. A
         browser that does not send it is judged by Referer
purpose  nothing is built ahead, before the user has asked for it (Sec-Purpose: prefetch)
token    if required: once in the address, `/?token=...`, then in a cookie that scripts cannot read and other
         sites do not send (HttpOnly, SameSite=Strict). A link with the token works on any site
"""

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
    """Rules for requests. names: further names of this host; token: empty if none is required."""

    names: frozenset[str] = field(default_factory=frozenset)
    token: str = ""
    cookie: str = "harvester_view"


def rules(host: str, names: tuple[str, ...] = (), port: int = 0) -> Rules:
    """Rules for a server that listens on `host`, with a random token unless `host` is a loopback address.

    All ports of a host share their cookies, so the name of the cookie contains the port.
    """
    token = "" if is_loopback(host) else secrets.token_urlsafe(32)
    hostname = [socket.gethostname()] if token else []
    allowed = {name.lower() for name in (host, *names, *hostname) if name}
    return Rules(frozenset(allowed), token, f"harvester_view_{port}")


def is_loopback(host: str) -> bool:
    """Can only this computer reach a server that listens on `host`?"""
    try:
        return ipaddress.ip_address(host.strip("[]")).is_loopback
    except ValueError:
        return host.lower() == "localhost"


class Guard:
    """The middleware: `app.add_middleware(Guard, rules=rules(host))`."""

    def __init__(self, app: App, rules: Rules) -> None:
        self._app, self._rules = app, rules

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass the request on, or refuse it with one line."""
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        headers = _headers(scope)
        if error := _host_error(headers, self._rules):
            await refuse(scope, receive, send, 400, error)
        elif scope["type"] == "http" and scope["method"] not in ("GET", "HEAD"):
            await refuse(
                scope, receive, send, 405, f"expected the method GET or HEAD, found {scope['method'][:20]}"
            )
        elif headers.get("content-length", ["0"]) != ["0"] or "transfer-encoding" in headers:
            await refuse(scope, receive, send, 413, "expected a request without content")
        elif self._has_token(scope) and not self._has_cookie(headers):
            await set_cookie(scope, send, self._rules.cookie, self._rules.token)
        elif error := _site_error(headers):
            await refuse(scope, receive, send, 403, error)
        elif _is_ahead(headers):
            await refuse(scope, receive, send, 503, "this page is not loaded ahead: open it")
        elif self._rules.token and not self._has_cookie(headers):
            message = "open the address with its token, as printed by `harvester view`"
            await refuse(scope, receive, send, 401, message)
        else:
            # a HEAD request is answered like GET; the server leaves out the content
            await self._app({**scope, "method": "GET"} if scope["type"] == "http" else scope, receive, send)

    def _has_cookie(self, headers: dict[str, list[str]]) -> bool:
        cookies = SimpleCookie()
        try:
            cookies.load("; ".join(headers.get("cookie", ())))
        except CookieError:
            return False
        return self._rules.cookie in cookies and self._equal(cookies[self._rules.cookie].value)

    def _has_token(self, scope: Scope) -> bool:
        if not self._rules.token or scope["type"] != "http":
            return False
        query = parse_qs(scope.get("query_string", b"").decode("latin-1"))
        return any(self._equal(token) for token in query.get("token", ()))

    def _equal(self, token: str) -> bool:
        return secrets.compare_digest(token.encode(), self._rules.token.encode())


def _headers(scope: Scope) -> dict[str, list[str]]:
    headers: dict[str, list[str]] = {}
    for name, value in scope["headers"]:
        headers.setdefault(name.decode("latin-1").lower(), []).append(value.decode("latin-1"))
    return headers


def _host_error(headers: dict[str, list[str]], rules: Rules) -> str:
    """Message on a wrong Host or Origin, or empty."""
    hosts = headers.get("host", [])
    if len(hosts) != 1 or not _is_allowed(_name(hosts[0]), rules):
        return f"Host: expected a name or address of this server, found {_quoted(hosts)}"
    origins = headers.get("origin", [])
    if any(_origin(origin) != hosts[0].lower() for origin in origins):
        return f"Origin: expected the page's own host {hosts[0]}, found {_quoted(origins)}"
    return ""


def _site_error(headers: dict[str, list[str]]) -> str:
    """Message on a request that another site has caused, or empty."""
    host = headers["host"][0]
    site = headers.get("sec-fetch-site")
    if site is not None:
        foreign = any(value not in ("same-origin", "none") for value in site)  # none: typed by the user
    else:
        foreign = any(_origin(referer) != host.lower() for referer in headers.get("referer", []))
    if not foreign:
        return ""
    return f"opened from another site: enter {host}/ in the address bar instead"


def _is_ahead(headers: dict[str, list[str]]) -> bool:
    """Does the browser load this before the user has asked for it?"""
    return any("prefetch" in v.lower() for name in ("sec-purpose", "purpose") for v in headers.get(name, []))


def _is_allowed(name: str, rules: Rules) -> bool:
    if is_loopback(name) or name in rules.names:
        return True
    try:  # a numeric address is safe from DNS rebinding; without a token only the loopback is served
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
    """`host:port` of an origin; empty for `null` and for malformed text."""
    try:
        parts = urlsplit(origin)
    except ValueError:
        return ""
    return parts.netloc.lower() if parts.scheme in ("http", "https") else ""


def _quoted(values: list[str]) -> str:
    return ascii(", ".join(values))[:80] if values else "none"


# keep the address with the token out of caches and of the Referer header
PRIVATE = [(b"cache-control", b"no-store"), (b"referrer-policy", b"no-referrer")]


async def refuse(scope: Scope, receive: Receive, send: Send, status: int, message: str) -> None:
    """Refuse with one line. A websocket is closed before it is accepted (the browser sees 403)."""
    if scope["type"] == "websocket":
        await receive()
        await send({"type": "websocket.close", "code": 1008, "reason": message[:100]})
    else:
        await answer(send, status, message)


async def answer(send: Send, status: int, message: str, *headers: tuple[bytes, bytes]) -> None:
    """Answer an HTTP request with one line."""
    plain = (b"content-type", b"text/plain; charset=utf-8")
    await _answer(send, status, f"{message}\n", [plain, *PRIVATE, *headers])


async def set_cookie(scope: Scope, send: Send, cookie: str, token: str) -> None:
    """Set the cookie and go to the same address without the token.

    This uses a page with a refresh, not a redirect. If the link was on another site, a redirect would still
    count as a request of that site, and the browser would not send a SameSite=Strict cookie with it.
    """
    query = [(k, v) for k, v in parse_qsl(scope.get("query_string", b"").decode("latin-1")) if k != "token"]
    # a relative address stays on this host, whatever the path was
    address = f"?{urlencode(query)}" if query else "."
    page = f'<!doctype html><meta http-equiv="refresh" content="0; url={address}"><title>harvester</title>\n'
    header = f"{cookie}={token}; Path=/; HttpOnly; SameSite=Strict".encode()
    headers = [(b"content-type", b"text/html; charset=utf-8"), (b"set-cookie", header), *PRIVATE]
    await _answer(send, 200, page, headers)


async def _answer(send: Send, status: int, text: str, headers: list[tuple[bytes, bytes]]) -> None:
    body = text.encode()
    length = (b"content-length", str(len(body)).encode())
    await send({"type": "http.response.start", "status": status, "headers": [*headers, length]})
    await send({"type": "http.response.body", "body": body})


LIBRARIES = ("asyncio", "uvicorn.error")


def shorten_library_logs() -> None:
    """Log errors of the libraries in one line each. Loggers of this project keep the traceback."""
    for name in LIBRARIES:
        logging.getLogger(name).addFilter(_one_line)


def _one_line(record: logging.LogRecord) -> bool:
    """Keep the first line and the name of the error, so that a page cannot fill the terminal."""
    error = record.exc_info[1] if record.exc_info else None
    record.msg = record.getMessage().partition("\n")[0]
    if error is not None:
        record.msg += f": {type(error).__name__}"
    record.args, record.exc_info, record.exc_text = (), None, None
    return True
