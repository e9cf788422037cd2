"""Who gets an answer from a running server: hosts, origins, tokens."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

import httpx
import pytest
from view.standin import LONG, Server, serving, wait
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


OWN = ("localhost", "127.0.0.1", "[::1]", "LOCALHOST", "127.1.2.3")
FOREIGN = (
    "evil.example",
    "localhost.evil.example",
    "127.0.0.1.evil.example",
    "10.0.0.7",
    "",
    "[",
    "a b",
    "::1",
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


ORIGINS = (
    "http://evil.example",
    "null",
    "http://127.0.0.1:1",
    "https://127.0.0.1.evil.example",
    "file://",
    "x",
    "",
)


@pytest.mark.parametrize("origin", ORIGINS)
def test_foreign_pages(local: Server, origin: str) -> None:
    """A page from elsewhere opens no socket and sends no request."""
    station = local.authority.join()
    refused = pytest.raises(InvalidStatus, match="403")
    with (
        refused,
        connect(local.socket(station.key), open_timeout=LONG, additional_headers={"Origin": origin}),
    ):
        pass
    assert get(local.http, headers={"origin": origin}).status_code == 400
    assert not station.connected


def test_own_page(local: Server) -> None:
    """The page's own origin opens its socket."""
    station = local.authority.join()
    with connect(local.socket(station.key), open_timeout=LONG, origin=local.http):
        wait(lambda: station.connected)


def test_no_token_on_the_loopback(local: Server) -> None:
    """Only who asks for other hosts needs a token."""
    assert local.rules.token == ""
    assert [is_loopback(host) for host in ("localhost", "127.0.0.1", "::1", "0.0.0.0", "::", "host")] == [
        *(True, True, True, False, False, False)
    ]


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
    station = remote.authority.join()
    with pytest.raises(InvalidStatus, match="403"), connect(remote.socket(station.key), open_timeout=LONG):
        pass


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
        wait(lambda: station.connected)


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
