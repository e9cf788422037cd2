"""A pilot with a clock that the test moves, its machine, and pages that send."""

from __future__ import annotations

import json

from view.standin import StandIn

from orchestrator.view.driving.pilot import Pilot, Seat

LEFT = (-1, 0, 0, 0)


class Desk:
    """A pilot, its machine, and pages that send."""

    def __init__(self) -> None:
        self.now = 100.0
        self.machine = StandIn()
        self.pilot = Pilot(self.machine, patience=0.25, absence=1.0, clock=lambda: self.now)
        self.numbers: dict[str, int] = {}

    def page(self) -> Seat:
        seat = self.pilot.join()
        self.pilot.connect(seat)
        return seat

    def driver(self) -> Seat:
        """A page that drives to the left."""
        seat = self.page()
        assert self.pilot.take(seat)
        self.say(seat, dead_man=False)
        self.say(seat)
        assert self.machine.moving
        return seat

    def say(
        self, seat: Seat, dead_man: object = True, n: int | None = None, sticks: object = (-1, 0, 0, 0)
    ) -> bool:
        """A message 30 ms after the last one."""
        self.now += 0.03
        number = self.numbers[seat.key] = self.numbers.get(seat.key, -1) + 1 if n is None else n
        raw = json.dumps({"n": number, "sticks": list(sticks), "dead_man": dead_man})
        return self.pilot.hear(seat, seat.connection, raw)

    def wait(self, seconds: float) -> None:
        """The watchdog looks every 50 ms."""
        for _ in range(round(seconds / 0.05)):
            self.now += 0.05
            self.pilot.check()
