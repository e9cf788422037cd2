"""Access control of the server: an ASGI middleware that checks each request for a page or a websocket.

Host     must be a loopback name, a numeric address or an allowed name; a page under a foreign name that
         resolves to this computer (DNS rebinding) is refused
method   GET or HEAD; the page's own messages come over websockets
Origin   if present, must be the page's own host, so that no foreign page opens a websocket
site     a request that another site has caused (link, image, frame, script) is refused, by Sec-Fetch-Site. A
         browser that does not send it is judged by Referer
token    if required: once in the address, `/?token=...`, then in a cookie that scripts cannot read and other
         sites do not send (HttpOnly, SameSite=Strict). A link with the token works on any site
"""

import ipaddress
import logging
import secrets
import socket
from dataclasses import dataclass, field
from urllib.parse import urlencode, urlsplit

from starlette.datastructures import Headers
from starlette.requests import HTTPConnection
from starlette.responses import HTMLResponse, PlainTextResponse
from starlette.types import ASGIApp, Receive, Scope, Send
from starlette.websockets import WebSocketClose

# keep the address with the token out of caches and of the Referer header
PRIVATE = {"cache-control": "no-store", "referrer-policy": "no-referrer"}


@dataclass(frozen=True)
class Rules:
    """Rules for requests. names: further names of this host; token: empty if none is required."""

    names: frozenset[str] = field(default_factory=frozenset)
    token: str = ""
    cookie: str = "harvester_view"


def rules(host: str, names: tuple[str, ...] = (), port: int = 0, token: str = "") -> Rules:
    """Rules for a server that listens on `host`, with a random token unless `host` is a loopback address.

    All ports of a host share their cookies, so the name of the cookie contains the port.
    """
    remote = () if is_loopback(host) else (socket.gethostname(),)
    token = token or (secrets.token_urlsafe(32) if remote else "")
    allowed = {name.lower() for name in (host, *names, *remote) if name}
    return Rules(frozenset(allowed), token, f"harvester_view_{port}")


def is_loopback(host: str) -> bool:
    """Can only this computer reach a server that listens on `host`?"""
    try:
        return ipaddress.ip_address(host.strip("[]")).is_loopback
    except ValueError:
        return host.lower() == "localhost"


class Guard:
    """The middleware: `app.add_middleware(Guard, rules=rules(host))`."""

    def __init__(self, app: ASGIApp, rules: Rules) -> None:
        self._app, self._rules = app, rules

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass the request on, or refuse it with one line."""
        answer, http = None, scope["type"] == "http"
        if http or scope["type"] == "websocket":
            answer = self._answer(HTTPConnection(scope))
        # a HEAD request is answered like GET; the server leaves out the content
        await (answer or self._app)({**scope, "method": "GET"} if http else scope, receive, send)

    def _answer(self, asked: HTTPConnection) -> ASGIApp | None:
        """What refuses a request, or sets the cookie; None for a request that is passed on."""
        headers, rules, http = asked.headers, self._rules, asked["type"] == "http"
        has_cookie = self._is_token(asked.cookies.get(rules.cookie, ""))
        if error := _host_error(headers, rules):
            return _refusal(http, 400, error)
        if http and asked["method"] not in ("GET", "HEAD"):
            return _refusal(http, 405, f"expected the method GET or HEAD, found {asked['method'][:20]}")
        if http and not has_cookie and any(map(self._is_token, asked.query_params.getlist("token"))):
            return _set_cookie(asked, rules)
        if error := _site_error(headers):
            return _refusal(http, 403, error)
        if rules.token and not has_cookie:
            return _refusal(http, 401, "open the address with its token, as printed by `harvester view`")
        return None

    def _is_token(self, text: str) -> bool:
        token = self._rules.token
        return bool(token) and secrets.compare_digest(text.encode(), token.encode())


def _host_error(headers: Headers, rules: Rules) -> str:
    """Message on a wrong Host or Origin, or empty."""
    hosts = headers.getlist("host")
    if len(hosts) != 1 or not _is_allowed(_name(hosts[0]), rules):
        return f"Host: expected a name or address of this server, found {_quoted(hosts)}"
    origins = headers.getlist("origin")
    if any(_origin(origin) != hosts[0].lower() for origin in origins):
        return f"Origin: expected the page's own host {hosts[0]}, found {_quoted(origins)}"
    return ""


def _site_error(headers: Headers) -> str:
    """Message on a request that another site has caused, or empty."""
    host = headers["host"]
    site = headers.getlist("sec-fetch-site")
    if site:
        foreign = any(value not in ("same-origin", "none") for value in site)  # none: typed by the user
    else:
        foreign = any(_origin(referer) != host.lower() for referer in headers.getlist("referer"))
    if not foreign:
        return ""
    return f"opened from another site: enter {host}/ in the address bar instead"


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


def _refusal(http: bool, status: int, message: str) -> ASGIApp:
    """Refuse with one line. A websocket is closed before it is accepted (the browser sees 403)."""
    if http:
        return PlainTextResponse(f"{message}\n", status, PRIVATE)
    return WebSocketClose(1008, message[:100])


def _set_cookie(asked: HTTPConnection, rules: Rules) -> ASGIApp:
    """Set the cookie and go to the same address without the token.

    This uses a page with a refresh, not a redirect. If the link was on another site, a redirect would still
    count as a request of that site, and the browser would not send a SameSite=Strict cookie with it.
    """
    query = [(k, v) for k, v in asked.query_params.multi_items() if k != "token"]
    # a relative address stays on this host, whatever the path was
    address = f"?{urlencode(query)}" if query else "."
    page = f'<!doctype html><meta http-equiv="refresh" content="0; url={address}"><title>harvester</title>\n'
    cookie = f"{rules.cookie}={rules.token}; Path=/; HttpOnly; SameSite=Strict"
    return HTMLResponse(page, headers={**PRIVATE, "set-cookie": cookie})


def shorten_library_logs() -> None:
    """Log errors of the libraries in one line each. Loggers of this project keep the traceback."""
    for name in ("asyncio", "uvicorn.error"):
        logging.getLogger(name).addFilter(_one_line)


def _one_line(record: logging.LogRecord) -> bool:
    """Keep the first line and the name of the error, so that a page cannot fill the terminal."""
    error = record.exc_info[1] if record.exc_info else None
    record.msg = record.getMessage().partition("\n")[0]
    if error is not None:
        record.msg += f": {type(error).__name__}"
    record.args, record.exc_info, record.exc_text = (), None, None
    return True
