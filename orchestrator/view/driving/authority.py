"""Who has control: one operator station per open page, one driver at most, and the watchdog over the driver.

The machine follows the sticks only while all of this holds:

    the station has the controls; its last message is younger than `timeout`; the machine runs; the dead-man
    is held, and was seen released since the controls were taken and since the last fault (so nothing starts
    by itself)

Everything else is rest: all driven inputs go to their rest values. A driver that is silent for
`silence_limit`, or whose page is closed, loses the controls. The machine's process has a `timeout` of its own
behind this one.

All calls come from one thread, the server's event loop; times are of a clock that never goes back [s].
"""

from __future__ import annotations

import itertools
import logging
import secrets
import time
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from orchestrator.base.errors import Problem
from orchestrator.realtime.setup import Frame, Machine
from orchestrator.view.driving.sticks import (
    Message,
    ResponseCurve,
    StickAxes,
    commands,
    functions,
    left_over,
    legend,
    modes,
    parse,
    pattern,
)
from orchestrator.view.view_description import DriveMode, FunctionWords

Modes = Callable[[], Mapping[str, DriveMode]]

MOST = 50  # pages at once; beyond that the oldest without a connection goes
STILL = 0.5  # s without a new frame: a machine that hangs must not go on by itself when it comes back
log = logging.getLogger(__name__)
HOLD = "hold Space (or Shift) and move with W A S D and the arrows"
AFRESH = "let go of Space, then hold it again"


@dataclass
class TokenBucket:
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


@dataclass(eq=False)
class OperatorStation:
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
    bucket: TokenBucket = field(default_factory=TokenBucket)
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


class CommandGate:
    """The only way from a browser to `Machine.command`.

    live   the machine follows the sticks now
    why    it does not, in a few words
    """

    def __init__(
        self, machine: Machine, known: Modes, curve: ResponseCurve, clock: Callable[[], float]
    ) -> None:
        """known: the modes by name, as the machine says them now; clock: [s], never goes back"""
        self.machine, self._known, self.curve = machine, known, curve
        self.live, self.why = False, "nobody drives"
        self._clock, self._frame, self._seen = clock, -1, clock()
        self._pattern, self._mode = pattern("ISO"), ""

    # ---- what the sticks mean

    @property
    def pattern(self) -> str:
        """The name of the pattern."""
        return self._pattern.name

    @property
    def modes(self) -> tuple[str, ...]:
        """In which the machine can be driven."""
        return modes(self._known(), self.machine.axes)

    @property
    def mode(self) -> str:
        """The chosen mode, or the first that the machine has: a restart may have changed it."""
        return self._mode if self._mode in self.modes else next(iter(self.modes), "")

    @property
    def legend(self) -> dict[str, str]:
        """What each end of each axis of the sticks does."""
        mode = self._known().get(self.mode)
        return legend(self._pattern, mode.words if mode else FunctionWords())

    def choose(self, name: str | None, mode: str | None) -> None:
        """Another pattern or mode; Problem for one that there is not."""
        if name is not None:
            self._pattern = pattern(name)
        if mode is not None:
            if mode not in self.modes:
                raise Problem(f"mode: expected one of {', '.join(self.modes)}, found {mode}")
            self._mode = mode

    # ---- what the machine does

    def steer(self, sticks: StickAxes) -> bool:
        """The sticks as they are now; False if something is wrong, so that nothing may go on by itself."""
        try:
            frame = self.machine.latest()
            if halt := self._halt(frame):
                return self._refused(halt)
            wanted = functions(sticks, self._pattern, self.curve)
            if not self.mode:
                return self._refused("this machine has nothing that sticks can drive")
            values = commands(wanted, self._known()[self.mode], self.machine.axes)
            if left_over(values, self.machine.axes, frame.axes):
                self.rest("the machine comes to rest before it changes the mode")
                return True
            self.machine.command(values)
        except Problem as error:
            return self._refused(str(error))
        except Exception:  # a machine that breaks must not take the server with it
            log.exception("the machine takes no command")
            return self._refused("the machine takes no command")
        self.live, self.why = True, ""
        return True

    def rest(self, why: str) -> None:
        """All driven inputs to rest."""
        self.live, self.why = False, why
        try:
            self.machine.command({})
        except Exception:
            log.exception("the machine takes no command")

    def _refused(self, why: str) -> bool:
        self.rest(why)
        return False

    def _halt(self, frame: Frame) -> str:
        """Why the machine does not go on; empty if it does."""
        now = self._clock()
        if frame.number != self._frame:
            self._frame, self._seen = frame.number, now
        if frame.state != "running":
            return f"the machine is {frame.state}"
        return "the machine stands still" if now - self._seen > STILL else ""


