"""A worker process answers, tells how it ended, and leaves nothing behind."""

import io
import os
import signal
import threading
import time
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from kit.needs import needs
from kit.wait import LONG, runs, until
from numpy.typing import NDArray

from orchestrator.base.errors import Problem
from orchestrator.base.processes import machine_memory
from orchestrator.worker import wire
from orchestrator.worker.calls import share_activity
from orchestrator.worker.process import CLOSED, GARBLED, Worker
from orchestrator.worker.wire import Garbled, packed, read_message

CONTENTS = {"echo": Any, "said": str}
linux = needs("Linux", "processes are looked at in /proc")


@pytest.fixture(autouse=True)
def jobs(monkeypatch):
    """The functions of jobs.py can be found by a worker."""
    monkeypatch.setenv("PYTHONPATH", str(Path(__file__).parent))


@pytest.fixture
def start():
    """Workers that are closed at the end of a test."""
    workers = []

    def started(target, *arguments, **options):
        workers.append(Worker(f"jobs:{target}", lambda: CONTENTS, *arguments, **options))
        return workers[-1]

    yield started
    for worker in workers:
        worker.close()


def test_messages_go_there_and_back(start):
    """Plain data arrives as it was, in order; a million bytes too."""
    worker = start("echo")
    messages = [1.5, {"a": [1, "µ"]}, bytes(10**6), None]
    for message in messages:
        worker.put([message])
    assert [worker.get(LONG) for _ in messages] == [("echo", [m]) for m in messages]
    assert worker.alive
    assert not worker.ending


@pytest.mark.parametrize(
    ("how", "ending"),
    [
        *((3, "exit status 3"), (0, "exit status 0"), ("raise", "exit status 1")),
        pytest.param("crash", "segmentation fault", marks=linux),
        pytest.param("abort", "abort", marks=linux),
    ],
)
def test_a_worker_tells_how_it_ended(start, how, ending):
    """What it said before is there, then its end in words, its last line on stderr, and what it was doing."""
    worker = start("end")
    worker.put(how)
    assert worker.get(LONG) == ("said", "before the end")
    with pytest.raises(EOFError, match=ending):
        worker.get(LONG)
    assert worker.ending == ending
    assert worker.last_stderr_line == ("ValueError: expected another one" if how == "raise" else "last line")
    assert str(worker.activity) == "in fmi2DoStep"
    worker.put("nobody there")  # no error


def test_closing_ends_it_and_removes_its_files(start):
    """Also one that never reads."""
    worker = start("sleep", "named")
    assert worker.folder.name.startswith("named-")
    assert worker.folder.is_dir()
    worker.close()
    assert not worker.alive
    assert not worker.folder.exists()
    worker.close()  # once more does no harm


def test_a_worker_that_nobody_knows_ends():
    """No reference, no process."""
    worker = Worker("jobs:sleep", dict)
    pid, folder = worker.pid, worker.folder
    del worker
    assert until(lambda: not folder.exists())
    with pytest.raises(ProcessLookupError):
        os.kill(pid, 0)


@needs("POSIX", "no process sends SIGINT to itself")
def test_an_interrupt_while_a_forgotten_worker_ends_is_raised_after_it():
    """The garbage collector would print it with a traceback, and lose it."""
    workers = [Worker("jobs:sleep", dict, grace=0.5)]
    folder = workers[0].folder
    threading.Timer(0.1, lambda: os.kill(os.getpid(), signal.SIGINT)).start()

    def forget():
        workers.clear()
        time.sleep(LONG)

    with pytest.raises(KeyboardInterrupt):
        forget()
    assert not folder.exists()


def test_a_worker_may_end_in_an_orderly_way(start, tmp_path):
    """It has the time that it takes for itself, as far as the parent has the patience."""
    worker = start("graceful", grace=LONG)
    worker.put(str(tmp_path / "end.txt"))
    worker.get(LONG)
    worker.close()
    assert (tmp_path / "end.txt").read_text() == "done"
    assert worker.ending == "exit status 0"


@linux
def test_a_process_that_it_left_behind_does_not_hold_the_parent(start):
    """Its end is seen although an orphan holds its pipe, and the orphan ends with it."""
    worker = start("orphan")
    _, group = worker.get(LONG)
    with pytest.raises(EOFError):
        worker.get(LONG)
    worker.close()

    with pytest.raises(ProcessLookupError):
        until(lambda: os.killpg(group, 0))


@linux
@pytest.mark.parametrize(
    ("how", "told"),
    [("replaced", CLOSED), ("closed", CLOSED), ("garbage", GARBLED), ("code", GARBLED)],
)
def test_a_connection_that_is_lost_ends_the_process(start, tmp_path, how, told):
    """No wait is longer than asked for, nothing is executed, and the end has a name."""
    worker = start("spoilt")
    worker.put((how, str(tmp_path / "executed")))
    assert worker.get(LONG) == ("said", "before")
    with pytest.raises(EOFError) if how in ("garbage", "code") else pytest.raises(TimeoutError):
        worker.get(0.01 if told == CLOSED else LONG)  # CLOSE_TIME is longer
    with pytest.raises(EOFError):
        worker.get(LONG)
    assert (worker.ending, worker.alive) == (told, False)
    assert not (tmp_path / "executed").exists()


@linux
def test_messages_of_a_forked_process_do_not_count(start):
    """Each message is there once."""
    worker = start("twin")
    assert [worker.get(LONG) for _ in range(2)] == [("echo", [1, 2]), ("echo", "end")]


