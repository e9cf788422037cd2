"""What a server bears: floods of requests and of silent connections leave the driver and the page alone."""

import contextlib
import http.client
import json
import socket
import threading
import time
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from urllib.parse import urlsplit

import httpx
import pytest
from kit import shards
from kit.wait import LONG, until
from view.standin import URL, Server, serving, started
from websockets.sync.client import connect

from orchestrator.view import server_load
from orchestrator.view.server_load import WAITING

get = partial(httpx.get, timeout=LONG)
HALF, WHOLE = b"GET / HTTP/1.1\r\nHost: 127.", b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n"


@pytest.fixture(scope="module")
def served(fmu_dir: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """The address of the real server, in a process of its own."""
    with started(fmu_dir, tmp_path_factory.mktemp("results")) as (_, said):
        yield said[URL].rstrip("/")


class Driver:
    """Takes the controls and holds the dead-man like a browser, 33 times a second, and notes the answers."""

    def __init__(self, url: str) -> None:
        self.live, self.role = list[bool](), ""
        self._address, self._end = f"ws{url[4:]}/live", threading.Event()
        self._thread = threading.Thread(target=self._drive)
        self._thread.start()
        assert until(lambda: any(self.live))

    def _drive(self) -> None:
        with connect(self._address, compression=None, open_timeout=LONG) as opened:
            hearing = threading.Thread(target=lambda: [self._hear(raw) for raw in opened])
            hearing.start()
            number = took = 0
            while not self._end.wait(0.03):
                if self.role != "driving":
                    opened.send('{"do": "take"}')
                    took = number
                held = number > took + 3  # released first
                opened.send(json.dumps({"n": number, "sticks": (-0.2, 0, 0, 0), "dead_man": held}))
                number += 1
        hearing.join()

    def _hear(self, raw: str | bytes) -> None:
        if status := json.loads(raw).get("status"):
            self.live.append(status["live"])
            self.role = status["role"]

    def stop(self) -> None:
        self._end.set()
        self._thread.join(LONG)


def fetch(url: str, path: str, answers: list[int]) -> None:
    """With little work of this process, which drives as well."""
    with contextlib.closing(http.client.HTTPConnection(urlsplit(url).netloc, timeout=LONG)) as asked:
        asked.request("GET", path)
        answers.append(asked.getresponse().status)


@shards.faults
@pytest.mark.parametrize(("path", "expected"), [("/", {200}), ("/any", {404}), ("/drive/any", {404})])
def test_flood_of_requests(served: str, path: str, expected: set[int]) -> None:
    """100 requests within 3 s, for the page or anything else: the driver goes on driving."""
    driver, answers = Driver(served), list[int]()
    begin = driver.live.index(True)
    for _ in range(100):
        threading.Thread(target=fetch, args=(served, path, answers), daemon=True).start()
        time.sleep(0.03)
    assert all(driver.live[begin:]), "once interrupted, it stays so until the dead-man is released"
    driver.stop()
    assert until(lambda: len(answers) == 100)
    assert expected <= set(answers) <= {*expected, 503}


def opened(port: int, first: bytes) -> socket.socket:
    found = socket.create_connection(("127.0.0.1", port), LONG)
    found.sendall(first)
    found.settimeout(0)
    return found


def is_closed(connection: socket.socket) -> bool:
    try:
        return connection.recv(1000) == b""
    except BlockingIOError:
        return False
    except OSError:
        return True


@shards.faults
def test_flood_of_connections(served: str) -> None:
    """300 connections that say nothing or half a header: the oldest are closed, the page stays available."""
    port = urlsplit(served).port
    assert port
    with contextlib.ExitStack() as stack:
        silent = [stack.enter_context(opened(port, HALF if n % 2 else b"")) for n in range(300)]
        assert get(served).status_code == 200
        assert until(lambda: sum(map(is_closed, silent)) >= 300 - WAITING)
        assert not is_closed(silent[-1])
        assert get(served).status_code == 200


@pytest.fixture
def hasty(monkeypatch: pytest.MonkeyPatch) -> Iterator[Server]:
    """Gives 0.3 s for the header of a request."""
    monkeypatch.setattr(server_load, "HEADER_TIME", 0.3)
    with serving() as server:
        yield server


@pytest.mark.parametrize("first", [b"", HALF, WHOLE + HALF], ids=["nothing", "half", "second half"])
def test_incomplete_header(hasty: Server, first: bytes) -> None:
    """A connection that never completes a header is closed, also after a request; bytes do not prolong it."""
    with opened(hasty.port, first) as waiting, contextlib.suppress(OSError):

        def drips() -> bool:
            if first:
                waiting.sendall(b"x")
            time.sleep(0.02)
            return is_closed(waiting)

        assert until(drips)
    assert get(hasty.http).status_code == 200


def test_complete_requests_stay(hasty: Server) -> None:
    """A websocket, and a connection with one request after the other, live longer than a header may take."""
    asking = http.client.HTTPConnection("127.0.0.1", hasty.port, timeout=LONG)
    with contextlib.closing(asking), connect(hasty.socket, open_timeout=LONG):
        kept = None
        for _ in range(6):  # 0.6 s, twice the time of a header
            asking.request("GET", "/")
            asking.getresponse().read()
            assert asking.sock is (kept := kept or asking.sock)
            time.sleep(0.1)
        assert hasty.authority.stations
