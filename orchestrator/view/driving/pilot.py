"""What a browser may say about its sticks, and nothing else.

    {"n": 17, "sticks": [lx, ly, rx, ry], "dead_man": true}

n counts up within one connection; deflections are -1 to 1, x to the right, y away from the operator.

How many messages a connection may send: a bucket that fills at a steady rate.

The pages that are open, and what everybody may know about who drives.

Who drives, and when the machine goes to rest.

One seat per open page, one driver at most. The machine follows the sticks only while all of this holds:

    the seat has the controls; its last message is younger than `patience`; the machine runs; the dead-man is
    held, and was seen released since the controls were taken and since the last fault (so nothing starts by
    itself)

Everything else is rest: all driven inputs to their rest values. A driver that is silent for `absence`, or
whose page is closed, loses the controls. The live machine has its own `patience` behind this one.

All calls come from one thread, the server's event loop; times are of a clock that never goes back [s].
"""

from __future__ import annotations

import itertools
import json
import secrets
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from orchestrator.base.errors import Problem
from orchestrator.realtime.setup import Machine
from orchestrator.view.driving.commands import Full, Helm
from orchestrator.view.driving.sticks import Curve, StickAxes

LONGEST = 256  # bytes; an honest message has about 80
KEYS = {"n", "sticks", "dead_man"}


@dataclass(frozen=True)
class Message:
    """One look at the hands of the driver."""

    number: int
    sticks: StickAxes
    dead_man: bool


def parse(raw: str | bytes) -> Message:
    """The message; Problem tells in one line what is wrong with it. Never any other exception."""
    if isinstance(raw, bytes):
        raise Problem(f"message: expected text, found {len(raw)} bytes of binary data")
    # characters are counted before they are encoded: a huge message is not copied
    if len(raw) > LONGEST:
        raise Problem(f"message: expected at most {LONGEST} characters, found {len(raw)}")
    try:
        found = json.loads(raw, parse_constant=_constant)
    except (ValueError, RecursionError) as error:
        raise Problem("message: expected JSON, found something else") from error
    if not isinstance(found, dict) or set(found) != KEYS:
        raise Problem(f"message: expected an object with {', '.join(sorted(KEYS))}, found {_short(found)}")
    return Message(_number(found["n"]), _sticks(found["sticks"]), _switch(found["dead_man"]))


def _constant(word: str) -> float:
    raise ValueError(f"{word} is no JSON")


def _number(found: Any) -> int:
    if type(found) is not int or not 0 <= found < 2**53:
        raise Problem(f"message: n: expected a whole number from 0 to 2^53 - 1, found {_short(found)}")
    return found


def _sticks(found: Any) -> StickAxes:
    if not isinstance(found, list) or len(found) != 4:
        raise Problem(f"message: sticks: expected four numbers, found {_short(found)}")
    for value in found:
        # a bool is an int in Python; the comparison is false for what is not a number
        if type(value) not in (int, float) or not -1 <= value <= 1:
            raise Problem(f"message: sticks: expected numbers from -1 to 1, found {_short(value)}")
    return StickAxes(*map(float, found))


def _switch(found: Any) -> bool:
    if not isinstance(found, bool):
        raise Problem(f"message: dead_man: expected true or false, found {_short(found)}")
    return found


def _short(found: Any) -> str:
    text = ascii(found)
    return text if len(text) <= 60 else f"{text[:57]}..."


@dataclass
class Bucket:
    """`rate` messages per second in the long run [1/s], `depth` at once.

    An honest browser sends 33 per second; those that a slow network held up may come in a bunch.
    """

    rate: float = 100.0
    depth: float = 30.0
    content: float = 30.0
    when: float = 0.0

    def take(self, now: float) -> bool:
        """Whether one more message is allowed at the time `now` [s] of a clock that never goes back."""
        self.content = min(self.depth, self.content + self.rate * max(0.0, now - self.when))
        self.when = now
        if self.content < 1:
            return False
        self.content -= 1
        return True