@linux
def test_nothing_that_it_started_goes_on(start, tmp_path):
    """Also a process in a session of its own, without a parent and with other environment variables."""
    mark = f"MARK={tmp_path}\0".encode()

    def left():
        for folder in Path("/proc").glob("[0-9]*"):
            with suppress(OSError):
                if mark in (folder / "environ").read_bytes():
                    yield folder

    worker = start("spoilt")
    worker.put(("daemon", str(tmp_path)))
    assert until(lambda: [*left()])
    worker.close()
    assert until(lambda: not [*left()])


def test_a_process_that_does_not_read_does_not_hold_the_parent(start):
    """Who sends more than a pipe takes, or waits for a message, goes on after the time that was asked for."""
    worker = start("sleep")
    for _ in range(3):
        worker.put(bytes(1 << 20))
    with pytest.raises(TimeoutError):
        worker.get(0.01)
    assert worker.alive


@linux
def test_a_worker_ends_when_its_parent_is_killed(start):
    """And it removes its own files then, as nobody else can."""
    middle = start("parent")
    _, (pid, folder) = middle.get(LONG)
    os.kill(middle.pid, signal.SIGKILL)
    assert until(lambda: not Path(folder).exists())
    assert until(lambda: not runs(pid))


@linux
def test_memory_is_told(start):
    """A Python takes some megabytes, and less than the machine has."""
    worker = start("echo")
    worker.put(0)
    worker.get(LONG)
    assert 1e6 < worker.memory < machine_memory()


def test_values_set_in_a_case_do_not_hide_it(tmp_path: Path) -> None:
    """After a crash while a parameter is set, the case is named first, then the values."""
    record = share_activity(tmp_path / "record")
    record.inputs("u = 1")
    assert str(record) == "before the first call, last inputs u = 1"
    record.case("a parameter out of bounds")
    record.call("fmi2SetReal")
    assert str(record) == "in fmi2SetReal (a parameter out of bounds)"
    record.inputs("p = 3")
    assert str(record) == "in fmi2SetReal (a parameter out of bounds), last values p = 3"


# ---- Messages of a worker: data comes back as it was, and no other bytes are taken for a message


@dataclass(frozen=True)
class Found:
    name: str
    values: NDArray[np.float64]
    counts: NDArray[np.int32] | None
    spans: tuple[float, float]
    names: tuple[str, ...]
    by_name: Mapping[str, float]
    problem: Problem | None = None
    local: Any = field(default=None, metadata={"local": True})


KINDS = {"found": Found, "any": Any, "time": float, "flag": bool, "array": NDArray[np.float64]}


def frame(name: str, content: Any, number: int = 0) -> bytes:
    return b"".join(packed(number, name, content))


def read(data: bytes, number: int = 0) -> tuple[str, Any]:
    return read_message(io.BufferedReader(io.BytesIO(data)), number, lambda: KINDS)


def test_data_comes_back_as_it_was() -> None:
    """Numbers that are not finite, empty arrays, texts of any kind; what is local stays."""
    sent = Found(
        name="µ\udc80\n",
        values=np.array([[1.5, np.nan], [np.inf, -0.0]]),
        counts=np.zeros((0, 3), np.int32),
        spans=(np.float64(0.1), np.inf),
        names=("a", ""),
        by_name={"x": 1},
        problem=Problem("no\nline"),
        local=object(),
    )
    _, found = read(frame("found", sent))
    np.testing.assert_array_equal(found.values, sent.values)
    assert found.counts.shape == (0, 3)
    found.values[0, 0] = 2.0  # memory of its own
    assert (str(found.problem), found.local) == ("no\\nline", None)
    for name in ("name", "spans", "names", "by_name"):
        assert getattr(found, name) == getattr(sent, name)
    assert {type(v) for v in (*found.spans, found.by_name["x"])} == {float}
    assert read(frame("any", {"a": [b"\0\xff", None, (1, "b")]}))[1] == {"a": [b"\0\xff", None, [1, "b"]]}


@given(st.integers(0, 400), st.binary(min_size=1, max_size=80))
def test_added_bytes_are_no_message(place: int, added: bytes) -> None:
    """Wherever another thread writes into a frame; after its end it is complete."""
    good = frame("array", np.arange(20.0))
    place %= len(good)
    if good[:place] + added + good[place:] == good + added:  # repeats what follows
        return
    with pytest.raises((Garbled, EOFError)):
        read(good[:place] + added + good[place:])


@pytest.mark.parametrize(
    "content",
    [
        *(("flag", 1), ("time", "1"), ("time", True), ("unknown", 0), ("array", [0.0])),
        *(("array", b"12345678"), ("array", np.zeros(2, np.float32))),
        *(("found", {"name": "a"}), ("found", {"other": 1})),
        *(("array", {"@": [8, "<f8", [1]]}), ("array", {"@": [-8, "<f8", [1]]})),
        *(("array", {"@": [0, "<f8", [-1]]}), ("array", {"@": [0, "<f8", [1 << 60, 1 << 60]]})),
        ("any", {"@": [0, "", "x"]}),
    ],
)
def test_another_content_is_no_message(content: tuple[str, Any]) -> None:
    """Other types, arrays outside of the bytes, names that nobody expects."""
    with pytest.raises(Garbled):
        read(frame(*content))


def test_a_frame_counts_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """A second process that sends the same frames is found, and so are sizes beyond any message."""
    assert read(frame("time", 1.0, 7), 7) == ("time", 1.0)
    with pytest.raises(Garbled):
        read(frame("time", 1.0, 7), 8)
    with pytest.raises(EOFError):
        read(frame("time", 1.0)[:-1])
    for limit, content in (("MOST_TEXT", ["a name"] * 9), ("MOST_BYTES", np.zeros(2))):
        large = frame("array", content)
        with monkeypatch.context() as patch:
            patch.setattr(wire, limit, 10)
            with pytest.raises(Garbled):
                read(large)
            with pytest.raises(Problem, match="of numbers, got"):
                frame("array", content)
