"""A run of one FMU under the names of a reference or layout that was made for a system of several.

A run against its reference: aligned, measured, judged.

Both are brought to the samples of the coarser of the two inside the window they share, by linear
interpolation; the reference is converted to the unit of the run.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from orchestrator.base.errors import Problem, UnknownSignal
from orchestrator.base.units import linear
from orchestrator.data.trace import Trace
from orchestrator.results.metrics import Metrics, Tolerance, measure
from orchestrator.results.reference import Reference, Signal


def by_variable(trace: Trace, wanted: Iterable[str]) -> Trace:
    """The signals of one FMU under the wanted names that differ from theirs by the component only.

    Wanted names that share a variable, such as a.flow and b.flow, stay unknown: the FMU has one at most.
    """
    names = dict.fromkeys(wanted)
    seen = Counter(_variable(name) for name in names)
    new = {_variable(name): name for name in names if seen[_variable(name)] == 1}

    def name(own: str) -> str:
        return new.get(_variable(own), own)

    signals = {name(own): values for own, values in trace.signals.items()}
    return Trace(trace.time, signals, {name(own): unit for own, unit in trace.units.items()})


def once(reference: Reference) -> Reference:
    """Without signals that are those of another one under the name of another component.

    One sensor on a line that feeds two components is one variable of the FMU that holds both.
    """
    kept: dict[str, Signal] = {}
    for name, signal in reference.signals.items():
        twins = (s for n, s in kept.items() if _variable(n) == _variable(name))
        if not any(np.array_equal(s.values, signal.values) and s.unit == signal.unit for s in twins):
            kept[name] = signal
    return replace(reference, signals=kept)


def _variable(name: str) -> str:
    return name.partition(".")[2]


Array = NDArray[np.float64]


@dataclass(frozen=True)
class Row:
    """One compared signal: samples of shape (n,) and numbers, all in `unit`; passed None: not judged."""

    signal: str
    label: str
    group: str
    unit: str
    time: Array
    simulation: Array
    reference: Array
    metrics: Metrics
    tolerance: Tolerance | None
    passed: bool | None
    notes: tuple[str, ...] = ()

    @property
    def title(self) -> str:
        """The label, else the signal's name."""
        return self.label or self.signal


@dataclass(frozen=True)
class Validation:
    """The outcome for all signals over the window (start, stop) [s]."""

    rows: tuple[Row, ...]
    window: tuple[float, float]
    title: str
    source: str
    about: Mapping[str, str | float]
    notes: tuple[str, ...] = ()

    @property
    def groups(self) -> dict[str, list[Row]]:
        """The rows by group, in the order of the reference."""
        found: dict[str, list[Row]] = {}
        for row in self.rows:
            found.setdefault(row.group, []).append(row)
        return found

    @property
    def judged(self) -> tuple[Row, ...]:
        """The rows that have a limit."""
        return tuple(row for row in self.rows if row.passed is not None)

    @property
    def failed(self) -> tuple[Row, ...]:
        """The rows that miss their limit."""
        return tuple(row for row in self.rows if row.passed is False)

    @property
    def passed(self) -> bool:
        """No signal misses its limit."""
        return not self.failed

    @property
    def verdict(self) -> str:
        """The outcome in a few words."""
        if not self.judged:
            return "not judged: the reference states no limits"
        inside = len(self.judged) - len(self.failed)
        return (
            f"{'pass' if self.passed else 'fail'}: {inside} of {len(self.judged)} signals within their limits"
        )

    def __getitem__(self, signal: str) -> Row:
        return next(row for row in self.rows if row.signal == signal)


def compare(trace: Trace, reference: Reference, *, rate: bool = True) -> Validation:
    """Compare every signal of the reference with the run; rate=False leaves the ISO rating out."""
    for name in reference.signals:
        if name not in trace.signals:
            raise UnknownSignal(name, trace.signals, f"{reference.source}: ")
    grid, notes = common_grid(trace.time, reference)
    return Validation(
        rows=tuple(_row(signal, trace, reference, grid, rate) for signal in reference.signals.values()),
        window=(float(grid[0]), float(grid[-1])),
        title=reference.title,
        source=reference.source,
        about=reference.about,
        notes=notes,
    )


