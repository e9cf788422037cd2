"""A authority with a clock that the test moves, its machine, and pages that send."""

from __future__ import annotations

import json

from view.modes import MODES
from view.standin import StandIn

from orchestrator.view.driving.authority import ControlAuthority, OperatorStation

LEFT = (-1, 0, 0, 0)


class Desk:
    """A authority, its machine, and pages that send."""

    def __init__(self) -> None:
        self.now = 100.0
        self.machine = StandIn()
        self.authority = ControlAuthority(
            self.machine, lambda: MODES, timeout=0.25, silence_limit=1.0, clock=lambda: self.now
        )
        self.numbers: dict[str, int] = {}

    def page(self) -> OperatorStation:
        station = self.authority.join()
        self.authority.connect(station)
        return station

    def driver(self) -> OperatorStation:
        """A page that drives to the left."""
        station = self.page()
        assert self.authority.take(station)
        self.say(station, dead_man=False)
        self.say(station)
        assert self.machine.moving
        return station

    def say(
        self,
        station: OperatorStation,
        dead_man: object = True,
        n: int | None = None,
        sticks: object = (-1, 0, 0, 0),
    ) -> bool:
        """A message 30 ms after the last one."""
        self.now += 0.03
        number = self.numbers[station.key] = self.numbers.get(station.key, -1) + 1 if n is None else n
        raw = json.dumps({"n": number, "sticks": list(sticks), "dead_man": dead_man})
        return self.authority.hear(station, station.connection, raw)

    def wait(self, seconds: float) -> None:
        """The watchdog looks every 50 ms."""
        for _ in range(round(seconds / 0.05)):
            self.now += 0.05
            self.authority.check()
