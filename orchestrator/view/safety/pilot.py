"""Who drives, and when the machine goes to rest.

One seat per open page, one driver at most. The machine follows the sticks only while all of this holds:

    the seat has the controls; its last message is younger than `patience`; the machine runs; the dead-man is
    held, and was seen released since the controls were taken and since the last fault (so nothing starts by
    itself)

Everything else is rest: all driven inputs to their rest values. A driver that is silent for `absence`, or
whose page is closed, loses the controls. The live machine has its own `patience` behind this one.

All calls come from one thread, the server's event loop; times are of a clock that never goes back [s].
"""

from __future__ import annotations

import time
from collections.abc import Callable

from orchestrator.errors import Problem
from orchestrator.live.setup import Machine
from orchestrator.view.controls.drive import Full
from orchestrator.view.controls.shape import Curve
from orchestrator.view.safety.helm import Helm
from orchestrator.view.safety.message import Message, parse
from orchestrator.view.safety.seat import Seat, Seats, Status

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