def common_grid(run: Array, reference: Reference) -> tuple[Array, tuple[str, ...]]:
    """The samples [s] to compare on, those of the coarser side in the common window, and what was cut off."""
    sides = {"run": run, "reference": reference.time}
    start = max(run[0], reference.time[0], -np.inf if reference.start is None else reference.start)
    stop = min(run[-1], reference.time[-1], np.inf if reference.stop is None else reference.stop)
    spans = "; ".join(f"the {name} covers {t[0]:g} to {t[-1]:g} s" for name, t in sides.items())
    inside = {name: t[_inside(t, start, stop)] for name, t in sides.items()}
    coarse = min(inside, key=lambda name: len(inside[name]))
    if len(inside[coarse]) < 2:
        ends = {"begins": reference.start, "ends": reference.stop}
        asked = [f"{verb} at {t:g} s" for verb, t in ends.items() if t is not None]
        wanted = f"; the window asked for {' and '.join(asked)}" if asked else ""
        raise Problem(
            f"{reference.source}: expected two or more samples in a common window, "
            f"got {len(inside[coarse])}; {spans}{wanted}"
        )
    grid = inside[coarse]
    notes = [f"compared at the {len(grid)} samples of the {coarse}, {grid[0]:g} to {grid[-1]:g} s"]
    fine = "reference" if coarse == "run" else "run"
    if between := _between(grid, sides[fine]):
        notes.append(f"{between} of them lie between the samples of the {fine}: interpolated linearly")
    if any(not _inside(t, grid[0], grid[-1]).all() for t in sides.values()):
        notes.append(f"the window was cut: {spans}")
    return grid, tuple(notes)


def _inside(time: Array, start: float | None, stop: float | None) -> NDArray[np.bool_]:
    """Which samples lie in a window [s], with room for the rounding of times in a text file."""
    first, last = -np.inf if start is None else start, np.inf if stop is None else stop
    slack = 1e-9 * max([1.0, *(abs(t) for t in (first, last) if np.isfinite(t))])
    inside: NDArray[np.bool_] = (time >= first - slack) & (time <= last + slack)
    return inside


def _between(grid: Array, time: Array) -> int:
    """How many points of a grid meet no sample, apart from rounding."""
    slack = 1e-6 * float(np.median(np.diff(time)))
    at_or_after = np.minimum(np.searchsorted(time, grid - slack), len(time) - 1)
    return int(np.sum(np.abs(time[at_or_after] - grid) > slack))


def _row(signal: Signal, trace: Trace, reference: Reference, grid: Array, rate: bool) -> Row:
    """One signal on the common samples, measured and judged."""
    where = f"{reference.source}: {signal.name}"
    unit = trace.units.get(signal.name, "")
    notes: tuple[str, ...] = ()
    if not unit:
        unit, notes = signal.unit, (f"the run states no unit, {signal.unit!r} of the reference assumed",)
    factor, offset = linear(signal.unit, unit, where)
    tolerance = signal.tolerance
    if tolerance is not None and tolerance.in_unit:
        tolerance = replace(tolerance, limit=tolerance.limit * factor)
    _finite(trace.time, trace[signal.name], f"run: {signal.name}")
    simulated = np.interp(grid, trace.time, trace[signal.name])
    recorded = factor * signal.values + offset
    truth = np.interp(grid, reference.time, recorded)
    span = None if signal.span is None else signal.span * factor
    whole = recorded[_inside(reference.time, reference.start, reference.stop)]
    metrics = measure(grid, simulated, truth, span=span, whole=whole, rate=rate, where=where)
    return Row(
        signal=signal.name,
        label=signal.label,
        group=signal.group,
        unit=unit,
        time=grid,
        simulation=simulated,
        reference=truth,
        metrics=metrics,
        tolerance=tolerance,
        passed=None if tolerance is None else tolerance.holds(metrics),
        notes=notes + metrics.notes,
    )


def _finite(time: Array, values: Array, where: str) -> None:
    bad = np.flatnonzero(~np.isfinite(values))
    if len(bad):
        raise Problem(f"{where}: expected finite numbers, got {values[bad[0]]} at {time[bad[0]]:g} s")
