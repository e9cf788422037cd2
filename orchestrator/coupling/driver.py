"""A scenario bound to the inputs it drives."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from orchestrator.coupling.drive import Drive
from orchestrator.system.system import Port

if TYPE_CHECKING:
    from orchestrator.coupling.network import Network


class Driver:
    """Sets driven inputs at communication points, and knows what they will be at the next one.

    moving   the driven Real inputs, which move at a straight line over a step
    coming   their values at the time looked up last, shape (n,)
    middle   their values at the middle of the step looked up last, shape (n,)
    """

    def __init__(self, network: Network, drive: Drive) -> None:
        self.table = drive.table
        self.writers = [
            network.writer(bank, b)
            for bank in (network.real, network.whole)
            for b in bank.blocks
            if any(p in drive.columns for p in b.ports)
        ]
        self.moving = [p for p in drive.columns if network.system.variable(p).is_real]
        held = [p for p in drive.columns if p not in self.moving]
        self._real, self._whole = network.real.values, network.whole.values
        self.targets, self.held = network.real.places(self.moving), network.whole.places(held)
        self.columns = self._column(drive, self.moving)
        self.held_columns = self._column(drive, held)
        self.factor = np.array([drive.columns[p][1].factor for p in self.moving])
        self.offset = np.array([drive.columns[p][1].offset for p in self.moving])
        self.coming = np.zeros(len(self.moving))
        self.middle = np.zeros(len(self.moving))
        self._when: float | None = None

    def _column(self, drive: Drive, ports: list[Port]) -> NDArray[np.intp]:
        return np.array([drive.columns[p][0] for p in ports], dtype=np.intp)

    def look(self, t: float) -> None:
        """Find the values at t [s]."""
        if t != self._when:
            self.coming = self.table.at(t)[self.columns] * self.factor + self.offset
            self._when = t

    def look_ahead(self, t: float, h: float) -> None:
        """Find the values at the middle and at the end of the step from t to t + h [s]."""
        self.look(t + 0.5 * h)
        self.middle = self.coming
        self.look(t + h)

    def put(self, t: float) -> None:
        """Set the driven inputs to their value at t [s]."""
        self.look(t)
        self._real[self.targets] = self.coming
        if len(self.held):
            self._whole[self.held] = np.rint(self.table.sample(t)[self.held_columns])
        for write in self.writers:
            write()
