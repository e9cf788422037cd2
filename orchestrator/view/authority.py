"""Control authority: which page drives the machine, and the watchdog of the driver.

Each connection of a page has an operator station; at most one station is the driver. The machine follows the
sticks only while all of these conditions hold:

    the station has the controls
    its last message is younger than `timeout`
    the machine runs
    the dead-man is held, and was released at least once since the controls were taken and since the last
    fault, so that nothing starts by itself

Otherwise all driven inputs go to their rest values. A driver that is silent for `silence_limit`, or whose
page is closed, loses the controls. The machine's process has a further `timeout`.

All calls come from one thread, the event loop of the server. Times are of a monotonic clock [s].
"""

import itertools
import logging
import math
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field

from orchestrator.base.errors import Problem, suggest
from orchestrator.base.signals import bare_name
from orchestrator.drive import sticks
from orchestrator.drive.sticks import Message, StickAxes, parse
from orchestrator.drive.view_description import ViewDescription
from orchestrator.realtime.machine import RealTimeMachine
from orchestrator.realtime.setup import Frame

Described = Callable[[], ViewDescription]
Clock = Callable[[], float]

STILL = 0.5  # s without a new frame, after which the machine counts as hanging
log = logging.getLogger(__name__)
HOLD = "hold Space (or Shift) and move with W A S D and the arrows"
SLIDE = "set the inputs by the sliders"
AGAIN = "release Space, then hold it again"


@dataclass
class TokenBucket:
    """Rate limit: `rate` messages per second on average [1/s], `depth` in a burst.

    A browser sends 33 per second; messages that a slow network delayed arrive in a burst.
    """

    rate: float = 100.0
    depth: float = 30.0
    content: float = 30.0
    when: float = 0.0

    def take(self, now: float) -> bool:
        """Is one more message allowed at time `now` [s] of a monotonic clock?"""
        self.content = min(self.depth, self.content + self.rate * max(0.0, now - self.when))
        self.when = now
        if self.content < 1:
            return False
        self.content -= 1
        return True


@dataclass(eq=False)
class OperatorStation:
    """The operator station of one page, as long as it is connected.

    number     number of the last accepted message
    heard      time of that message [s]
    held       True if the dead-man was held in that message
    armed      True if the dead-man was released since the driver took over and since the last fault
    counts     number of messages: "accepted", "refused", "old", "flood"
    """

    name: str
    number: int = -1
    heard: float = float("-inf")
    held: bool = False
    armed: bool = False
    bucket: TokenBucket = field(default_factory=TokenBucket)
    counts: Counter[str] = field(default_factory=Counter)


@dataclass(frozen=True)
class Status:
    """State of the controls for one page.

    role      "driving", "watching" (another page drives) or "free" (no page drives)
    driver    name of the driver, or empty
    asked     name of the station that requests the controls, or empty
    live      True while the machine follows the sticks: the lamp of the dead-man
    why       reason why it does not, and what to do
    pattern, mode, modes   control pattern, drive mode, available drive modes
    """

    role: str
    driver: str
    asked: str
    live: bool
    why: str
    pattern: str
    mode: str
    modes: tuple[str, ...]


def finite(value: object, name: str) -> float:
    """A number from a page; a `Problem` for anything else."""
    if not isinstance(value, int | float) or isinstance(value, bool) or not math.isfinite(value):
        raise Problem(f"{name}: expected a finite number, found {ascii(value)[:60]}")
    return float(value)


