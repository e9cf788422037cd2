"""Validation of a run against a reference: resampling, metrics, limits.

1. Run and reference are resampled by linear interpolation at the samples of the coarser one in the common
   window; the reference is converted to the unit of the run.
2. Samples in a gap of a signal of the reference are left out of that signal, and counted in a note.
3. `metrics` computes the metrics of the error; one of them is judged if the signal has a limit.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from orchestrator.base.errors import Problem, UnknownSignal, suggest
from orchestrator.base.extras import require
from orchestrator.base.signals import found
from orchestrator.base.text import brief, first_names, grouped
from orchestrator.base.units import factor_and_offset
from orchestrator.data.description import Tolerance
from orchestrator.data.recording import Recording, read_recording
from orchestrator.data.table import Array
from orchestrator.data.trace import LARGEST_ROUNDING, Data, Trace, as_trace, inside, rounding
from orchestrator.engine.result import Result, metadata, read_run
from orchestrator.results.metrics import AT_REST, Metrics, measure
from orchestrator.results.rating import RATING


def by_variable(trace: Trace, requested: Iterable[str]) -> Trace:
    """The signals of one FMU with the names of a system of several FMUs: only the component differs.

    Requested names with the same variable, such as a.flow and b.flow, are not used: the FMU has one at most.
    """
    names = dict.fromkeys(requested)
    count = Counter(_variable(name) for name in names)
    new = {_variable(name): name for name in names if count[_variable(name)] == 1}
    renamed = {name: new.get(_variable(name), name) for name in trace.signals}
    signals = {renamed[name]: values for name, values in trace.signals.items()}
    return Trace(trace.time, signals, {renamed[name]: unit for name, unit in trace.units.items()})


def without_repetitions(reference: Recording) -> Recording:
    """Leave out signals that repeat the variable and the samples of another component.

    One sensor on a line to two components is one variable of an FMU that contains both components.
    """
    selected: dict[str, Array] = {}
    for name, values in reference.signals.items():
        same_variable = [n for n in selected if _variable(n) == _variable(name)]
        same = (np.array_equal(selected[n], values, equal_nan=True) for n in same_variable)
        if not any(same):
            selected[name] = values
    return reference.select(list(selected))


def _variable(name: str) -> str:
    return name.partition(".")[2]


@dataclass(frozen=True)
class ValidatedSignal:
    """One compared signal: samples of shape (n,) and metrics, in `unit`; `passed` is None without a limit.

    listed   False: the signal is judged like the others, but not listed while it passes
    """

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
    listed: bool = True

    __repr__ = brief

    @property
    def title(self) -> str:
        """The label, or the name if there is none."""
        return self.label or self.signal

    @property
    def judged_value(self) -> float | None:
        """Value of the judged metric; None if it is undefined, or if there is no limit."""
        return None if self.tolerance is None else self.metrics.value(self.tolerance.metric)

    @property
    def limit_use(self) -> float:
        """Fraction of the limit that is used: 1 at the limit, larger for a failed signal; 0 without limit."""
        return 0.0 if self.tolerance is None else self.tolerance.fraction_used(self.judged_value)


@dataclass(frozen=True)
class Validation:
    """The outcome for all signals over the window (start, stop) [s].

    unreliable   why the result of the run is not reliable, whatever the limits
    """

    rows: tuple[ValidatedSignal, ...]
    window: tuple[float, float]
    title: str
    source: str
    about: Mapping[str, str | float]
    notes: tuple[str, ...] = ()
    unreliable: tuple[str, ...] = ()

    def __repr__(self) -> str:
        start, stop = self.window
        failed = f"\nfailed: {first_names(row.signal for row in self.failed)}" if self.failed else ""
        return f"Validation with {self.title}, {start:g} to {stop:g} s\n{self.verdict}{failed}"

    @property
    def groups(self) -> dict[str, list[ValidatedSignal]]:
        """The rows by group, in the order of the reference."""
        return grouped(self.rows, lambda row: row.group)

    @property
    def judged(self) -> tuple[ValidatedSignal, ...]:
        """The rows that have a limit."""
        return tuple(row for row in self.rows if row.passed is not None)

    @property
    def failed(self) -> tuple[ValidatedSignal, ...]:
        """The rows that miss their limit."""
        return tuple(row for row in self.rows if row.passed is False)

    @property
    def passed(self) -> bool:
        """All signals are within their limits, and the result is reliable."""
        return not (self.failed or self.unreliable)

    @property
    def verdict(self) -> str:
        """The outcome as text."""
        if not self.judged:
            return "not judged: the reference has no limits (keys tolerance, or group and [tolerances])"
        inside = len(self.judged) - len(self.failed)
        outcome, count = "pass" if self.passed else "fail", len(self.judged)
        outcome += ", the result is not reliable" if self.unreliable else ""
        return f"{outcome}: {inside} of {count} signals within their limits"

    def __getitem__(self, signal: str) -> ValidatedSignal:
        """The row of a signal, whose name may lack the component as in a `Trace`; raises UnknownSignal."""
        rows = {row.signal: row for row in self.rows}
        return rows[found(rows, signal, "the validation")]


def validate(
    run: Result | Data | str | Path,
    reference: Recording | Result | Data | str | Path,
    *,
    rate: bool | Collection[str] = False,
) -> Validation:
    """Compare every signal of the reference with the run.

    run         a result, a trace, a pandas DataFrame or a mapping with a column `time`, or a .csv, .parquet
                or .mat file
    reference   a recording, or its data file with a .toml next to it; the result of `reference`; a trace, a
                DataFrame or a mapping with signals in the units of the run
    rate        rate all listed signals, or these, by ISO/TS 18571, and not only those with such a limit

    Raises a Problem if the run lacks a signal, if units do not match, or without a common window.
    """
    if isinstance(run, str | Path):
        trace, meta = read_run(Path(run))
    else:
        trace = run.trace if isinstance(run, Result) else as_trace(run, "run")
        meta = metadata(run) if isinstance(run, Result) else None
    if isinstance(reference, str | Path):
        reference = read_recording(reference)
    elif not isinstance(reference, Recording):
        if isinstance(reference, Result):  # of `reference`: also states, which a co-simulation has not
            reference = reference.trace.select(n for n in reference.trace.signals if n in trace.signals)
        own = as_trace(reference, "reference")
        reference = Recording(own.time, own.signals, own.units, Path("reference"), title="reference")
    nominals = meta.nominals if meta else {}
    units = {n: reference.units[n] or trace.units.get(n, "") for n in reference.signals}
    reference = replace(reference, units=units)
    floors = {n: replace(reference.criterion(n), floor=AT_REST * abs(nominals[n])) for n in nominals}
    reference = replace(reference, criteria={**reference.criteria, **floors})
    to_rate = rated(reference, rate)
    check_comparable(trace, reference)
    grid, notes = common_grid(trace.time, reference)
    if missing := [name for name in reference.signals if name not in trace.signals]:
        told = f"{len(missing)} signals of the reference are not in the run: {first_names(missing)}"
        notes, reference = (*notes, told), reference.select(n for n in reference.signals if n not in missing)
    return Validation(
        rows=tuple(_row(name, trace, reference, grid, name in to_rate) for name in reference.signals),
        window=(float(grid[0]), float(grid[-1])),
        title=reference.heading,
        source=reference.source.name,
        about=reference.metadata,
        notes=notes,
    )


def rated(reference: Recording, rate: bool | Collection[str]) -> Collection[str]:
    """The signals that `validate` rates by ISO/TS 18571; raises Problem without the package for it."""
    limits = ((name, reference.criterion(name).tolerance) for name in reference.signals)
    limited = {name for name, limit in limits if limit is not None and limit.metric == "iso18571"}
    if isinstance(rate, bool):
        rate = reference.signals.keys() - reference.unlisted if rate else ()
    if names := limited.union(rate):
        require("rating", RATING)
    return names


def check_comparable(run: Trace, reference: Recording) -> None:
    """Raise Problem if the run lacks a signal, if units do not match, or without a common window.

    The values of the run are not read, so the check is possible before they are known.
    """
    for name in reference.signals:
        if name in reference.unlisted - run.signals.keys():
            continue
        if name not in run.signals:
            described = reference.source.suffix == ".toml"
            describe = "" if described else f"; describe the columns: harvester describe {reference.source}"
            hint = suggest(name, run.signals) or describe
            raise UnknownSignal(name, run.signals, f"{reference.source}: ", hint=hint)
        if unit := run.units.get(name, ""):  # a refusal contains the unit that the user wrote
            unit_of_file = reference.file_units.get(name, reference.units[name])
            factor_and_offset(unit_of_file, unit, reference.place(name))
    common_grid(run.time, reference)


def common_grid(run: Array, reference: Recording) -> tuple[Array, tuple[str, ...]]:
    """The common samples [s], those of the coarser side in the common window, and notes on them."""
    sides = {"run": run, "reference": reference.time}
    start = max(run[0], reference.time[0], reference.start)
    stop = min(run[-1], reference.time[-1], reference.stop)
    spans = "; ".join(f"the {name} covers {t[0]:g} to {t[-1]:g} s" for name, t in sides.items())
    samples = {name: t[inside(t, start, stop)] for name, t in sides.items()}
    coarse = min(samples, key=lambda name: len(samples[name]))
    grid = samples[coarse]
    if len(grid) < 2:
        ends = {"begins": reference.start, "ends": reference.stop}
        limits = [f"{verb} at {t:g} s" for verb, t in ends.items() if np.isfinite(t)]
        window = f"; the requested window {' and '.join(limits)}" if limits else ""
        expected = "expected two or more samples in a common window"
        raise Problem(f"{reference.source}: {expected}, got {len(grid)}; {spans}{window}")
    notes = [f"compared at the {len(grid)} samples of the {coarse}, {grid[0]:g} to {grid[-1]:g} s"]
    fine = "reference" if coarse == "run" else "run"
    if between := _between(grid, sides[fine]):
        notes.append(f"{between} of them are between samples of the {fine}: interpolated linearly")
    if any(not inside(t, grid[0], grid[-1]).all() for t in sides.values()):
        notes.append(f"only a part was compared: {spans}")
    return grid, tuple(notes)


def _between(grid: Array, time: Array) -> int:
    """Number of points of a grid between samples, with a tolerance for rounding."""
    tolerance = rounding(grid, np.ptp(time) / (len(time) - 1))
    at_or_after = np.minimum(np.searchsorted(time, grid - tolerance), len(time) - 1)
    return int(np.sum(np.abs(time[at_or_after] - grid) > tolerance))


def _row(name: str, trace: Trace, reference: Recording, grid: Array, to_rate: bool) -> ValidatedSignal:
    """Resample, measure and judge one signal."""
    where, values, notes = f"{reference.source}: {name}", trace[name], []
    listed = name not in reference.unlisted
    for k in np.flatnonzero(~np.isfinite(values))[:1]:
        raise Problem(f"run: {name}: expected finite numbers, got {values[k]} at {trace.time[k]:g} s")
    unit, criterion = trace.units.get(name, ""), reference.criterion(name)
    unit_of_file = reference.file_units.get(name, reference.units[name])
    if not unit and unit_of_file:
        unit = unit_of_file
        notes.append(f"the run has no unit, {unit!r} of the reference is assumed")
    factor, offset = factor_and_offset(reference.units[name], unit, where)
    recorded = factor * reference[name] + offset
    valid = np.isfinite(recorded)
    # 0 at a valid sample, 1 at a gap
    outside_gaps = np.interp(grid, reference.time, ~valid) < LARGEST_ROUNDING
    if not outside_gaps.all():
        count = int(np.sum(~outside_gaps))
        notes.append(f"{count} of {len(grid)} samples are in gaps of the reference, left out")
    time = grid[outside_gaps]
    if len(time) < 2:
        raise Problem(f"{where}: expected two or more samples in the common window, got {len(time)}")
    simulated = np.interp(time, trace.time, values)
    resampled = np.interp(time, reference.time[valid], recorded[valid])
    metrics = measure(
        time,
        simulated,
        resampled,
        span=None if criterion.span is None else criterion.span * factor,
        floor=criterion.floor,
        recording=recorded[valid & inside(reference.time, reference.start, reference.stop)],
        rated=to_rate,
        where=where,
    )
    tolerance = None if criterion.tolerance is None else criterion.tolerance.scaled(factor)
    return ValidatedSignal(
        signal=name,
        label=criterion.label,
        group=criterion.group,
        unit=unit,
        time=time,
        simulation=simulated,
        reference=resampled,
        metrics=metrics,
        tolerance=tolerance,
        passed=None if tolerance is None else tolerance.holds(metrics.value(tolerance.metric)),
        notes=(*notes, *metrics.notes),
        listed=listed,
    )