MOST = 50  # pages at once; beyond that the oldest without a connection goes


@dataclass(eq=False)
class Seat:
    """A page in a browser; the key is known to that page only.

    number     of the last message that counted in this connection
    heard      when it came [s]
    held       that message said that the dead-man is held
    armed      the dead-man was seen released since the driver took over or since the last fault
    connection counts its connections; what an older one says no longer counts
    counts     of messages: "accepted", "refused", "old", "flood"
    why        what was wrong with the last refused one
    """

    name: str
    opened: float
    key: str = field(default_factory=lambda: secrets.token_urlsafe(16))
    number: int = -1
    heard: float = float("-inf")
    held: bool = False
    armed: bool = False
    connection: int = 0
    connected: bool = False
    bucket: Bucket = field(default_factory=Bucket)
    counts: Counter[str] = field(default_factory=Counter)
    why: str = ""


@dataclass(frozen=True)
class Status:
    """What a page shows about the controls.

    role      "driving", "watching" (somebody else drives) or "free" (nobody does)
    driver    name of who drives, or empty
    asked     name of who asks for the controls, or empty
    live      the machine follows the sticks now: the dead-man's lamp
    why       why it does not, in a few words, and what to do
    drives    the machine can be driven
    pattern, mode, modes
    counts    of messages of this page
    """

    role: str
    driver: str
    asked: str
    live: bool
    why: str
    drives: bool
    pattern: str
    mode: str
    modes: tuple[str, ...]
    counts: dict[str, int]


class Seats:
    """All open pages."""

    def __init__(self) -> None:
        self._all: list[Seat] = []
        self._names = itertools.count(1)

    def __contains__(self, seat: Seat) -> bool:
        return seat in self._all

    def add(self, now: float) -> Seat:
        """A new one, the latest; one that was opened and never connected may have to go for it."""
        spare = [seat for seat in self._all if not seat.connected]
        for seat in spare[: max(0, len(self._all) - MOST + 1)]:
            self._all.remove(seat)
        self._all.append(Seat(f"page {next(self._names)}", now))
        return self._all[-1]

    def remove(self, seat: Seat) -> None:
        """The page is gone; a second time nothing happens."""
        if seat in self._all:
            self._all.remove(seat)

    def find(self, key: str) -> Seat | None:
        """The seat of this key, compared without telling by the time taken how much of it was right."""
        given = key.encode()
        return next((seat for seat in self._all if secrets.compare_digest(seat.key.encode(), given)), None)


HOLD = "hold Space (or Shift) and move with W A S D and the arrows"
AFRESH = "let go of Space, then hold it again"


