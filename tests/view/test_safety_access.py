"""Who gets an answer from a running server: hosts, origins, tokens."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from functools import partial

import httpx
import pytest
from kit.wait import LONG, until
from view.standin import Server, serving
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

from orchestrator.view.access import is_loopback, rules

get = partial(httpx.get, timeout=LONG)


@pytest.fixture(scope="module")
def local() -> Iterator[Server]:
    with serving() as server:
        yield server


@pytest.fixture(scope="module")
def remote() -> Iterator[Server]:
    """With the rules of a server for all addresses, though it listens on the loopback only."""
    with serving("0.0.0.0") as server:
        yield server


def opens_no_socket(server: Server, headers: dict[str, str]) -> bool:
    """Is the socket of an open page refused with these headers?"""
    station = server.authority.join()
    address = server.socket(station.key)
    with (
        pytest.raises(InvalidStatus, match="403"),
        connect(address, open_timeout=LONG, additional_headers=headers),
    ):
        pass
    return not station.connected


OWN = ("localhost", "127.0.0.1", "[::1]", "LOCALHOST", "127.1.2.3")
FOREIGN = (
    *("evil.example", "localhost.evil.example", "127.0.0.1.evil.example", "10.0.0.7"),
    *("", "[", "a b", "::1"),
)


@pytest.mark.parametrize("port", ["", ":8080"])
@pytest.mark.parametrize("name", OWN)
def test_own_names(local: Server, name: str, port: str) -> None:
    """All names of the loopback do, with any port: it may have been forwarded."""
    assert get(local.http, headers={"host": name + port}).status_code == 200


@pytest.mark.parametrize("name", FOREIGN)
def test_foreign_names(local: Server, name: str) -> None:
    """A foreign name that points here gets nothing: neither a page nor a socket."""
    answer = get(local.http, headers={"host": name})
    assert answer.status_code == 400
    assert answer.text.count("\n") == 1


ORIGINS = ("http://evil.example", "http://127.0.0.1:1", "https://127.0.0.1.evil.example")
ORIGINS += ("file://", "null", "x", "")


@pytest.mark.parametrize("origin", ORIGINS)
def test_foreign_pages(local: Server, origin: str) -> None:
    """A page from elsewhere opens no socket and sends no request."""
    assert opens_no_socket(local, {"Origin": origin})
    assert get(local.http, headers={"origin": origin}).status_code == 400


def test_own_page(local: Server) -> None:
    """The page's own origin opens its socket."""
    station = local.authority.join()
    with connect(local.socket(station.key), open_timeout=LONG, origin=local.http):
        assert until(lambda: station.connected)


OTHERS = (
    {"sec-fetch-site": "cross-site"},
    {"sec-fetch-site": "same-site"},  # another port of this computer
    {"sec-fetch-site": "cross-site", "sec-fetch-mode": "navigate", "sec-fetch-dest": "document"},
    {"sec-fetch-site": "same-origin, cross-site"},
    {"sec-fetch-site": ""},
    {"referer": "http://evil.example/"},
    {"referer": "http://127.0.0.1:1/"},
    {"referer": "nonsense"},
)


@pytest.mark.parametrize("headers", OTHERS, ids=str)
def test_requests_of_other_sites(local: Server, headers: dict[str, str]) -> None:
    """What another site makes a browser ask for is refused, and the user reads what to do instead."""
    answer = get(local.http, headers=headers)
    assert answer.status_code == 403
    address = local.http.removeprefix("http://")  # behind a proxy the scheme can be another
    assert answer.text == f"opened from another site: enter {address}/ in the address bar instead\n"
    assert opens_no_socket(local, headers)


OWN_REQUESTS = (
    {"sec-fetch-site": "none", "sec-fetch-mode": "navigate"},  # typed, or a bookmark
    {"sec-fetch-site": "same-origin"},
    {"sec-fetch-site": "same-origin", "referer": "http://evil.example/"},  # the browser itself knows better
    {"referer": "{http}/?file=x"},
    {},
)


@pytest.mark.parametrize("headers", OWN_REQUESTS, ids=str)
def test_requests_of_the_user(local: Server, headers: dict[str, str]) -> None:
    """A direct visit and the page itself are answered, in browsers without these headers, too."""
    sent = {name: value.format(http=local.http) for name, value in headers.items()}
    assert get(local.http, headers=sent).text == '"the page"'


@pytest.mark.parametrize("method", ["POST", "OPTIONS", "PUT", "DELETE", "TRACE"])
def test_other_methods(local: Server, method: str) -> None:
    """Only GET and HEAD are answered, so no foreign page learns by a preflight that it may ask."""
    answer = httpx.request(method, local.http, timeout=LONG)
    assert answer.status_code == 405
    assert not [name for name in answer.headers if name.startswith("access-control")]


