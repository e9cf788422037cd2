"""The accuracy card: how fast a run was, and how far its result can be trusted."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from orchestrator.energy import BondEnergy
from orchestrator.trace import Trace


@dataclass(frozen=True)
class SignalError:
    """Estimated error of one signal: its change when the step is halved, over the signal's range.

    order   measured order of convergence, from a third run at twice the step; None when unknown
    """

    name: str
    largest: float
    rms: float
    order: float | None = None


@dataclass(frozen=True)
class Card:
    """Facts about one run. Times in [s]."""

    master: str
    step: float
    record_step: float
    steps: int
    simulated: float
    wall: float
    bonds: tuple[BondEnergy, ...] = ()
    warnings: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    errors: tuple[SignalError, ...] = field(default=())

    @property
    def real_time_factor(self) -> float:
        """Simulated time over wall time: above 1 is faster than real time."""
        return self.simulated / self.wall if self.wall > 0 else float("inf")

    def text(self, worst: int = 8) -> str:
        """The card as lines of text."""
        length = f"{self.steps} steps, {self.simulated:.6g} s simulated"
        lines = [
            f"master {self.master}, step {self.step:.6g} s, {length}",
            f"wall time {self.wall:.3g} s, {self.real_time_factor:.3g} times real time",
        ]
        if self.bonds:
            lines += [
                "",
                *_table(["power bond", "residual [J]", "of exchanged", "exchanged [J]"], _bond_rows(self)),
            ]
        if self.errors:
            rows = [_error_row(e) for e in sorted(self.errors, key=lambda e: -e.largest)[:worst]]
            lines += ["", *_table(["change at half the step", "largest", "rms", "order"], rows)]
            lines += (
                [f"(the worst {worst} of {len(self.errors)} signals)"] if len(self.errors) > worst else []
            )
        lines += ["", *(f"note: {n}" for n in self.notes)] if self.notes else []
        lines += ["", *(f"warning: {w}" for w in self.warnings)] if self.warnings else []
        return "\n".join(lines)


def compare(fine: Trace, trace: Trace, coarse: Trace | None = None) -> tuple[SignalError, ...]:
    """Error estimates for `trace` from a run at half its step and, for the order, one at twice its step.

    Compared are the points that both runs recorded. Signals whose change is at the level of rounding get no
    order.
    """
    errors = []
    changes, before = _changes(fine, trace), _changes(trace, coarse) if coarse else {}
    for name, change in changes.items():
        span = float(np.ptp(fine[name])) or float(np.max(np.abs(fine[name]))) or 1.0
        largest, rms = float(np.max(np.abs(change))) / span, _rms(change) / span
        order = None if rms < 1e-11 or name not in before else _order(_rms(before[name]), rms * span)
        errors.append(SignalError(name, largest, rms, order))
    return tuple(errors)


def _changes(fine: Trace, trace: Trace) -> dict[str, NDArray[np.float64]]:
    """What the finer run changes of each signal; halving a step leaves the common times equal bit by bit."""
    _, a, b = np.intersect1d(fine.time, trace.time, assume_unique=True, return_indices=True)
    return {name: fine[name][a] - values[b] for name, values in trace.signals.items()}


def _order(before: float, change: float) -> float | None:
    """log2 of how much larger the change from 2h to h is than the one from h to h/2."""
    return float(np.log2(before / change)) if before > 0 else None


def _rms(values: NDArray[np.float64]) -> float:
    return float(np.sqrt(np.mean(np.square(values)))) if len(values) else 0.0


def _bond_rows(card: Card) -> list[list[str]]:
    return [
        [b.name, f"{b.residual:.4g}", f"{100 * b.relative:.3g} %", f"{b.exchanged:.5g}"] for b in card.bonds
    ]


def _error_row(e: SignalError) -> list[str]:
    return [e.name, f"{e.largest:.2e}", f"{e.rms:.2e}", "" if e.order is None else f"{e.order:.2f}"]


def _table(head: list[str], rows: list[list[str]]) -> list[str]:
    """Columns padded to equal width, numbers to the right."""
    widths = [max(len(r[i]) for r in [head, *rows]) for i in range(len(head))]
    return [
        "  ".join(
            c.ljust(w) if i == 0 else c.rjust(w) for i, (c, w) in enumerate(zip(r, widths, strict=True))
        )
        for r in [head, *rows]
    ]
