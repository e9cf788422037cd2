"""Who gets an answer from a running server: hosts, origins, tokens."""

from collections.abc import Iterator
from functools import partial

import httpx
import pytest
from kit.mistakes import table
from kit.wait import LONG, until
from view.standin import Server, serving
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

from orchestrator.view.access import is_loopback, rules

get = partial(httpx.get, timeout=LONG)
PAGE = 'class="harvester-machine"'
SITES = {"origin", "sec-fetch-site", "referer"}


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
    before = list(server.authority.stations)
    with (
        pytest.raises(InvalidStatus, match="403"),
        connect(server.socket, open_timeout=LONG, additional_headers=headers),
    ):
        pass
    return server.authority.stations == before


def test_own_page(local: Server) -> None:
    """The page's own origin opens its socket."""
    with connect(local.socket, open_timeout=LONG, origin=local.http):
        assert until(lambda: len(local.authority.stations) == 1)
    assert until(lambda: not local.authority.stations)


@table(__file__, "requests", "where, headers, status, what")
def test_requests(
    local: Server, remote: Server, where: str, headers: dict[str, str], status: int, what: str
) -> None:
    """Only the user and the page itself get an answer or a socket; others read what to do instead."""
    server = {"local": local, "remote": remote}[where]
    own = {"http": server.http, "name": server.rules.cookie, "token": server.rules.token}
    sent = {name: value.format(**own) for name, value in headers.items()}
    answer = get(server.http, headers={name: value.encode("latin-1") for name, value in sent.items()})
    assert answer.status_code == status, what
    if status == 200:
        assert PAGE in answer.text
    if status == 400:
        assert answer.text.count("\n") == 1
    if status == 403:
        address = server.http.removeprefix("http://")  # behind a proxy the scheme can be another
        assert answer.text == f"opened from another site: enter {address}/ in the address bar instead\n"
    if status in (400, 403) and SITES & set(headers):
        assert opens_no_socket(server, sent)


@pytest.mark.parametrize("method", ["POST", "OPTIONS", "PUT", "DELETE", "TRACE"])
def test_other_methods(local: Server, method: str) -> None:
    """Only GET and HEAD are answered, so no foreign page learns by a preflight that it may ask."""
    answer = httpx.request(method, local.http, timeout=LONG)
    assert answer.status_code == 405
    assert not [name for name in answer.headers if name.startswith("access-control")]


def test_link_with_the_token(remote: Server) -> None:
    """The address with its token works from another site; what else stands in it is no part of the page."""
    headers = {"sec-fetch-site": "cross-site"}
    assert get(f"{remote.http}/?token={remote.rules.token}", headers=headers).status_code == 200
    assert get(f"{remote.http}/?token=wrong", headers=headers).status_code == 403
    answer = get(f"{remote.http}/", params={"token": remote.rules.token, "x": '"><script>alert(1)</script>'})
    assert "<script>" not in answer.text


def test_tokens(local: Server) -> None:
    """Only who asks for other hosts needs a token: each server has its own, of 256 bits."""
    assert local.rules.token == ""
    hosts = ("localhost", "127.0.0.1", "::1", "0.0.0.0", "::", "host")
    assert list(filter(is_loopback, hosts)) == ["localhost", "127.0.0.1", "::1"]
    first, second = rules("0.0.0.0").token, rules("0.0.0.0").token
    assert first != second
    assert len(first) >= 43
    assert "host.lan" in rules("0.0.0.0", names=("Host.lan",)).names


QUERIES = ("", "?token=", "?token=wrong", "?token[]=x", "?token=%ff%00", "?" + "&" * 50)


@pytest.mark.parametrize("query", QUERIES)
def test_without_token(remote: Server, query: str) -> None:
    """No page without the token, and no socket."""
    assert get(remote.http + "/" + query).status_code == 401
    assert opens_no_socket(remote, {})


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
    assert PAGE in get(remote.http, headers={"cookie": cookie}).text
    with connect(remote.socket, open_timeout=LONG, additional_headers={"Cookie": cookie}):
        assert until(lambda: len(remote.authority.stations) == 1)


def test_head_is_answered_like_get(local: Server) -> None:
    """Monitors and proxies ask with HEAD: the same status and headers, without the content."""
    answer, expected = httpx.head(local.http, timeout=LONG), get(local.http)
    assert (answer.status_code, answer.content) == (200, b"")
    assert answer.headers["content-length"] == expected.headers["content-length"]
