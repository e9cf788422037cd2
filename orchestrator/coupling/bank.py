"""The exchanged values of a run in flat arrays, and connections as index arrays into them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orchestrator.slaves.slave import Buffer, access
from orchestrator.system.system import Connection, Port, System


@dataclass(frozen=True)
class Block:
    """Variables of one component and one kind that are read or set in the same stages; a slice of a bank."""

    component: str
    kind: str
    stages: tuple[int, ...]
    ports: tuple[Port, ...]
    first: int


class Bank:
    """One array of values and where each port stands in it."""

    def __init__(self, dtype: Any) -> None:
        self.blocks: list[Block] = []
        self.index: dict[Port, int] = {}
        self.values: Buffer = np.zeros(0, dtype)

    def add(self, system: System, stages: Mapping[Port, tuple[int, ...]]) -> list[Block]:
        """Append ports, grouped into blocks."""
        groups: dict[tuple[str, str, tuple[int, ...]], list[Port]] = {}
        for port, when in stages.items():
            groups.setdefault((port.component, access(system.variable(port)), when), []).append(port)
        added = []
        for (component, kind, when), ports in groups.items():
            added.append(Block(component, kind, when, tuple(ports), len(self.index)))
            self.index.update({port: len(self.index) + i for i, port in enumerate(ports)})
        self.blocks += added
        self.values = np.zeros(len(self.index), self.values.dtype)
        return added

    def slice(self, block: Block) -> Buffer:
        """The values of one block, as a view."""
        return self.values[block.first : block.first + len(block.ports)]

    def places(self, ports: Iterable[Port]) -> NDArray[np.intp]:
        """Positions of ports in `values`."""
        return np.array([self.index[p] for p in ports], dtype=np.intp)


class Link:
    """Connections as index arrays into a bank; calling it copies the sources to the targets."""

    def __init__(self, bank: Bank, connections: Sequence[Connection]) -> None:
        self.source = bank.places(c.source for c in connections)
        self.target = bank.places(c.target for c in connections)
        self.values = bank.values
        self.factor = np.array([c.map.factor for c in connections]).astype(bank.values.dtype)
        self.offset = np.array([c.map.offset for c in connections]).astype(bank.values.dtype)
        self.plain = bool(np.all(self.factor == 1) and np.all(self.offset == 0))

    def __call__(self) -> None:
        values = self.values[self.source]
        self.values[self.target] = values if self.plain else values * self.factor + self.offset