class CommandGate:
    """The only path from a browser to `RealTimeMachine.command`.

    live    True while the machine follows the sticks
    why     reason why it does not
    values  inputs that the driver has set by sliders
    """

    def __init__(self, machine: RealTimeMachine, described: Described, clock: Clock) -> None:
        """described: the current machine; clock: monotonic [s]."""
        self.machine, self._described = machine, described
        self.live, self.why = False, "nobody drives"
        self.values = dict[str, float]()
        self._clock, self._frame, self._seen = clock, -1, clock()
        self._pattern, self._mode = "", ""

    # ---- pattern and mode of the sticks

    @property
    def pattern(self) -> str:
        """The chosen control pattern, or the first one of this machine."""
        patterns = self._described().patterns
        return self._pattern if self._pattern in patterns else next(iter(patterns), "")

    @property
    def modes(self) -> tuple[str, ...]:
        """Names of the drive modes that the machine allows."""
        return sticks.modes(self._described().modes, self.machine.axes)

    @property
    def mode(self) -> str:
        """The chosen drive mode, or the first available one if a restart has removed it."""
        return self._mode if self._mode in self.modes else next(iter(self.modes), "")

    def choose(self, name: str | None, mode: str | None) -> None:
        """Choose pattern or mode. Raises `Problem` for an unknown one."""
        known = {"pattern": (name, tuple(self._described().patterns)), "mode": (mode, self.modes)}
        for what, (chosen, names) in known.items():
            if chosen is not None and chosen not in names:
                expected = f"expected one of {', '.join(names) or 'none'}"
                raise Problem(f"{what}: {expected}, found {chosen}{suggest(chosen, names)}")
        self._pattern, self._mode = name or self._pattern, mode or self._mode

    # ---- commands to the machine

    def steer(self, deflections: StickAxes) -> bool:
        """Command these deflections. Returns False after a fault: the driver must be armed again."""
        try:
            frame = self.machine.latest()
            if reason := self._halted(frame):
                return self._fault(reason)
            described = self._described()
            if not (self.mode and self.pattern):
                return self._fault("this machine has no input that sticks can drive")
            commanded = sticks.functions(deflections, described.patterns[self.pattern])
            mode = described.modes[self.mode]
            values = sticks.commands(commanded, mode, self.machine.axes, self.values)
            if sticks.uncommanded(values, self.machine.axes, frame.axes, described.modes.values()):
                self.rest("the machine comes to rest before it changes the mode")
                return True
            self.machine.command(values)
        except Problem as error:
            return self._fault(str(error))
        except Exception:  # an error of the machine must not end the server
            log.exception("the machine does not accept the command")
            return self._fault("the machine does not accept the command")
        self.live, self.why = True, ""
        return True

    def set(self, name: object, value: object) -> None:
        """Set an input, within the ends of its slider. Raises `Problem` for one that is not free."""
        described = self._described()
        names = sorted(described.free(self.machine.axes))
        if not isinstance(name, str) or name not in names:
            raise Problem(f"input: expected one of {', '.join(names) or 'none'}, found {ascii(name)[:60]}")
        ends = next((s.ends for s in described.sliders if s.name == name), (-math.inf, math.inf))
        self.values[name] = min(max(finite(value, name), ends[0]), ends[1])

    def keep(self) -> None:
        """Command again the inputs that are set, while the sticks rest."""
        if self.values:
            self._keep()

    def rest(self, why: str) -> None:
        """Command rest for all driven inputs, but for those that are set."""
        self.live, self.why = False, why
        self._keep()

    def _keep(self) -> None:
        """Command only the inputs that are set."""
        values, bare = self.values, {axis: bare_name(axis) for axis in self.machine.axes}
        try:
            self.machine.command({axis: values[name] for axis, name in bare.items() if name in values})
        except Exception:
            log.exception("the machine does not accept the command")

    def _fault(self, why: str) -> bool:
        self.rest(why)
        return False

    def _halted(self, frame: Frame) -> str:
        """Reason why the machine does not run; empty if it does."""
        now = self._clock()
        if frame.number != self._frame:
            self._frame, self._seen = frame.number, now
        if frame.state != "running":
            return f"the machine is {frame.state}"
        return "the machine does not move" if now - self._seen > STILL else ""


