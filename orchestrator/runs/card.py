"""The accuracy card: how fast a run was, and how far its result can be trusted."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from orchestrator.files.trace import Trace
from orchestrator.runs.energy import BondEnergy

ESTIMATE = "change when the step is halved; at order p the error is 2^p / (2^p - 1) of it"
ADAPTIVE = "change at a tenth of the tolerance; the error is 1.1 to 1.5 times that"
STILL = 1e-6  # of the nominal value: what moves less stands still
ALIKE, FLOOR = 1e-9, 1e-12  # without nominal value: of the largest range in the same unit; in any unit
IDLE, REST = 1e-9, 1e-12  # of the busiest bond, [J]: what exchanges less is at rest
TOO_MUCH = 0.05  # of the energy exchanged: no more a small error of the coupling
LITTLE = 1e-2  # of the busiest bond: of what exchanges less the residual counts, not its share


@dataclass(frozen=True)
class SignalError:
    """What halving the step changes of one signal; its error at order p is 2^p / (2^p - 1) times that.

    Of an adaptive run what a tenth of the tolerance changes. An error in proportion to the tolerance is 1.1
    times that; one in proportion to its root, of hermite where FMUs hold inputs, is 1.5 times that.

    largest, rms   over the signal's range
    change         the largest, in `unit`
    order          measured order of convergence, from a third run at twice the step; None when unknown
    """

    name: str
    largest: float
    rms: float
    order: float | None = None
    unit: str = ""
    change: float = 0.0


@dataclass(frozen=True)
class Card:
    """Facts about one run. Times in [s].

    step        communication step, of adaptive runs the mean
    steps       that were taken and stand
    passes      over all components, in all steps
    repeated    steps that did not stand
    lengths     shortest and longest step
    adaptive    tolerance of an adaptive run; None: all steps are equal
    record_step 0: every communication point
    inside      component -> time in its steps, the rest of the wall time is coupling and recording
    """

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
    inside: Mapping[str, float] = field(default_factory=dict)
    passes: int = 0
    repeated: int = 0
    lengths: tuple[float, float] = (0.0, 0.0)
    adaptive: float | None = None

    @property
    def real_time_factor(self) -> float:
        """Simulated time over wall time: above 1 is faster than real time."""
        return self.simulated / self.wall if self.wall > 0 else float("inf")

    @property
    def worst(self) -> list[SignalError]:
        """The largest change of each unit, in the order in which the signals were declared."""
        found: dict[str, SignalError] = {}
        for e in self.errors:
            if e.unit not in found or e.change > found[e.unit].change:
                found[e.unit] = e
        return list(found.values())

    def _steps(self) -> str:
        """How many steps, how long, and how often they were computed."""
        if self.adaptive is None:
            told = f"step {self.step:.6g} s, {self.steps} steps"
        else:
            shortest, longest = (f"{1e3 * length:.3g}" for length in self.lengths)
            told = f"tolerance {self.adaptive:g}, {self.steps} steps of {shortest} to {longest} ms"
        if (each := f"{self.passes / max(self.steps, 1):.3g}") not in ("0", "1"):
            told += f", {each} passes each"
        return told + (f", {self.repeated} repeated" if self.repeated else "")

    def _made_up(self) -> list[str]:
        """Bonds whose coupling made up or lost so much that the run is not to be trusted."""
        most = max((b.exchanged for b in self.bonds), default=0.0)
        wrong = [b for b in self.bonds if b.exchanged >= LITTLE * most > 0 and abs(b.relative) > TOO_MUCH]
        return [
            f"the coupling {'made up' if b.residual > 0 else 'lost'} {abs(b.relative):.1%} of the energy of"
            f" {b.name}: the run is not to be trusted, take shorter steps"
            for b in wrong
        ]

    def bond(self, bond: BondEnergy) -> tuple[str, str, str]:
        """Energy that the coupling made up (+) or lost (-) [J], what it exchanged [J], and their ratio."""
        most = max(b.exchanged for b in self.bonds)
        if bond.exchanged <= max(REST, IDLE * most):
            return "", "", "no exchange"
        share = f"{bond.relative:.1e}" if bond.exchanged >= LITTLE * most else "-"
        return f"{bond.residual:.3g}", f"{bond.exchanged:.4g}", share

    def text(self) -> str:
        """The card as lines of text."""
        lines = [
            f"master {self.master}, {self._steps()}, {self.simulated:.6g} s simulated",
            f"wall time {self.wall:.3g} s, {self.real_time_factor:.3g} times real time",
        ]
        if self.inside:
            each = (f"{name} {spent:.2g} s" for name, spent in self.inside.items())
            lines += [f"inside the FMUs {sum(self.inside.values()):.2g} s: {', '.join(each)}"]
        if busy := [row for row in _bond_rows(self) if row[1]]:
            lines += ["", *_table(["power bond", "residual [J]", "exchanged [J]", "share"], busy)]
        elif self.bonds:
            lines += ["", "no power bond exchanges energy"]
        if self.errors:
            head = ["worst signal of each unit", "change", "", "of range", "order"]
            told, shown = (ESTIMATE, 5) if self.adaptive is None else (ADAPTIVE, 4)  # no order
            lines += ["", told, *_table(head[:shown], [_error_row(e)[:shown] for e in self.worst])]
        lines += ["", *(f"note: {n}" for n in self.notes)] if self.notes else []
        warnings = [*self._made_up(), *self.warnings]
        lines += ["", *(f"warning: {w}" for w in warnings)] if warnings else []
        return "\n".join(lines)


def compare(
    fine: Trace,
    trace: Trace,
    coarse: Trace | None = None,
    nominals: Mapping[str, float | None] | None = None,
) -> tuple[SignalError, ...]:
    """Error estimates for `trace` from a run at half its step and, for the order, one at twice its step.

    Compared are the points that both runs recorded. Signals that stand still, measured by the magnitudes
    `nominals`, are left out; those whose change is at the level of rounding get no order.
    """
    errors = []
    changes = _changes(fine, trace)
    before = _changes(trace, coarse.select(trace.signals)) if coarse else {}
    for name, span in _moving(fine.select(trace.signals), nominals or {}).items():
        largest, rms = float(np.max(np.abs(changes[name]))), _rms(changes[name])
        order = None if rms < 1e-11 * span or name not in before else _order(_rms(before[name]), rms)
        errors.append(SignalError(name, largest / span, rms / span, order, fine.units.get(name, ""), largest))
    return tuple(errors)


def _moving(trace: Trace, nominals: Mapping[str, float | None]) -> dict[str, float]:
    """The range of each signal that moves."""
    spans = {name: float(np.ptp(values)) for name, values in trace.signals.items()}
    widest: dict[str, float] = {}
    for name, span in spans.items():
        unit = trace.units.get(name, "")
        widest[unit] = max(span, widest.get(unit, 0.0))
    least = {
        name: STILL * nominal if (nominal := nominals.get(name)) else max(ALIKE * widest[unit], FLOOR)
        for name, unit in ((name, trace.units.get(name, "")) for name in spans)
    }
    return {name: span for name, span in spans.items() if span > abs(least[name])}


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
    return [[b.name, *card.bond(b)] for b in card.bonds]


def _error_row(e: SignalError) -> list[str]:
    order = "" if e.order is None else f"{e.order:.2f}"
    return [e.name, f"{e.change:.2e}", e.unit, f"{e.largest:.1e}", order]


def _table(head: list[str], rows: list[list[str]]) -> list[str]:
    """Columns padded to equal width, numbers to the right."""
    widths = [max(len(r[i]) for r in [head, *rows]) for i in range(len(head))]
    return [
        "  ".join(
            c.ljust(w) if i == 0 else c.rjust(w) for i, (c, w) in enumerate(zip(r, widths, strict=True))
        )
        for r in [head, *rows]
    ]