class Pilot:
    """Seats, their driver, and the watchdog; what the driver wants goes through the `Helm`."""

    def __init__(
        self,
        machine: Machine,
        patience: float = 0.25,
        absence: float = 1.0,
        full: Full = Full(),  # noqa: B008  frozen
        curve: Curve = Curve(),  # noqa: B008  frozen
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.machine, self._helm = machine, Helm(machine, full, curve, clock)
        self._patience, self._absence, self._clock = patience, absence, clock
        self._seats = Seats()
        self._driver: Seat | None = None
        self._asked: Seat | None = None

    def join(self) -> Seat:
        """A seat for a page that opens: it watches."""
        return self._seats.add(self._clock())

    def leave(self, seat: Seat) -> None:
        """The page is gone."""
        self.release(seat, "the driver's page was closed")
        self._seats.remove(seat)
        if self._asked is seat:
            self._asked = None

    def seat(self, key: str) -> Seat | None:
        """The seat of this key, or nothing."""
        return self._seats.find(key)

    def connect(self, seat: Seat) -> int:
        """A new connection of a page; the number of the last one, which alone counts."""
        seat.connection += 1
        seat.connected, seat.number = True, -1
        if self._driver is seat:
            self._rest("the connection was renewed")
        return seat.connection

    def disconnect(self, seat: Seat, connection: int) -> None:
        """A connection is lost: rest, and the controls are free."""
        if connection == seat.connection:
            seat.connected = False
            self.release(seat, "the connection to the driver was lost")

    def take(self, seat: Seat) -> bool:
        """The controls, if nobody has them; else a request that the driver sees."""
        self.check()
        if self._driver is None and self.machine.drives and seat in self._seats:
            self._driver = seat
            seat.heard = self._clock()
            self._rest(HOLD)
            if self._asked is seat:
                self._asked = None
        elif self._driver is not None and self._driver is not seat:
            self._asked = seat
        return self._driver is seat

    def release(self, seat: Seat, why: str = "nobody drives") -> None:
        """The driver lets go; of another seat nothing happens."""
        if self._driver is seat:
            self._driver = None
            self._rest(why)

    def choose(self, seat: Seat, pattern_name: str | None = None, mode: str | None = None) -> None:
        """Another pattern or mode: by the driver, or by anybody when nobody drives. It rests first."""
        if self._driver not in (None, seat):
            raise Problem("controls: another page drives and chooses pattern and mode")
        self._helm.choose(pattern_name, mode)
        self._rest(HOLD)

    def hear(self, seat: Seat, connection: int, raw: str | bytes) -> bool:
        """A message from a page; False if it counts for nothing. Never raises.

        The watchdog looks first: after a halt of this server all that came meanwhile is read at once.
        """
        self.check()
        now = self._clock()
        if connection != seat.connection or not seat.bucket.take(now):
            seat.counts["flood" if connection == seat.connection else "old"] += 1
            return False
        try:
            message = parse(raw)
        except Problem as error:
            seat.counts["refused"] += 1
            seat.why = str(error)
            if self._driver is seat:
                self._rest("a message was not understood")
            return False
        if message.number <= seat.number:
            seat.counts["old"] += 1
            return False
        seat.number, seat.heard, seat.held = message.number, now, message.dead_man
        seat.counts["accepted"] += 1
        if self._driver is seat:
            self._follow(seat, message)
        return True

    def check(self) -> None:
        """The watchdog; to be called several times per `patience`."""
        if self._driver is None:
            return
        silence = self._clock() - self._driver.heard
        if silence > self._absence:
            self.release(self._driver, "the driver was silent")
        elif silence > self._patience and (self._helm.live or self._driver.armed):
            self._rest("no message from this page for a moment")

    def halt(self) -> None:
        """Rest before the machine is made to go on: who drives keeps the controls and holds afresh."""
        if self._driver is not None:
            self._rest(HOLD)

    def stop(self) -> None:
        """Nobody drives any more: the server ends, or the machine is another one."""
        self._driver = None
        self._rest("nobody drives")

    def status(self, seat: Seat | None = None) -> Status:
        """What the page of this seat shows."""
        role = "free" if self._driver is None else "driving" if self._driver is seat else "watching"
        helm = self._helm
        why = helm.why if self.machine.drives else "a replay cannot be driven"
        if seat is not None and self._driver is seat and seat.held and not seat.armed:
            why = AFRESH if why == HOLD else f"{why}: {AFRESH}"
        return Status(
            role=role,
            driver=self._driver.name if self._driver else "",
            asked=self._asked.name if self._asked else "",
            live=helm.live,
            why="" if helm.live else why,
            drives=self.machine.drives,
            pattern=helm.pattern,
            mode=helm.mode,
            modes=helm.modes,
            counts=dict(seat.counts) if seat else {},
        )

    def _follow(self, seat: Seat, message: Message) -> None:
        if not message.dead_man:
            if self._helm.live or not seat.armed:  # once; it is said 30 times a second
                self._rest(HOLD)
            seat.armed = True
        elif seat.armed:
            seat.armed = self._helm.steer(message.sticks)

    def _rest(self, why: str) -> None:
        """Rest, and nothing moves again before the dead-man was seen released."""
        if self._driver is not None:
            self._driver.armed = False
        self._helm.rest(why)
