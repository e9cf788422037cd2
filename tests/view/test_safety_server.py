"""The websocket of a running server: what is sent never stops it, and never leaves the machine moving."""

import contextlib
import json
import os
import socket
from collections.abc import Callable, Iterator
from functools import partial

import httpx
import pytest
from kit.wait import LONG, until
from view.standin import SILENCE_LIMIT, TIMEOUT, Server, serving
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import ClientConnection, connect

from orchestrator.view.authority import OperatorStation


@pytest.fixture(scope="module")
def running() -> Iterator[Server]:
    with serving() as server:
        yield server


@pytest.fixture
def server(running: Server) -> Iterator[Server]:
    """After each test: the machine rests, the server answers, and a new page can drive."""
    yield running
    assert until(lambda: not running.machine.moving)
    assert until(lambda: running.authority.status().role == "free")
    assert httpx.get(running.http, timeout=LONG).status_code == 200
    with page(running) as (socket, station):
        drive(running, socket, station)


@contextlib.contextmanager
def page(server: Server) -> Iterator[tuple[ClientConnection, OperatorStation]]:
    """A page with its socket."""
    before = set(server.authority.stations)
    with connect(server.socket, compression=None, open_timeout=LONG, ping_timeout=None) as socket:
        assert until(lambda: set(server.authority.stations) - before)
        yield socket, next(iter(set(server.authority.stations) - before))


def say(socket: ClientConnection, n: int, dead_man: bool = True, sticks: object = (-1, 0, 0, 0)) -> None:
    socket.send(json.dumps({"n": n, "sticks": sticks, "dead_man": dead_man}))


def drive(server: Server, socket: ClientConnection, station: OperatorStation) -> None:
    """Take the controls and move; the next message is number 2."""
    assert until(lambda: server.authority.take(station))
    say(socket, 0, dead_man=False)
    say(socket, 1)
    assert until(lambda: server.machine.moving)


WRONG = {
    "malformed": "{",
    "binary": os.urandom(64),
    "large": "x" * 10_000,
    "huge": "x" * 1_000_000,
    "huge binary": b"\x00" * 1_000_000,
    "huge command": '{"n":2,"sticks":[1e300,0,0,0],"dead_man":true}',
    "infinite command": '{"n":2,"sticks":[1e999,0,0,0],"dead_man":true}',
    "deep": "[" * 60_000,
    "no text": b"",
}
UNKNOWN = ('{"do":', '{"do":1}', '{"do":"x"}', '{"do":"_hear"}', '{"do":' + "[" * 3000)
WRONG |= {f"no action {raw[:9]}": raw for raw in UNKNOWN}
ACTIONS = (
    '{"do":"shown","number":1e999}',
    '{"do":"set","name":[],"value":{}}',
    '{"do":"start","system":"/etc/passwd","pose":1,"swap":[]}',
    '{"do":"speed","factor":"fast"}',
    '{"do":"choose","pattern":{}}',
)


@pytest.mark.parametrize("raw", [*WRONG.values(), *ACTIONS], ids=[*WRONG, *(a[6:14] for a in ACTIONS)])
def test_wrong_message_of_a_watcher(server: Server, raw: str | bytes) -> None:
    """A watcher sends what it likes: the driver goes on driving."""
    with page(server) as (socket, station), page(server) as (other, _):
        drive(server, socket, station)
        count = len(server.machine.commands)
        with contextlib.suppress(ConnectionClosed):  # before all of it has gone
            other.send(raw)
        for n in range(2, 8):
            say(socket, n)
        assert until(lambda: len(server.machine.commands) >= count + 6)
        assert all(any(command.values()) for command in server.machine.commands[count:])


def test_dropped_messages(server: Server) -> None:
    """Numbers that are missing do no harm; when nothing comes any more, it rests, and then is free."""
    with page(server) as (socket, station):
        drive(server, socket, station)
        for n in (5, 17, 100):
            say(socket, n, sticks=(-1, -1, 0, 0))
        assert until(lambda: station.counts["accepted"] == 5)
        assert server.machine.commands[-1]["boom_stick.stick_command"] > 0
        server.silence(1.1 * TIMEOUT)
        assert until(lambda: not server.machine.moving)
        assert server.authority.status(station).role == "driving"
        server.silence(SILENCE_LIMIT)
        assert until(lambda: server.authority.status(station).role == "free")
        assert station.counts["accepted"] == 5


def cut_cable(opened: ClientConnection) -> None:
    """In the middle of a frame of text, without a word."""
    opened.socket.sendall(b"\x81\xfe\x00")
    opened.socket.shutdown(socket.SHUT_RDWR)


ENDS: dict[str, Callable[[ClientConnection], object]] = {
    "the page is closed": lambda opened: opened.close(),
    "bytes that are no frame": lambda opened: opened.socket.sendall(os.urandom(1000)),
    "the cable is cut": cut_cable,
    **{name: partial(ClientConnection.send, message=raw) for name, raw in WRONG.items()},
}


@pytest.mark.parametrize("how", ENDS)
def test_connection_that_ends(server: Server, how: str) -> None:
    """However a connection ends, and after any wrong message, whether it survives that or not, it is rest."""
    with page(server) as (opened, station):
        drive(server, opened, station)
        with contextlib.suppress(ConnectionClosed):  # before all of it has gone
            ENDS[how](opened)
        assert until(lambda: not server.machine.moving)


def test_pictures_that_end(server: Server, monkeypatch: pytest.MonkeyPatch) -> None:
    """An error in what a page is sent ends its connection, so that it connects again."""
    with page(server) as (opened, station):
        drive(server, opened, station)
        monkeypatch.setattr(server.authority, "status", lambda _: 1 / 0)
        with pytest.raises(ConnectionClosed, match="the pictures ended"):
            all(opened.recv(timeout=LONG) for _ in range(10_000))
        monkeypatch.undo()
        assert until(lambda: not server.machine.moving)


def test_flood(server: Server) -> None:
    """A client that sends without end is cut off."""
    with page(server) as (socket, station):
        with contextlib.suppress(ConnectionClosed):
            for n in range(100_000):
                say(socket, n)
        assert until(lambda: station not in server.authority.stations)
        assert station.counts["flood"] > 0
