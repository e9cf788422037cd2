"""The websocket of an open page: frames of the machine and the state of the controls to the page, sticks and
actions of its operator back.

A page sends its sticks every 30 ms, and actions such as `{"do": "take"}`. A message is sent at once or
dropped, and the end of the connection ends driving. The server sends objects with these keys:

    hello    what the page shows of the machine, when that has changed (`orchestrator.drive.page.page_data`)
    jump     number of the jump, when the time or the machine is another one; the charts begin anew
    frame    number, time, state, and the values of `names` in the hello
    bins     extremes of the charts in bins of time
    status   of the controls; ten times a second, so that it is the heartbeat of the server, too
    info     the rest: timing, speed, message, and of a diagnosis the rows of `FindingTable`
    answer   to an action: a line, what there is to choose, or that what was chosen is done

A browser acknowledges the pictures that it has drawn. While `AHEAD` pictures are not acknowledged it gets no
further ones. So a slow browser shows fewer pictures, but no outdated ones, and does not load the server.
"""

import asyncio
import contextlib
import json
import logging
import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np
from starlette.websockets import WebSocket, WebSocketDisconnect

from orchestrator.base.errors import Problem, one_line
from orchestrator.base.signals import bare_name
from orchestrator.data.table import Array
from orchestrator.drive.findings import RESET, FindingTable
from orchestrator.drive.page import page_data
from orchestrator.realtime.machine import RealTimeMachine
from orchestrator.view.authority import ControlAuthority, OperatorStation, finite
from orchestrator.view.choice import USUAL, MachineChoice, poses, variants
from orchestrator.view.session import Session

Asked = dict[str, Any]  # the action of a page, with its name in "do"

RATE, INFO = 25.0, 5.0  # 1/s; rates of pictures and of the rest
TELL = 0.1  # s between two states of the controls
AHEAD = 8  # pictures sent to a browser and not yet drawn, at most
LOST = 2.0  # s; after this time without an acknowledgement, pictures count as lost
PATIENT = 100  # ignored messages after which a client is disconnected: 3 s at the usual rate
LONGEST = 2**12  # characters of an action
WINDOW, BIN = 20.0, 0.2  # s, of simulated time; as in charts.js
DIGITS = 6  # significant digits of a value
log = logging.getLogger(__name__)


