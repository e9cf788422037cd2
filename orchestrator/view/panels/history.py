"""What was, thinned out for a chart: of each bin of time the lowest and the highest value stay."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from orchestrator.live.setup import Machine
from orchestrator.view.reading import Reading

Array = NDArray[np.float64]

WINDOW, BIN = 20.0, 0.2  # s, of simulated time


class History:
    """Lowest and highest values of some signals in the bins of the last `WINDOW`. All pages share it.

    names    those that there are
    number   of the last frame that is in it
    """

    def __init__(self, machine: Machine, reading: Reading, names: Sequence[str]) -> None:
        self.names = tuple(name for name in names if reading.knows(name))
        self._machine = machine
        self._columns = [reading.column(name) for name in self.names]
        self.number = -1
        self._bins = dict[int, Array]()  # bin -> shape (2, names)

    def look(self) -> None:
        """Take in the frames since the last look."""
        if not self.names:
            return
        if self.number < 0:  # of a long session the end is enough
            self.number = self._machine.latest().number - round(WINDOW / 0.01) - 1
        numbers, times, axes, values = self._machine.since(self.number)
        if not len(numbers):
            return
        if times[0] < self.end - BIN:  # started anew
            self._bins.clear()
        self.number = int(numbers[-1])
        table = np.stack(
            [(axes if c and c[0] == "axes" else values)[:, c[1] if c else 0] for c in self._columns], 1
        )
        self._add(np.floor(times / BIN).astype(int), table)

    @property
    def end(self) -> float:
        """The last time that is known, to a bin [s]."""
        return max(self._bins, default=0) * BIN

    def table(self) -> tuple[Array, Array]:
        """Times before the end [s], two for each bin, and values, shape (times, names)."""
        bins = sorted(self._bins)
        if not bins:
            return np.zeros(0), np.zeros((0, len(self.names)))
        last = bins[-1]
        times = np.array([(k - last + half) * BIN for k in bins for half in (-0.5, 0.0)])
        return times, np.concatenate([self._bins[k] for k in bins])

    def _add(self, bins: NDArray[np.int64], table: Array) -> None:
        for k in np.unique(bins):
            rows = table[bins == k]
            if k in self._bins:
                rows = np.concatenate((self._bins[k], rows))
            self._bins[int(k)] = extremes(rows)
        oldest = max(self._bins) - round(WINDOW / BIN)
        for k in [k for k in self._bins if k < oldest]:
            del self._bins[k]


def extremes(rows: Array) -> Array:
    """The lowest and the highest value of each column, in the order they came in, shape (2, columns)."""
    low, high = rows.argmin(axis=0), rows.argmax(axis=0)
    columns = np.arange(rows.shape[1])
    first, second = np.minimum(low, high), np.maximum(low, high)
    return np.stack((rows[first, columns], rows[second, columns]))