class ControlAuthority:
    """The operator stations, the driver among them, and the watchdog.

    stations   of the pages that are connected
    """

    def __init__(
        self,
        machine: RealTimeMachine,
        described: Described,
        timeout: float = 0.25,
        silence_limit: float = 1.0,
        clock: Clock = time.monotonic,
    ) -> None:
        self.machine = machine
        self._gate = CommandGate(machine, described, clock)
        self._timeout, self._silence_limit, self._clock = timeout, silence_limit, clock
        self.stations: list[OperatorStation] = []
        self._names = itertools.count(1)
        self._driver: OperatorStation | None = None
        self._asked: OperatorStation | None = None
        # the station that drove before; the reason concerns it alone
        self._last: OperatorStation | None = None

    def join(self) -> OperatorStation:
        """Add a station for a new connection."""
        self.stations.append(OperatorStation(f"page {next(self._names)}"))
        return self.stations[-1]

    def leave(self, station: OperatorStation) -> None:
        """Remove the station of a page that was closed or has lost its connection."""
        self.release(station, "the connection to the driver was lost")
        self.stations.remove(station)
        if self._asked is station:
            self._asked = None

    def take(self, station: OperatorStation) -> bool:
        """Take the controls if they are free; else request them from the driver."""
        self.check()
        if self._driver is None and station in self.stations:
            self._driver, self._last = station, None
            station.heard = self._clock()
            self._rest(HOLD)
            if self._asked is station:
                self._asked = None
        elif self._driver is not None and self._driver is not station:
            self._asked = station
        return self._driver is station

    def release(self, station: OperatorStation, why: str = "nobody drives") -> None:
        """Release the controls if this station is the driver."""
        if self._driver is station:
            self._driver, self._last = None, station
            self._gate.values.clear()
            self._rest(why)

    def choose(
        self, station: OperatorStation, pattern_name: str | None = None, mode: str | None = None
    ) -> None:
        """Choose pattern or mode, as the driver or while no page drives. The machine rests first."""
        if self._driver not in (None, station):
            raise Problem("controls: another page drives; only the driver chooses pattern and mode")
        self._gate.choose(pattern_name, mode)
        self._rest(HOLD)

    def set(self, station: OperatorStation, name: object, value: object) -> None:
        """Set an input that no stick drives, as the driver. It keeps the value as long as the page drives."""
        if self._driver is not station:
            raise Problem("controls: only the driver sets inputs")
        self._gate.set(name, value)

    def hear(self, station: OperatorStation, raw: str | bytes) -> bool:
        """Process a message from a page. Returns False if it is ignored. Never raises.

        The watchdog runs first, because after a delay of this server old messages arrive in a burst.
        """
        self.check()
        now = self._clock()
        if not station.bucket.take(now):
            station.counts["flood"] += 1
            return False
        if (message := parse(raw)) is None:
            station.counts["refused"] += 1
            if self._driver is station:
                self._rest("a message was not valid")
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
        """Run the watchdog. Call it several times per `timeout`."""
        if self._driver is None:
            return
        silence = self._clock() - self._driver.heard
        if silence > self._silence_limit:
            self.release(self._driver, "the driver was silent")
        elif silence > self._timeout and (self._gate.live or self._driver.armed or self._gate.values):
            self._gate.values.clear()
            self._rest("no message from this page for a moment")

    def halt(self) -> None:
        """Rest before a change. The driver keeps the controls and must hold the dead-man again."""
        if self._driver is not None:
            self._rest(HOLD)

    def stop(self) -> None:
        """Take the controls from the driver, because the server ends or the machine changes."""
        self._driver = None
        self._gate.values.clear()
        self._rest("nobody drives")

    def status(self, station: OperatorStation | None = None) -> Status:
        """State of the controls for the page of this station."""
        role = "free" if self._driver is None else "driving" if self._driver is station else "watching"
        gate, why = self._gate, self._gate.why
        if role == "free" and station not in (None, self._last):
            why = "the controls are free" if station is self._asked else "nobody drives"
        if role == "driving" and not gate.modes:
            why = SLIDE
        elif station is not None and self._driver is station and station.held and not station.armed:
            why = AGAIN if why == HOLD else f"{why}: {AGAIN}"
        return Status(
            role=role,
            driver=self._driver.name if self._driver else "",
            asked=self._asked.name if self._asked else "",
            live=gate.live,
            why="" if gate.live else why,
            pattern=gate.pattern,
            mode=gate.mode,
            modes=gate.modes,
        )

    def _follow(self, station: OperatorStation, message: Message) -> None:
        if not message.dead_man:
            if self._gate.live or not station.armed:  # once, not at each of 30 messages per second
                self._rest(HOLD)
            station.armed = True
        elif station.armed:
            station.armed = self._gate.steer(message.sticks)
        if not self._gate.live:
            self._gate.keep()

    def _rest(self, why: str) -> None:
        """Rest until the dead-man has been released and held again."""
        if self._driver is not None:
            self._driver.armed = False
        self._gate.rest(why)
