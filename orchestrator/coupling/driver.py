"""A scenario bound to the inputs it drives."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from orchestrator.coupling.drive import Drive
from orchestrator.coupling.wiring import Wiring
from orchestrator.system.system import Port


class Driver:
    """Sets driven inputs at communication points, and knows what they will be at the next one.

    moving   the driven inputs that are continuous, which move at a straight line over a step
    coming   their values at the time looked up last, shape (n,)
    middle   their values at the middle of the step looked up last, shape (n,)
    steady   places of the other Real ones, which keep the value of the last sample
    held     places of the driven inputs that are no Real numbers
    """

    def __init__(self, wiring: Wiring, drive: Drive) -> None:
        self.table = drive.table
        self.writers = [
            wiring.writer(bank, b)
            for bank in (wiring.real, wiring.whole)
            for b in bank.blocks
            if any(p in drive.columns for p in b.ports)
        ]
        self.moving = [p for p in drive.columns if wiring.system.variable(p).is_continuous]
        held = [p for p in drive.columns if not wiring.system.variable(p).is_real]
        steady = [p for p in drive.columns if p not in self.moving and p not in held]
        self._real, self._whole = wiring.real.values, wiring.whole.values
        self.targets, self.steady = wiring.real.places(self.moving), wiring.real.places(steady)
        self.held = wiring.whole.places(held)
        self.columns = self._column(drive, self.moving)
        self.steady_columns, self.held_columns = self._column(drive, steady), self._column(drive, held)
        self.factor, self.offset = self._map(drive, self.moving)
        self.steady_factor, self.steady_offset = self._map(drive, steady)
        self.coming = np.zeros(len(self.moving))
        self.middle = np.zeros(len(self.moving))
        self._when: float | None = None

    def _column(self, drive: Drive, ports: list[Port]) -> NDArray[np.intp]:
        return np.array([drive.columns[p][0] for p in ports], dtype=np.intp)

    def _map(self, drive: Drive, ports: list[Port]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        maps = [drive.columns[p][1] for p in ports]
        return np.array([m.factor for m in maps]), np.array([m.offset for m in maps])

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
        if len(self.steady):
            latest = self.table.sample(t)[self.steady_columns]
            self._real[self.steady] = latest * self.steady_factor + self.steady_offset
        if len(self.held):
            self._whole[self.held] = np.rint(self.table.sample(t)[self.held_columns])
        for write in self.writers:
            write()