class Credit:
    """Flow control for one browser: number of pictures sent and drawn."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self.sent = self.drawn = 0
        self._heard = clock()

    def next(self) -> int:
        """Number of the next picture, or 0 if the browser must catch up first."""
        if self.sent - self.drawn >= AHEAD:
            if self._clock() - self._heard < LOST:
                return 0
            self.drawn = self.sent
        if self.sent == self.drawn:
            self._heard = self._clock()
        return self.sent + 1

    def shown(self, number: object) -> None:
        """The browser has drawn this picture."""
        if type(number) is int and self.drawn < number <= self.sent:
            self.drawn, self._heard = number, self._clock()


class History:
    """Smallest and largest values of signals in the time bins of the last `WINDOW`. All pages share it.

    names    names of the signals that the machine has
    number   number of the last frame that was added
    bins     number of the bin -> its extremes in order of time, shape (2, names)
    """

    def __init__(self, machine: RealTimeMachine, columns: Mapping[str, int], names: Sequence[str]) -> None:
        self.names = tuple(dict.fromkeys(names))
        self._machine = machine
        self._columns = [columns.get(name, -1) for name in self.names]  # the last one is NaN
        self.number = -1
        self.bins = dict[int, Array]()

    def look(self) -> None:
        """Add the frames since the last call."""
        if self.number < 0:  # the first call needs only the last `WINDOW`
            self.number = self._machine.latest().number - round(WINDOW / 0.01) - 1
        numbers, times, axes, values = self._machine.since(self.number)
        if not len(numbers):
            return
        if self.bins and times[0] < max(self.bins) * BIN - BIN:  # restarted
            self.bins.clear()
        self.number = int(numbers[-1])
        self.add(times, axes, values)

    def add(self, times: Array, axes: Array, values: Array) -> None:
        """Add frames that follow each other."""
        if max(self._columns, default=-1) < 0:
            return
        table = np.column_stack((axes, values, np.full(len(times), np.nan)))[:, self._columns]
        bins = np.floor(times / BIN + 1e-9).astype(int)
        for k in np.unique(bins):
            rows = table[bins == k]
            if k in self.bins:
                rows = np.concatenate((self.bins[k], rows))
            self.bins[int(k)] = extremes(rows)
        oldest = max(self.bins) - round(WINDOW / BIN)
        self.bins = {k: rows for k, rows in self.bins.items() if k >= oldest}

    def since(self, number: int) -> list[tuple[int, list[Any], list[Any]]]:
        """Bins from this number on, as data."""
        kept = [k for k in sorted(self.bins) if k >= number]
        return [(k, numbers_of(self.bins[k][0]), numbers_of(self.bins[k][1])) for k in kept]


def extremes(rows: Array) -> Array:
    """Smallest and largest value of each column, in order of time, shape (2, columns)."""
    low, high = rows.argmin(axis=0), rows.argmax(axis=0)
    columns = np.arange(rows.shape[1])
    first, second = np.minimum(low, high), np.maximum(low, high)
    return np.stack((rows[first, columns], rows[second, columns]))


def numbers_of(row: Array) -> list[float | None]:
    """Values for the page: rounded, None if not finite."""
    return [float(f"{v:.{DIGITS}g}") if math.isfinite(v) else None for v in row.tolist()]


class Broadcast:
    """What all pages are sent; made once for all of them.

    hello     description of the machine that is shown, and its number, which counts up
    jumps     number of jumps of the time, also to another machine
    frame     time, state and values of the last frame; None before the first
    """

    def __init__(self, session: Session) -> None:
        self._session = session
        self._fitted: tuple[object, ...] = ()
        self.number, self.hello, self.info = 0, dict[str, Any](), dict[str, Any]()
        self.jumps = 0
        self.frame: list[Any] | None = None
        self._ticks = 0
        self.look()

    def look(self) -> None:
        """Read the machine once."""
        session = self._session
        fitted = (session.columns, session.plan, session.starts)
        if fitted != self._fitted:
            self._fitted = fitted
            self._begin()
        frame = session.machine.latest()
        row = np.concatenate((frame.axes, frame.values))[self._columns]
        time = frame.t if math.isfinite(frame.t) else 0.0
        self.frame = [round(time, 4), frame.state, numbers_of(row)]
        if self._ticks % round(RATE / INFO) == 0:
            self.history.look()
            self.findings.look()
            timing, factor = asdict(frame.timing), session.factor
            rows = list(map(numbers_of, self.findings.rows))
            self.info = {"factor": factor, "message": frame.message, "timing": timing, "findings": rows}
        self._ticks += 1

    def _begin(self) -> None:
        """Another machine, or another part of its time."""
        session, plan = self._session, self._session.plan
        description, columns = plan.description, session.columns
        told = {bare_name(name) for one in plan.findings for name in one.signals} - set(description.shown)
        names = [n for n in dict.fromkeys((*description.shown, *columns)) if n in columns and n not in told]
        self._columns = [columns[name] for name in names]
        self.history = History(session.machine, columns, description.curves)
        self.findings = FindingTable(plan.findings, session.machine.signals, session.machine.since)
        self.jumps += 1
        self._ticks = 0
        hello = page_data(description, plan.parameters)
        inputs = description.free(session.machine.axes)
        hello |= {"names": names, "title": session.title, "inputs": inputs}
        hello["findings"] = [{"text": f.text, "repair": f.repair, "unit": f.unit} for f in plan.findings]
        hello["forget"] = RESET if plan.findings and RESET in inputs else ""
        if hello != self.hello:
            self.number, self.hello = self.number + 1, hello


class Pages:
    """All open pages of a server."""

    def __init__(self, session: Session, authority: ControlAuthority) -> None:
        self.session, self.authority, self.broadcast = session, authority, Broadcast(session)

    async def run(self) -> None:
        """Read the machine until cancelled."""
        due = time.monotonic()
        while True:
            try:
                self.broadcast.look()
            except Exception:  # otherwise one error would stop the pictures of all pages for good
                log.exception("a frame could not be shown")
            due = max(due + 1 / RATE, time.monotonic() + 0.2 / RATE)
            await asyncio.sleep(due - time.monotonic())

    async def serve(self, socket: WebSocket) -> None:
        """Serve one page, as long as its connection lasts."""
        await socket.accept()
        page = OpenPage(self, socket)
        sending, listening = asyncio.create_task(page.send()), asyncio.create_task(page.listen())
        try:
            await asyncio.wait((sending, listening), return_when=asyncio.FIRST_COMPLETED)
            for task in (sending, listening):
                if task.done() and task.exception():
                    log.error("the connection of a page ended", exc_info=task.exception())
            if not listening.done():  # a page that is sent nothing has to connect again
                with contextlib.suppress(RuntimeError, WebSocketDisconnect, OSError):
                    await socket.close(1011, "the pictures ended")
        finally:
            sending.cancel()
            listening.cancel()
            page.close()


class OpenPage:
    """One open page."""

    def __init__(self, pages: Pages, socket: WebSocket) -> None:
        self._socket, self.session = socket, pages.session
        self.authority, self._broadcast = pages.authority, pages.broadcast
        self.station: OperatorStation = pages.authority.join()
        self.credit = Credit()
        self._action = asyncio.Lock()
        self._running = set[asyncio.Task[None]]()
        self.answers: list[dict[str, Any]] = []

    def close(self) -> None:
        """The page is gone."""
        self.authority.leave(self.station)

    # ---- to the page

    async def send(self) -> None:
        """Send what is new until the connection ends."""
        begun, jumped, sent, told, info, latest = -1, -1, None, 0.0, None, -1
        with contextlib.suppress(RuntimeError, WebSocketDisconnect, OSError):
            while True:
                new, shared, now = dict[str, Any](), self._broadcast, time.monotonic()
                if begun != shared.number:
                    begun, new["hello"] = shared.number, shared.hello
                if jumped != shared.jumps:
                    jumped, sent, info, latest = shared.jumps, None, None, -1
                    new["jump"] = jumped
                if info is not shared.info:
                    info = new["info"] = shared.info
                    if bins := shared.history.since(latest):
                        new["bins"], latest = bins, bins[-1][0]
                if sent != shared.frame and shared.frame and (number := self.credit.next()):
                    sent, self.credit.sent = shared.frame, number
                    new["frame"] = [number, *shared.frame]
                if now - told >= TELL:
                    told, new["status"] = now, asdict(self.authority.status(self.station))
                if self.answers:
                    new["answer"] = self.answers.pop(0)
                if new:
                    await self._socket.send_text(json.dumps(new, separators=(",", ":")))
                await asyncio.sleep(1 / RATE)

    def answer(self, text: str, bad: bool = False, href: str = "") -> None:
        """Answer an action in a line."""
        self.answers.append({"text": text, "bad": bad, "href": href})

    # ---- from the page

    async def listen(self) -> None:
        """Process messages until the connection ends, or too many of them were not understood."""
        ignored = 0
        while ignored < PATIENT:
            try:
                event = await self._socket.receive()
            except (WebSocketDisconnect, RuntimeError):
                return
            if event["type"] != "websocket.receive":
                return
            raw = event.get("text")
            accepted = self._hear(raw if raw is not None else event.get("bytes") or b"")
            ignored = max(0, ignored - 1) if accepted else ignored + 1
        with contextlib.suppress(RuntimeError, WebSocketDisconnect):
            await self._socket.close(1008, "too many invalid messages")

    def _hear(self, raw: str | bytes) -> bool:
        """Process a message; False if it is ignored. What is no action is of the sticks, or a mistake."""
        asked = action(raw)
        if asked is None:
            return self.authority.hear(self.station, raw)
        if not self.station.bucket.take(time.monotonic()):
            self.station.counts["flood"] += 1
            return False
        act = ACTIONS[asked["do"]]
        task = asyncio.create_task(self._act(act, asked))
        self._running.add(task)
        task.add_done_callback(self._running.discard)
        return True

    async def _act(self, act: Callable[..., Any], asked: Asked) -> None:
        """Do what the operator asks; a mistake is answered in one line."""
        try:
            result = act(self, asked)
            if asyncio.iscoroutine(result):
                async with self._action:  # one after the other
                    await result
        except Problem as problem:
            self.answer(str(problem), bad=True)
        except Exception as error:  # of a message that no page of ours sends, too
            log.error("an action of a page failed: %s", one_line(repr(error)))
            log.debug("its cause", exc_info=True)
            self.answer("that could not be done", bad=True)

    # ---- actions

    def take(self) -> None:
        if not self.authority.take(self.station):
            self.answer("requested; the driver has to release the controls")

    async def toggle(self) -> None:
        machine = self.session.machine
        state = machine.latest().state
        if state in ("running", "starting"):
            machine.pause()  # every page may pause
        elif state in ("ended", "failed"):
            await self.change(self.authority.stop, self.session.again)
        else:
            await self.change(self.authority.halt, machine.play)

    async def start(self, asked: Asked) -> None:
        choice = await asyncio.to_thread(next_choice, self.session.plan.choice, asked)
        await self.change(self.authority.stop, self.session.start, choice)
        self.answers.append({"done": True})

    async def change(self, before: Callable[[], None], action: Callable[..., Any], *arguments: Any) -> None:
        """Change what all pages see, after the machine rests, unless another page drives."""
        if self.authority.status(self.station).role == "watching":
            raise Problem("another page drives the machine and decides")
        before()
        await asyncio.to_thread(action, *arguments)

    async def save(self) -> None:
        path = await asyncio.to_thread(self.session.save)
        told = "; ".join(filter(None, (f"saved: {path}", self.session.repeated(path))))
        self.answer(told, href=f"/result/{quote(path.name)}")

    async def files(self) -> None:
        files = await asyncio.to_thread(self.session.files)
        self.answers.append({"files": files, "folders": [str(folder) for folder in self.session.folders]})

    async def machines(self) -> None:
        self.answers.append({"machines": await asyncio.to_thread(offered, self.session.plan.choice)})


ACTIONS: Mapping[str, Callable[[OpenPage, Asked], Any]] = {
    "shown": lambda page, asked: page.credit.shown(asked.get("number")),
    "take": lambda page, _: page.take(),
    "release": lambda page, _: page.authority.release(page.station),
    "choose": lambda page, asked: page.authority.choose(
        page.station, *(None if (v := asked.get(name)) is None else str(v) for name in ("pattern", "mode"))
    ),
    "set": lambda page, asked: page.authority.set(page.station, asked.get("name"), asked.get("value")),
    "toggle": lambda page, _: page.toggle(),
    "speed": lambda page, asked: page.change(
        page.authority.halt, page.session.speed, finite(asked.get("factor"), "speed")
    ),
    "again": lambda page, _: page.change(page.authority.stop, page.session.again),
    "start": lambda page, asked: page.start(asked),
    "save": lambda page, _: page.save(),
    "files": lambda page, _: page.files(),
    "machines": lambda page, _: page.machines(),
}


def action(raw: str | bytes) -> Asked | None:
    """The action in a message; None for anything else."""
    if not isinstance(raw, str) or not raw.startswith('{"do":') or len(raw) > LONGEST:
        return None
    try:
        asked: Asked = json.loads(raw)
    except (ValueError, RecursionError):
        return None
    return asked if isinstance(asked["do"], str) and asked["do"] in ACTIONS else None


def offered(now: MachineChoice) -> dict[str, Any]:
    """The choices before a start: systems in the same folder, poses, and variants by component."""
    parts = {
        part: list(dict.fromkeys([*filter(None, [now.swap.get(part)]), *names]))
        for part, names in variants(now.system).items()
    }
    beside = sorted(path.name for path in now.system.parent.glob("*.ssp"))
    return {
        "systems": list(dict.fromkeys([now.system.name, *beside])),
        "poses": list(poses(now.system)),
        "variants": parts,
        "chosen": {"system": now.system.name, "pose": now.pose, "swap": dict(now.swap)},
    }


def next_choice(now: MachineChoice, asked: Asked) -> MachineChoice:
    """What a page chooses; a `Problem` for what was not offered, such as a file elsewhere."""
    offer = offered(now)
    system, pose, swap = asked.get("system"), asked.get("pose"), asked.get("swap")
    if not isinstance(system, str) or system not in offer["systems"]:
        raise Problem(f"system: expected one of {', '.join(offer['systems'])}, found {ascii(system)[:60]}")
    if not isinstance(pose, str) or not isinstance(swap, dict):
        raise Problem("machine: expected a pose and the variants of components")
    for part, name in swap.items():
        if not isinstance(name, str) or name not in offer["variants"].get(part, ()):
            raise Problem(f"{ascii(part)[:60]}: no variant {ascii(name)[:60]} is offered")
    others = {part: name for part, name in swap.items() if name != USUAL}
    return MachineChoice(Path(now.system).with_name(system), pose, others, now.set, now.fault)
