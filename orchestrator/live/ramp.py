"""A scenario of one frame: straight lines from what the inputs are to what they shall be at its end."""

from __future__ import annotations

import numpy as np

from orchestrator.coupling.drive import Table
from orchestrator.live.setup import Array


class Ramp(Table):
    """A table of two rows that is written anew for each frame, in place, because C has its address."""

    def __init__(self, begin: float, end: float, values: Array) -> None:
        """values, shape (axes,), hold from `begin` to `end` [s]."""
        super().__init__(np.array([begin, end]), np.stack([values, values]))

    def aim(self, begin: float, end: float, values: Array) -> None:
        """From the values at the end of the last frame to these, between two times [s]."""
        times, base, slopes, anchor = self.arrays
        base[0] = base[1] = base[2]
        base[2] = values
        np.subtract(base[2], base[1], out=slopes[1])
        slopes[1] /= end - begin
        times[0] = anchor[0] = anchor[1] = begin
        times[1] = anchor[2] = end
        self._time[:] = begin, end
        self._anchor[:] = begin, begin, end
