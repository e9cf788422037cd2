"""What a server bears: floods of requests and of silent connections leave the driver and the page alone."""

import contextlib
import http.client
import json
import os
import socket
import threading
import time
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from urllib.parse import urlsplit

import httpx
import pytest
from hypothesis import given
from hypothesis import strategies as st
from kit import shards
from kit.mistakes import problem
from kit.wait import LONG, until
from view.standin import URL, Server, serving, started
from websockets.sync.client import connect

from orchestrator.base.errors import Problem
from orchestrator.drive.sticks import StickAxes
from orchestrator.view import result_files, server_load
from orchestrator.view.authority import Message, TokenBucket, parse
from orchestrator.view.result_files import find_result, list_results
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


# ---- Names of files from a browser: what lies in the folder is found, everything else is one line


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Results, and things beside them that must not be read."""
    results = tmp_path / "results"
    (results / "deep").mkdir(parents=True)
    for name in ("run.csv", "deep/more.parquet", "notes.txt"):
        (results / name).write_text("time\n")
    (tmp_path / "secret.csv").write_text("time\n")
    (results / "out.csv").symlink_to(tmp_path / "secret.csv")
    (results / "up").symlink_to(tmp_path)
    (results / "in.csv").symlink_to(results / "run.csv")
    (results / "loop.csv").symlink_to(results / "loop.csv")
    (results / "hidden.csv").symlink_to(results / "notes.txt")
    (results / "dir.csv").mkdir()
    os.mkfifo(results / "pipe.csv")
    return results


def test_found_and_listed(folder: Path) -> None:
    """Files in the folder, and links inside it; what is listed can be opened, no more."""
    with (folder / "huge.csv").open("wb") as file:
        file.truncate(2_100_000_000)  # without its bytes
    names = [*list_results([folder])]
    assert names == ["in.csv", "run.csv"]
    assert all(find_result(name, [folder / "nowhere", folder]) == folder / name for name in names)
    assert not list_results([folder / "nowhere"])


REFUSED = [
    *("../secret.csv", "deep/../../secret.csv", "..", "/etc/passwd", "/etc/x.csv", "//host/share/x.csv"),
    *("..\\secret.csv", "C:\\x.csv", "C:x.csv", "\\\\host\\x.csv", "~/x.csv", "run.csv\x00.csv", "a\nb.csv"),
    *("out.csv", "up/secret.csv", "up/results/../secret.csv", "loop.csv", "hidden.csv"),
    *("dir.csv", "pipe.csv", "CON.csv", "deep/more.parquet"),
    *("run.csv:stream", "*.csv", "\ud800.csv", "a\u202eb.csv"),
    *("", "notes.txt", "run", ".csv", "nowhere.csv", "a" * 300 + ".csv", None, 3, ["run.csv"], b"run.csv"),
]


@pytest.mark.parametrize("name", REFUSED, ids=ascii)
def test_refused(folder: Path, name: object) -> None:
    """Ways out of the folder, devices, folders, pipes and things that are no name: one short line each."""
    told = problem(lambda: find_result(name, [folder]), r"file ['\"].*: no such result file")
    assert str(folder) not in told, "a browser learns no path of this computer"
    assert len(told) < 200


@given(st.text(max_size=300))
def test_never_outside(name: str) -> None:
    """No text whatever leads to a file outside the folders."""
    with pytest.raises(Problem):
        find_result(name, [Path(__file__).parent])


def test_huge(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A file that would fill the memory is refused by its size, before it is read."""
    monkeypatch.setattr(result_files, "LARGEST", 3)
    with pytest.raises(Problem, match="expected at most"):
        find_result("run.csv", [folder])


# ---- Messages from a browser: what is believed, and that everything else is none

GOOD = {"n": 3, "sticks": [0, -1, 0.25, 1], "dead_man": True}


def test_good() -> None:
    """An honest message is what it says."""
    assert parse(json.dumps(GOOD)) == Message(3, StickAxes(0, -1, 0.25, 1), True)


STICKS = ([], [0] * 3, [0] * 25, "0000", None, {"0": 1})
VALUES = ("1.0001", "-2", "1e308", "1e999", "-1e999", "NaN", "Infinity", "true", "null", '"1"', "[1]")
WRONG = {
    "not json": "{",
    "binary": json.dumps(GOOD).encode(),
    "nothing": "",
    "array": "[]",
    "number": "17",
    "null": "null",
    "a key too few": json.dumps({"n": 1, "dead_man": True}),
    "a key too many": json.dumps(GOOD | {"axis": "x"}),
    "huge": json.dumps(GOOD | {"sticks": [0.1] * 1000}),
    "deep": "[" * 250,
    "long number": '{"n":' + "9" * 240 + "}",
    **{f"n {n!r}": json.dumps(GOOD | {"n": n}) for n in (-1, 2**53, 1.0, True, "1", None, [])},
    **{f"sticks {s!r}": json.dumps(GOOD | {"sticks": s}) for s in STICKS},
    **{f"value {v}": json.dumps(GOOD).replace("0.25", v) for v in VALUES},
    **{f"dead man {d!r}": json.dumps(GOOD | {"dead_man": d}) for d in (1, 0, "true", None)},
}


@pytest.mark.parametrize("raw", WRONG.values(), ids=WRONG.keys())
def test_wrong(raw: str | bytes) -> None:
    """Whatever is wrong is no message."""
    assert parse(raw) is None


@given(st.text() | st.binary())
def test_garbage(raw: str | bytes) -> None:
    """Arbitrary text and bytes are no message, and raise no exception."""
    assert parse(raw) is None


def shaped(inner: st.SearchStrategy[object]) -> st.SearchStrategy[object]:
    return st.lists(inner, max_size=4) | st.dictionaries(st.sampled_from(["n", "sticks", "dead_man"]), inner)


@given(st.recursive(st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5), shaped))
def test_garbage_of_the_right_shape(found: object) -> None:
    """JSON that looks like a message is a message within its bounds, or none."""
    message = parse(json.dumps(found))
    assert message is None or all(abs(value) <= 1 for value in vars(message.sticks).values())


def test_bucket() -> None:
    """At once as many as it holds, then the steady rate, however long it was quiet before."""
    bucket = TokenBucket(rate=10, depth=5, content=5)
    assert [bucket.take(100.0) for _ in range(7)] == [True] * 5 + [False] * 2
    # a fifth of a second fills two
    assert [bucket.take(100.2) for _ in range(3)] == [True, True, False]
    assert not bucket.take(99.0)
