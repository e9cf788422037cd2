"""One component in a plant: its places in the stacked arrays, its calls, its own derivatives."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol, cast

import numpy as np
from numpy.typing import NDArray

from orchestrator.coupling.tangent import Tangent
from orchestrator.linear.differences import differences
from orchestrator.linear.exchange import ExchangeSlave
from orchestrator.slaves.slave import Call, Slave

Array = NDArray[np.float64]


class Stacked(Protocol):
    """The arrays of all components: states, inputs, outputs, and time derivatives of the states."""

    x: Array
    v: Array
    y: Array
    f: Array


class Member:
    """One component: its places in the stacked arrays, and its calls."""

    def __init__(self, slave: ExchangeSlave, x: slice, v: slice, y: slice) -> None:
        self.slave, self.x, self.v, self.y = slave, x, v, y
        face = slave.interface
        self.inputs = [u.name for u in face.of("input") if u.is_continuous]
        self.outputs = [u.name for u in face.of("output") if u.is_continuous]

    def open(self, plant: Stacked) -> None:
        """Bind the calls to the arrays of the plant."""
        f, x, v, y = plant.f[self.x], plant.x[self.x], plant.v[self.v], plant.y[self.y]
        self._tangent = Tangent(cast(Slave, self.slave), self.inputs, self.outputs, f, x)
        self.starts = [*self._tangent.values, *self._rows(self.slave.reader, self.inputs, v)]
        self.writes = self._rows(self.slave.writer, self.inputs, v)
        self.reads = [*self._tangent.rates, *self._rows(self.slave.reader, self.outputs, y)]
        self._plant = plant

    def _rows(self, make: Any, names: Sequence[str], values: Array) -> list[Call]:
        return [make(names, values)] if names else []

    def look(self) -> None:
        """Set states and inputs, read derivatives and outputs."""
        self.slave.put(self._plant.x[self.x])
        for call in (*self.writes, *self.reads):
            call()

    def jacobian(self) -> Array:
        """d(f, y) / d(x, v) of this component."""
        if self.slave.interface.directional:
            return self._tangent.matrix()
        p = self._plant
        return differences(self.look, (p.x[self.x], p.v[self.v]), (p.f[self.x], p.y[self.y]))
