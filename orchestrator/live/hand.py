"""What the operator wants, as long as he keeps saying so."""

from __future__ import annotations

from math import inf

from orchestrator.live.board import Orders
from orchestrator.live.setup import Array


class Hand:
    """The watchdog of the commands: without a new one for `patience` [s] the axes are wanted at rest.

    Age counts from when a command was first seen, on the clock of the one who looks.
    """

    def __init__(self, rest: Array, patience: float, serial: int) -> None:
        """serial: of a command that is too old already."""
        self._rest, self._patience, self._serial = rest, patience, serial
        self._values, self._seen = rest, -inf

    def wanted(self, orders: Orders, now: float) -> Array:
        """Values of the axes, shape (axes,), at `now` [s]."""
        if orders.serial != self._serial:
            self._serial, self._values, self._seen = orders.serial, orders.values, now
        return self._values if now - self._seen <= self._patience else self._rest