class ControlAuthority:
    """The operator stations, their driver, and the watchdog; commands go through the `CommandGate`."""

    def __init__(
        self,
        machine: Machine,
        known: Modes,
        timeout: float = 0.25,
        silence_limit: float = 1.0,
        curve: ResponseCurve = ResponseCurve(),  # noqa: B008  frozen
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.machine, self._gate = machine, CommandGate(machine, known, curve, clock)
        self._timeout, self._silence_limit, self._clock = timeout, silence_limit, clock
        self._stations: list[OperatorStation] = []
        self._names = itertools.count(1)
        self._driver: OperatorStation | None = None
        self._asked: OperatorStation | None = None

    def join(self) -> OperatorStation:
        """A station for a page that opens: it watches. Of too many, the unconnected ones have to go."""
        spare = [station for station in self._stations if not station.connected]
        for station in spare[: max(0, len(self._stations) - MOST + 1)]:
            self._stations.remove(station)
        self._stations.append(OperatorStation(f"page {next(self._names)}", self._clock()))
        return self._stations[-1]

    def leave(self, station: OperatorStation) -> None:
        """The page is gone."""
        self.release(station, "the driver's page was closed")
        if station in self._stations:
            self._stations.remove(station)
        if self._asked is station:
            self._asked = None

    @property
    def legend(self) -> dict[str, str]:
        """What each end of each axis of the sticks does, for the page."""
        return self._gate.legend

    def station(self, key: str) -> OperatorStation | None:
        """The station of this key, compared in a time that does not tell how much of it was right."""
        given = key.encode()
        return next((s for s in self._stations if secrets.compare_digest(s.key.encode(), given)), None)

    def connect(self, station: OperatorStation) -> int:
        """A new connection of a page; the number of the last one, which alone counts."""
        station.connection += 1
        station.connected, station.number = True, -1
        if self._driver is station:
            self._rest("the connection was renewed")
        return station.connection

    def disconnect(self, station: OperatorStation, connection: int) -> None:
        """A connection is lost: rest, and the controls are free."""
        if connection == station.connection:
            station.connected = False
            self.release(station, "the connection to the driver was lost")

    def take(self, station: OperatorStation) -> bool:
        """The controls, if nobody has them; else a request that the driver sees."""
        self.check()
        if self._driver is None and self.machine.drives and station in self._stations:
            self._driver = station
            station.heard = self._clock()
            self._rest(HOLD)
            if self._asked is station:
                self._asked = None
        elif self._driver is not None and self._driver is not station:
            self._asked = station
        return self._driver is station

    def release(self, station: OperatorStation, why: str = "nobody drives") -> None:
        """The driver lets go; of another station nothing happens."""
        if self._driver is station:
            self._driver = None
            self._rest(why)

    def choose(
        self, station: OperatorStation, pattern_name: str | None = None, mode: str | None = None
    ) -> None:
        """Another pattern or mode: by the driver, or by anybody when nobody drives. It rests first."""
        if self._driver not in (None, station):
            raise Problem("controls: another page drives and chooses pattern and mode")
        self._gate.choose(pattern_name, mode)
        self._rest(HOLD)

    def hear(self, station: OperatorStation, connection: int, raw: str | bytes) -> bool:
        """A message from a page; False if it counts for nothing. Never raises.

        The watchdog looks first: after a halt of this server all that came meanwhile is read at once.
        """
        self.check()
        now = self._clock()
        if connection != station.connection or not station.bucket.take(now):
            station.counts["flood" if connection == station.connection else "old"] += 1
            return False
        try:
            message = parse(raw)
        except Problem as error:
            station.counts["refused"] += 1
            station.why = str(error)
            if self._driver is station:
                self._rest("a message was not understood")
            return False
        if message.number <= station.number:
            station.counts["old"] += 1
            return False
        station.number, station.heard, station.held = message.number, now, message.dead_man
        station.counts["accepted"] += 1
        if self._driver is station:
            self._follow(station, message)
        return True

    def check(self) -> None:
        """The watchdog; to be called several times per `timeout`."""
        if self._driver is None:
            return
        silence = self._clock() - self._driver.heard
        if silence > self._silence_limit:
            self.release(self._driver, "the driver was silent")
        elif silence > self._timeout and (self._gate.live or self._driver.armed):
            self._rest("no message from this page for a moment")

    def halt(self) -> None:
        """Rest before the machine is made to go on: who drives keeps the controls and holds afresh."""
        if self._driver is not None:
            self._rest(HOLD)

    def stop(self) -> None:
        """Nobody drives any more: the server ends, or the machine is another one."""
        self._driver = None
        self._rest("nobody drives")

    def status(self, station: OperatorStation | None = None) -> Status:
        """What the page of this station shows."""
        role = "free" if self._driver is None else "driving" if self._driver is station else "watching"
        gate = self._gate
        why = gate.why if self.machine.drives else "a replay cannot be driven"
        if station is not None and self._driver is station and station.held and not station.armed:
            why = AFRESH if why == HOLD else f"{why}: {AFRESH}"
        return Status(
            role=role,
            driver=self._driver.name if self._driver else "",
            asked=self._asked.name if self._asked else "",
            live=gate.live,
            why="" if gate.live else why,
            drives=self.machine.drives,
            pattern=gate.pattern,
            mode=gate.mode,
            modes=gate.modes,
            counts=dict(station.counts) if station else {},
        )

    def _follow(self, station: OperatorStation, message: Message) -> None:
        if not message.dead_man:
            if self._gate.live or not station.armed:  # once; it is said 30 times a second
                self._rest(HOLD)
            station.armed = True
        elif station.armed:
            station.armed = self._gate.steer(message.sticks)

    def _rest(self, why: str) -> None:
        """Rest, and nothing moves again before the dead-man was seen released."""
        if self._driver is not None:
            self._driver.armed = False
        self._gate.rest(why)
