"""The energy that the coupling of a power bond makes up or loses during a run.

Component X receives the effort e and sends the flow f; component Y receives f and sends e. Over a step each
of them works with the input it was given, not with the true one, so the power that Y delivers and the power
that X takes differ:

    residual power = e_true f_used - e_used f_true            [W]

Its integral over the run is the energy that the coupling made up (+) or lost (-), summed step by step with
the trapezoidal rule. `used` at the end of a step is read back from the FMUs (or follows from the slope that
the master gave), so inputs that an FMU moves by itself inside the step are judged as what they were.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import groupby

import numpy as np
from numpy.typing import NDArray

from orchestrator.coupling.network import Network
from orchestrator.slaves.slave import Call, access
from orchestrator.system.bonds import Bond
from orchestrator.system.system import Port

ROWS = 1024  # steps between two summations


@dataclass(frozen=True)
class BondEnergy:
    """Energies of one bond over a run [J].

    residual    what the coupling made up; errors of opposite sign cancel
    turnover    the same without cancelling: the sum of its magnitude over the steps
    exchanged   integral of the magnitude of the power
    """

    name: str
    residual: float
    turnover: float
    exchanged: float

    @property
    def relative(self) -> float:
        """Residual over exchanged energy."""
        return self.residual / self.exchanged if self.exchanged > 0 else 0.0


class Monitor:
    """Watches the bonds of a network during a run; `energies` gives the sums so far.

    readers   calls that read back the bond inputs that the master does not move into `seen`
    """

    def __init__(self, network: Network, bonds: list[Bond]) -> None:
        ports = [p for b in bonds for p in (b.effort, b.flow)]
        self._bonds, self._values, self._used = bonds, network.real.values, network.used
        self.places = network.real.places(ports)
        self.moved = np.array([p in network.moving for p in ports], dtype=bool)
        back = sorted((p for p in ports if p not in network.moving), key=lambda p: _group(network, p))
        self.seen = np.zeros(len(back))
        self.spread = np.array([back.index(p) if p in back else -1 for p in ports], dtype=np.intp)
        self.readers = _readers(network, back, self.seen)
        self.step = np.zeros(ROWS)
        self.first, self.last, self.true = (np.zeros((ROWS, len(ports))) for _ in range(3))
        self._before = np.zeros(len(ports))
        self.rows = 0
        self._sums = np.zeros((3, len(bonds)))

    def begin(self) -> None:
        """Note the true values at the start of the run."""
        self._before = self._values[self.places]

    def stepped(self, h: float) -> None:
        """After a step of length h, before new inputs are set: note what the FMUs worked with."""
        if not self._bonds:
            return
        for read in self.readers:
            read()
        row = self.rows
        self.step[row] = h
        self.first[row] = np.where(self.moved, self._used[0, self.places], self._values[self.places])
        back = self.seen[self.spread] if len(self.seen) else 0.0
        self.last[row] = np.where(self.moved, self._used[1, self.places], back)

    def settled(self) -> None:
        """After new inputs are set: note what would have been true."""
        if not self._bonds:
            return
        self.true[self.rows] = self._values[self.places]
        self.rows += 1

    @property
    def full(self) -> bool:
        """The steps have to be added up before there is room for another one."""
        return self.rows == ROWS

    def sum(self) -> None:
        """Add up the steps since the last time."""
        n, self.rows = self.rows, 0
        end = self.true[:n]
        start = np.concatenate([self._before[None], end])[:n]
        self._before = end[-1].copy() if n else self._before
        h = 0.5 * self.step[:n, None]
        made = h * (_residual(start, self.first[:n]) + _residual(end, self.last[:n]))
        power = np.abs(start[:, 0::2] * start[:, 1::2]) + np.abs(end[:, 0::2] * end[:, 1::2])
        self._sums += np.array([made.sum(axis=0), np.abs(made).sum(axis=0), (h * power).sum(axis=0)])

    def energies(self) -> list[BondEnergy]:
        """The energies of all bonds up to now."""
        self.sum()
        return [BondEnergy(b.name, *(b.scale * self._sums[:, i])) for i, b in enumerate(self._bonds)]


def _group(network: Network, port: Port) -> tuple[str, str]:
    return port.component, access(network.system.variable(port))


def _readers(network: Network, ports: list[Port], into: NDArray[np.float64]) -> list[Call]:
    """One call per component and type; `ports` are sorted by them."""
    calls, first = [], 0
    for (component, _), group in groupby(ports, key=lambda p: _group(network, p)):
        names = [p.variable for p in group]
        calls.append(network.slaves[component].reader(names, into[first : first + len(names)]))
        first += len(names)
    return calls


def _residual(true: NDArray[np.float64], used: NDArray[np.float64]) -> NDArray[np.float64]:
    """Residual power, shape (steps, bonds), from columns that alternate effort and flow."""
    return true[:, 0::2] * used[:, 1::2] - used[:, 0::2] * true[:, 1::2]
