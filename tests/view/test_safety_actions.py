"""What a page asks of the machine that all see: who may ask, and what it takes from the driver."""

import asyncio
import json
from collections.abc import Coroutine
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import httpx
import pytest
from view.standin import DESCRIPTION, SILENCE_LIMIT, TIMEOUT, StandIn, pages

from orchestrator.view import live
from orchestrator.view.authority import ControlAuthority
from orchestrator.view.live import ACTIONS, PATIENT, OpenPage
from orchestrator.view.server import application

Result = TypeVar("Result")


def ran(coroutine: Coroutine[Any, Any, Result]) -> Result:
    """Its result, from a thread: in that of the tests a browser may have its loop."""
    with ThreadPoolExecutor(1) as pool:
        return pool.submit(asyncio.run, coroutine).result()


class Room:
    """A page that drives, one that watches, and notes of what is done with the machine of both."""

    def __init__(self) -> None:
        self.machine, self.done = StandIn(), list[str]()
        limits = {"timeout": TIMEOUT, "silence_limit": SILENCE_LIMIT}
        self.authority = ControlAuthority(self.machine, lambda: DESCRIPTION, **limits)
        self.pages: Any = pages(self.machine, self.authority)
        for owner, names in ((self.machine, "play pause"), (self.pages.session, "again speed start")):
            for name in names.split():
                setattr(owner, name, partial(self._note, name))
        socket: Any = None
        self.driver, self.watcher = OpenPage(self.pages, socket), OpenPage(self.pages, socket)
        self.authority.take(self.driver.station)
        self._number = 0
        self.say(dead_man=False)
        self.say()
        assert self.machine.moving

    def _note(self, name: str, *_: object) -> None:
        self.done.append(name)

    def say(self, dead_man: bool = True) -> None:
        """The driver's hands, with a stick held out."""
        self._number += 1
        message = {"n": self._number, "sticks": [-1, 0, 0, 0], "dead_man": dead_man}
        self.authority.hear(self.driver.station, json.dumps(message))

    def ask(self, page: OpenPage, do: str, **more: object) -> None:
        ran(page._act(ACTIONS[do], {"do": do, **more}))

    def role(self) -> str:
        return self.authority.status(self.driver.station).role


@pytest.fixture
def room(monkeypatch: pytest.MonkeyPatch) -> Room:
    monkeypatch.setattr(live, "next_choice", lambda _, asked: asked)
    found = Room()
    found.pages.session.plan.choice = None
    return found


ENDS = {"again": {}, "start": {"system": "other.ssp"}}
CHANGES: dict[str, dict[str, object]] = {"speed": {"factor": 2.0}, **ENDS}


@pytest.mark.parametrize("do", CHANGES)
def test_a_watcher_changes_nothing(room: Room, do: str) -> None:
    """Neither speed nor machine of another page's driver, who goes on driving."""
    room.ask(room.watcher, do, **CHANGES[do])
    assert room.watcher.answers[-1]["text"] == "another page drives the machine and decides"
    assert room.done == []
    assert (room.machine.moving, room.role()) == (True, "driving")


def test_everybody_may_pause_and_the_driver_goes_on(room: Room) -> None:
    """A watcher pauses the machine, and does not set it going again."""
    for state in ("running", "paused"):
        room.machine.state = state
        room.ask(room.watcher, "toggle")
        assert room.done == ["pause"]
    room.ask(room.driver, "toggle")
    assert room.done == ["pause", "play"]


@pytest.mark.parametrize("do", ["speed", "toggle"])
def test_going_on_and_another_speed_need_the_dead_man_anew(room: Room, do: str) -> None:
    """The machine rests; its driver keeps the controls and moves it after a release of the dead-man."""
    room.machine.state = "paused" if do == "toggle" else "running"
    room.ask(room.driver, do, factor=2.0)
    room.machine.state = "running"
    room.say()
    assert (room.machine.moving, room.role()) == (False, "driving")
    room.say(dead_man=False)
    room.say()
    assert room.machine.moving


@pytest.mark.parametrize("do", [*ENDS, "toggle"])
def test_another_machine_takes_the_controls(room: Room, do: str) -> None:
    """After a restart, a start, or play of what has ended, nobody drives, so nothing moves by itself."""
    room.machine.state = "ended" if do == "toggle" else "running"
    room.ask(room.driver, do, **ENDS.get(do, {}))
    assert room.done == ["again" if do == "toggle" else do]
    room.say()
    assert (room.machine.moving, room.role()) == (False, "free")


def test_a_message_that_an_action_did_not_foresee_is_told_in_one_line(
    room: Room, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """To the page, and on the terminal of the server."""

    def fails(*_: object) -> None:
        raise TypeError("unhashable\n\x1b[2J")

    monkeypatch.setitem(ACTIONS, "shown", fails)
    room.ask(room.watcher, "shown", number=1)
    (line,) = [r.getMessage() for r in caplog.records if r.levelname == "ERROR"]
    assert line.isprintable()
    assert "TypeError" in line


def test_actions_count_for_the_limit_of_messages(room: Room) -> None:
    """A page that asks without end is not heard, and is cut off like one that floods with its sticks."""

    async def flood() -> list[bool]:
        return [room.watcher._hear('{"do":"shown","number":1}') for _ in range(2 * PATIENT)]

    heard = ran(flood())
    assert 0 < sum(heard) < PATIENT
    assert room.watcher.station.counts["flood"] == 2 * PATIENT - sum(heard)


def test_the_end_of_the_server_is_rest(room: Room) -> None:
    """When the server ends, the machine rests and nobody drives."""
    app = application(room.pages)

    async def served() -> None:
        async with app.router.lifespan_context(app):
            assert room.machine.moving

    ran(served())
    assert (room.machine.moving, room.role()) == (False, "free")


def test_result_files_of_the_folder_only(room: Room, tmp_path: Path) -> None:
    """A saved session can be fetched by its name; ways out of the folder are one line."""
    (tmp_path / "results").mkdir()
    (tmp_path / "results" / "run.csv").write_text("time\n0\n")
    (tmp_path / "secret.csv").write_text("time\n1\n")
    room.pages.session.folders = [tmp_path / "results"]
    transport = httpx.ASGITransport(app=application(room.pages))

    async def fetched(name: str) -> httpx.Response:
        async with httpx.AsyncClient(transport=transport, base_url="http://127.0.0.1") as client:
            return await client.get(f"/result/{name}")

    assert ran(fetched("run.csv")).text == "time\n0\n"
    for name in ("..%2Fsecret.csv", "%2Fetc%2Fpasswd", "con.csv", "run.txt", ""):
        answer = ran(fetched(name))
        assert (answer.status_code, answer.text.count("\n")) == (404, 1), name