@pytest.mark.parametrize("header", ["Content-Length: 1000000", "Transfer-Encoding: chunked"])
def test_content(local: Server, header: str) -> None:
    """A request with content, which could be slow to arrive, is refused before it arrives."""
    with socket.create_connection(("127.0.0.1", local.port), LONG) as sent:
        sent.sendall(f"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\n{header}\r\n\r\n".encode())
        assert sent.recv(100).startswith(b"HTTP/1.1 413 ")


@pytest.mark.parametrize(
    "purpose", ["sec-purpose: prefetch", "purpose: prefetch", "sec-purpose: prefetch;prerender"]
)
def test_prefetch(local: Server, purpose: str) -> None:
    """No page is built before the user opens it."""
    name, _, value = purpose.partition(": ")
    assert get(local.http, headers={"sec-fetch-site": "none", name: value}).status_code == 503


def test_link_with_the_token(remote: Server) -> None:
    """The address with its token works as a link in a message, too; nothing else on another site does."""
    headers = {"sec-fetch-site": "cross-site"}
    assert get(f"{remote.http}/?token={remote.rules.token}", headers=headers).status_code == 200
    cookie = {"cookie": f"{remote.rules.cookie}={remote.rules.token}"}
    assert get(remote.http, headers={**headers, **cookie}).status_code == 403
    assert get(f"{remote.http}/?token=wrong", headers=headers).status_code == 403


def test_no_token_on_the_loopback(local: Server) -> None:
    """Only who asks for other hosts needs a token."""
    assert local.rules.token == ""
    hosts = ("localhost", "127.0.0.1", "::1", "0.0.0.0", "::", "host")
    assert list(filter(is_loopback, hosts)) == ["localhost", "127.0.0.1", "::1"]


def test_tokens_are_random() -> None:
    """Each server has its own, of 256 bits."""
    first, second = rules("0.0.0.0").token, rules("0.0.0.0").token
    assert first != second
    assert len(first) >= 43


@pytest.mark.parametrize(
    "query", ["", "?token=", "?token=wrong", "?token[]=x", "?token=%ff%00", "?" + "&" * 50]
)
def test_without_token(remote: Server, query: str) -> None:
    """No page without the token, and no socket."""
    assert get(remote.http + "/" + query).status_code == 401
    assert opens_no_socket(remote, {})


@pytest.mark.parametrize(
    "cookie", ["{name}=wrong", "{name}=", "{name}", "=", ";;;", "{name}=\xff", "other={token}"]
)
def test_wrong_cookie(remote: Server, cookie: str) -> None:
    """A cookie counts with the right name and value only."""
    text = cookie.format(name=remote.rules.cookie, token=remote.rules.token)
    assert get(remote.http, headers={"cookie": text.encode("latin-1")}).status_code == 401


def test_token_becomes_a_cookie(remote: Server) -> None:
    """Once in the address, then in a cookie that no script and no other site gets; the address goes clean."""
    answer = get(f"{remote.http}/?token={remote.rules.token}&file=run.csv")
    assert answer.status_code == 200
    assert 'url=?file=run.csv"' in answer.text
    assert remote.rules.token not in answer.text
    assert answer.headers["referrer-policy"] == "no-referrer"
    kept = answer.headers["set-cookie"]
    assert "HttpOnly" in kept
    assert "SameSite=Strict" in kept
    cookie = kept.partition(";")[0]
    assert get(remote.http, headers={"cookie": cookie}).text == '"the page"'
    station = remote.authority.join()
    with connect(remote.socket(station.key), open_timeout=LONG, additional_headers={"Cookie": cookie}):
        assert until(lambda: station.connected)


def test_door_shows_no_script(remote: Server) -> None:
    """What else stands in the address does not become part of the page."""
    answer = get(f"{remote.http}/", params={"token": remote.rules.token, "x": '"><script>alert(1)</script>'})
    assert "<script>" not in answer.text


def test_names_with_a_token(remote: Server) -> None:
    """With a token any address in figures will do; a foreign name still does not."""
    cookie = {"cookie": f"{remote.rules.cookie}={remote.rules.token}"}
    assert get(remote.http, headers={"host": "192.168.1.5:80", **cookie}).status_code == 200
    assert get(remote.http, headers={"host": "evil.example", **cookie}).status_code == 400
    assert "host.lan" in rules("0.0.0.0", names=("Host.lan",)).names


def test_head_is_answered_like_get(local: Server) -> None:
    """Monitors and proxies ask with HEAD: the same status and headers, without the content."""
    answer = httpx.head(local.http, timeout=LONG)
    expected = get(local.http)
    assert (answer.status_code, answer.content) == (200, b"")
    assert answer.headers["content-length"] == expected.headers["content-length"]
