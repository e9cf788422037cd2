"""Comparison of runs: every signal that all runs have, against one of the runs, sampled as by `validate`."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from orchestrator.base.errors import Problem, suggest
from orchestrator.base.extras import require
from orchestrator.base.options import Time, seconds
from orchestrator.base.signals import selected, span
from orchestrator.base.text import brief, first_names
from orchestrator.base.units import factor_and_offset, quantity
from orchestrator.data.recording import Criterion, Recording, read_recording
from orchestrator.data.table import Array
from orchestrator.data.trace import Trace, inside
from orchestrator.engine.result import FLOOR, Result, RunMetadata, metadata, read_run
from orchestrator.fmi.description import Value
from orchestrator.results.metrics import AT_REST, HARDLY_MOVES
from orchestrator.results.rating import RATING
from orchestrator.results.validation import ValidatedSignal, Validation, validate

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Source = str | Path | Trace | Result


@dataclass(frozen=True)
class Run:
    """A trace with a short label, and the metadata of its run if they are available."""

    label: str
    trace: Trace
    metadata: RunMetadata | None = None
    file: str = ""

    __repr__ = brief


EXPECTED = 'compare: expected a list of files, or results with names such as {"a": one, "b": other}'


def gather(sources: Sequence[str | Path] | Mapping[str, Source], more: str | Path | None = None) -> list[Run]:
    """Read the runs of files, or of a mapping with traces, results and files; `more`: a further file."""
    if isinstance(sources, str | Path | Trace | Result):
        raise Problem(f"{EXPECTED}, got one {type(sources).__name__}")
    if isinstance(sources, Mapping):
        labelled: Mapping[str, Source] = sources
    else:
        for source in sources:
            if not isinstance(source, str | Path):
                raise Problem(f"{EXPECTED}, got a list with a {type(source).__name__}")
        files = [Path(s) for s in sources]
        labelled = _labelled(files)
        if more is not None and str(more) not in labelled:
            labelled = _labelled([*files, Path(more)])
    if len(labelled) < 2:
        raise Problem(f"compare: expected two or more traces, got {', '.join(map(str, labelled)) or 'none'}")
    return _runs(labelled)


def read_runs(files: Sequence[Path]) -> list[Run]:
    """The runs of one or more files, with units and short labels."""
    return _runs(_labelled(files))


def _labelled(files: Sequence[Path]) -> dict[str, Source]:
    """Files by their stems, or by their paths if stems are equal."""
    stems = [f.stem for f in dict.fromkeys(files)]
    return {f.stem if stems.count(f.stem) == 1 else str(f): f for f in files}


def _run(label: str, source: Source) -> Run:
    if isinstance(source, Result):
        return Run(label, source.trace, metadata(source))
    if isinstance(source, Trace):
        return Run(label, source)
    if not isinstance(source, str | Path):
        raise Problem(f"compare: {label}: expected a file, a Trace or a Result, got {type(source).__name__}")
    path = Path(source)
    if path.suffix.lower() != ".parquet" and path.with_suffix(".toml").is_file():
        return Run(label, read_recording(path).without_gaps(), None, str(path))
    trace, run_metadata = read_run(path)
    return Run(label, trace, run_metadata, str(path))


def _runs(labelled: Mapping[str, Source]) -> list[Run]:
    """The runs; a signal without unit gets the unit of the first run that declares one."""
    runs, declared = [_run(label, source) for label, source in labelled.items()], dict[str, str]()
    for run in reversed(runs):
        declared |= {name: unit for name, unit in run.trace.units.items() if unit}
    complete = []
    for run in runs:
        units = {n: u for n in run.trace.signals if (u := run.trace.units.get(n) or declared.get(n, ""))}
        complete.append(replace(run, trace=replace(run.trace, units=units)))
    return complete


DEFAULT_QUANTITIES = ("speed", "pressure", "angle")  # shown if the user names no signals
OTHER_START, OTHER_TIME = 0.01, 0.01  # [rad] or [m] between two poses at the start; of the duration
# below AT_REST times the widest range of its quantity, a signal is at rest, too, and has no NRMSE
CONSTANT = "constant reference"
# of the widest range of its quantity: what moves less in one of the runs comes last, whatever its NRMSE is
LITTLE = 0.05
ROUNDING = 1e-9  # part of the largest value of a quantity: signals that differ by less are equal


@dataclass(frozen=True)
class Comparison:
    """Runs compared with one of them.

    reference   the run with which the others are compared
    experiments how the experiments of the runs differ: other commands, another start, another duration
    against     label -> comparison of that run with the reference, signal by signal
    signals     the signals to show
    notes       remarks on the comparison
    requested   whether the signals to show were given
    """

    runs: tuple[Run, ...]
    reference: Run
    against: Mapping[str, Validation]
    signals: tuple[str, ...]
    notes: tuple[str, ...] = ()
    experiments: tuple[str, ...] = ()
    requested: bool = False

    @property
    def unreliable(self) -> tuple[str, ...]:
        """Why runs are not reliable, with their labels."""
        told = ((run, run.metadata.unreliable) for run in self.runs if run.metadata)
        return tuple(f"{run.label}: {reason}" for run, reasons in told for reason in reasons)

    def plot(self, *patterns: str) -> Figure:
        """The signals that differ most, or those of patterns, in all runs, and below each its differences."""
        from orchestrator.pages.plotting import draw
        from orchestrator.results.comparison_report import traces

        names = self.reference.trace.matching(patterns) if patterns else None
        return draw(traces(self, names))

    def text(self) -> str:
        """What `harvester compare` prints."""
        from orchestrator.results.comparison_report import report

        return report(self).text()

    def _repr_html_(self) -> str:
        from orchestrator.results.comparison_report import worst_tables

        return "".join(f"<div>{table.html()}</div>" for table in worst_tables(self))

    def __repr__(self) -> str:
        from orchestrator.results.comparison_report import verdict

        (start, stop), told = self.window, [*self.unreliable, verdict(self)]
        return "\n".join([f"Comparison with {self.reference.label}, {start:g} to {stop:g} s", *told])

    @property
    def window(self) -> tuple[float, float]:
        """Start and end of the compared time [s]."""
        windows = [validation.window for validation in self.against.values()]
        return min(a for a, _ in windows), max(b for _, b in windows)

    def quantities(self) -> dict[str, list[str]]:
        """All common signals by quantity."""
        groups = next(iter(self.against.values())).groups
        return {group: [row.signal for row in rows] for group, rows in groups.items()}

    def worst(self, label: str, quantity: str) -> ValidatedSignal | None:
        """The signal of a quantity with the largest NRMSE; None if all are at rest in both runs.

        What moves in both runs and differs comes first. If the reference is at rest, NRMSE is over the range
        of both runs, and CONSTANT is a note.
        Raises Problem for an unknown run or quantity.
        """
        rows = self._rows(label, quantity)
        least = max(AT_REST * self._scales[label, quantity][1], FLOOR)
        moving = [moved for row in rows if (moved := _moving(row, least))]
        return max(moving, key=lambda row: self.rank(label, row), default=None)

    def rank(self, label: str, row: ValidatedSignal) -> tuple[bool, float]:
        """Whether a signal moves in both runs and differs, then its NRMSE."""
        size = self._factor(label, row) * min(span(row.reference), span(row.simulation))
        moves = size > LITTLE * self._scales[label, row.group][1]
        return moves and not self.equal(label, row), row.metrics.nrmse or 0.0

    def _factor(self, label: str, row: ValidatedSignal) -> float:
        """To the unit of the first signal of its quantity."""
        return factor_and_offset(row.unit, self._rows(label, row.group)[0].unit, row.signal)[0]

    def _rows(self, label: str, quantity: str) -> list[ValidatedSignal]:
        """The signals of a quantity in the comparison with a run."""
        if label not in self.against:
            others = first_names(self.against, 8)
            if label == self.reference.label:
                raise Problem(f"run {label!r} is the reference; it is compared with {others}")
            raise Problem(f"no run {label!r}{suggest(label, self.against) or f'; there are {others}'}")
        groups = self.against[label].groups
        if quantity not in groups:
            hint = suggest(quantity, groups) or f"; there are {', '.join(groups)}"
            raise Problem(f"no quantity {quantity!r}{hint}")
        return groups[quantity]

    def equal(self, label: str, row: ValidatedSignal) -> bool:
        """Is the difference of a signal rounding, next to the largest value of its quantity?"""
        return bool(row.metrics.maximum_error <= max(ROUNDING * self._scales[label, row.group][0], FLOOR))

    @cached_property
    def _scales(self) -> dict[tuple[str, str], tuple[float, float]]:
        """The largest value and the widest range by run and quantity."""
        return {
            (label, group): (
                max(max(np.abs(r.reference).max(), r.metrics.normalised_by) for r in rows),
                max(self._factor(label, r) * max(span(r.reference), span(r.simulation)) for r in rows),
            )
            for label, validation in self.against.items()
            for group, rows in validation.groups.items()
        }

    def largest(self, label: str, quantity: str) -> ValidatedSignal:
        """The signal of a quantity with the largest difference, including signals at rest."""
        rows = self._rows(label, quantity)
        return max(rows, key=lambda r: r.metrics.maximum_error * self._factor(label, r))


def compare(
    sources: Sequence[str | Path] | Mapping[str, Source],
    against: str | Path | None = None,
    signals: str | Iterable[str] = (),
    start: Time = None,
    stop: Time = None,
    rate: bool = False,
) -> Comparison:
    """Compare runs with one of them.

    sources      files of traces, or {name: file, Trace or Result}
    against      file or name of the run with which the others are compared; default: the first
    signals      patterns of the signals to show; default: speeds, pressures and angles that are outputs
    start, stop  time window [s]; default: the common time of both runs
    rate         whether to rate the signals to show by ISO/TS 18571
    """
    signals = (signals,) if isinstance(signals, str) else tuple(signals)
    if rate:
        require("rating", RATING)
    runs = gather(sources, against)
    requested = str(against) if isinstance(sources, Mapping) else str(Path(against or ""))
    named = (run for run in runs if requested in (run.label, run.file))
    reference = runs[0] if against is None else next(named, None)
    if reference is None:
        raise Problem(f"compare: against {against}: expected one of {', '.join(r.label for r in runs)}")
    common = _common(runs, reference)
    recording = _as_recording(reference, common, seconds(start, "start"), seconds(stop, "stop"))
    chosen = _chosen(runs, common, signals)
    to_rate = chosen if rate else ()
    validations = {run.label: _validate(recording, run, to_rate) for run in runs if run is not reference}
    return Comparison(
        tuple(runs),
        reference,
        validations,
        chosen,
        _notes(runs, common),
        tuple(text for run in runs if run is not reference and (text := _other_experiment(reference, run))),
        bool(signals),
    )


def _other_experiment(reference: Run, run: Run) -> str:
    """How the experiment of a run differs from that of the reference; empty if it does not."""
    a, b, differences = reference.trace, run.trace, list[str]()
    sources = {*(reference.metadata.sources if reference.metadata else ())}
    common = [n for n in (run.metadata.sources if run.metadata else ()) if n in sources and n in a.signals]
    time = a.time[inside(a.time, b.time[0], b.time[-1])]
    at = {n: (np.interp(time, a.time, a[n]), np.interp(time, b.time, b[n])) for n in common if n in b.signals}
    differ = [name for name, values in at.items() if _differ(*values)]
    # the rate of a command tells nothing more, and is 0 where its connection was cut
    if differ := [n for n in differ if n.removesuffix("_rate") == n or n.removesuffix("_rate") not in at]:
        differences.append(f"other commands ({first_names(differ, 3)})")
    poses = [n for n in a.signals if n in b.signals and quantity(a.units.get(n, "")) in ("angle", "position")]
    if moved := [n for n in poses if n not in sources and abs(a[n][0] - b[n][0]) > OTHER_START]:
        differences.append(f"another start ({first_names(moved, 3)})")
    if abs(a.time[0] - b.time[0]) > OTHER_TIME * np.ptp(a.time):
        differences.append(f"its beginning at {b.time[0]:g} s, not {a.time[0]:g} s")
    if abs(a.time[-1] - b.time[-1]) > OTHER_TIME * np.ptp(a.time):
        differences.append(f"its end at {b.time[-1]:g} s, not {a.time[-1]:g} s")
    other = f"another experiment than {reference.label}: {run.label} has"
    return f"{other} {', '.join(differences)}" if differences else ""


def _differ(a: Array, b: Array) -> bool:
    return bool(len(a) and np.max(np.abs(a - b)) > AT_REST * max(np.max(np.abs(a)), np.max(np.abs(b))))


Cell = tuple[Value, str]  # value and its origin; "" for the shipped value


def different_values(runs: Sequence[Run]) -> dict[tuple[str, str], list[Cell | None]]:
    """(name, unit) of each start value in which runs differ -> value and origin in each run.

    None for a run whose FMU may not have the variable, or without metadata.
    """
    listed = [{v.name: v for v in run.metadata.provenance.values} if run.metadata else {} for run in runs]
    first = {name: value for values in reversed(listed) for name, value in values.items()}
    result: dict[tuple[str, str], list[Cell | None]] = {}
    for name, other in first.items():
        cells: list[Cell | None] = []
        for run, values in zip(runs, listed, strict=True):
            if name in values:
                cells.append((values[name].value, values[name].origin))
            elif other.shipped is not None and run.metadata and _has(run.metadata, runs, listed, name):
                cells.append((other.shipped, ""))
            else:
                cells.append(None)
        if len({cell and cell[0] for cell in cells}) > 1:
            result[name, other.unit] = cells
    return result


def _has(meta: RunMetadata, runs: Sequence[Run], listed: Sequence[Mapping[str, object]], name: str) -> bool:
    """Has a run the FMU of a run that lists the variable?"""
    owner = next((c for c in sorted(meta.fmus, key=len, reverse=True) if name.startswith(f"{c}.")), None)
    others = [r.metadata for r, values in zip(runs, listed, strict=True) if r.metadata and name in values]
    return owner is not None and any(meta.fmus[owner] == other.fmus.get(owner) for other in others)


def different_fmus(runs: Sequence[Run]) -> list[str]:
    """Components whose FMU files have different checksums."""
    known = [run.metadata.provenance.fmus for run in runs if run.metadata and run.metadata.provenance.fmus]
    names = dict.fromkeys(name for fmus in known for name in fmus)
    return [n for n in names if len({fmus[n]["sha256"] for fmus in known if n in fmus}) > 1]


def _moving(row: ValidatedSignal, least: float) -> ValidatedSignal | None:
    """The row with NRMSE over the range of a run in which it moves; None if it is at rest in both."""
    if any(note.startswith(HARDLY_MOVES) for note in row.metrics.notes):
        least = max(least, row.metrics.normalised_by)
    if span(row.reference) > least:
        return row
    if span(row.simulation) <= least:
        return None
    both = np.concatenate([row.reference, row.simulation])
    metrics = replace(row.metrics, nrmse=row.metrics.rmse / span(both))
    return replace(row, metrics=metrics, notes=(*row.notes, CONSTANT))


def _validate(recording: Recording, run: Run, to_rate: Collection[str]) -> Validation:
    try:
        return validate(run.trace, recording, rate=to_rate)
    except Problem as problem:
        raise Problem(f"compare {run.label} with {problem}") from None


def _as_recording(run: Run, names: Sequence[str], start: float | None, stop: float | None) -> Recording:
    """Signals of the reference run as a recording, grouped by quantity."""
    units = {name: run.trace.units.get(name, "") for name in names}
    nominals = run.metadata.nominals if run.metadata else {}
    return Recording(
        source=Path(run.file or run.label),
        title=run.label,
        time=run.trace.time,
        signals=run.trace.select(names).signals,
        units=units,
        criteria={
            name: Criterion(group=quantity(unit), floor=AT_REST * abs(nominals.get(name, 0.0)))
            for name, unit in units.items()
        },
        start=-np.inf if start is None else start,
        stop=np.inf if stop is None else stop,
    )


def _common(runs: Sequence[Run], reference: Run) -> list[str]:
    """The signals of the reference that all runs have."""
    common = [n for n in reference.trace.signals if all(n in run.trace.signals for run in runs)]
    if not common:
        each = "; ".join(f"{r.file or r.label} has {first_names(r.trace.signals, 3) or 'none'}" for r in runs)
        raise Problem(f"compare: expected signals that all runs have, got none: {each}")
    return common


def _chosen(runs: Sequence[Run], common: Sequence[str], patterns: Iterable[str]) -> tuple[str, ...]:
    """The signals to show."""

    def missing(pattern: str) -> str:
        near = suggest(pattern, common) or f"; there are {first_names(common, 3)}"
        return f"compare: signals {pattern}: no common signal matches{near}"

    if chosen := selected(common, patterns, missing):
        return tuple(chosen)
    units, inputs = runs[0].trace.units, {n for run in runs if run.metadata for n in run.metadata.inputs}
    outputs = [name for name in common if name not in inputs]
    default = [n for q in DEFAULT_QUANTITIES for n in outputs if quantity(units.get(n, "")) == q]
    return tuple(default or outputs or common)


def _notes(runs: Sequence[Run], common: Sequence[str]) -> tuple[str, ...]:
    names = dict.fromkeys(name for run in runs for name in run.trace.signals)
    missing = [name for name in names if name not in set(common)]
    notes = [f"not in all traces, so left out: {first_names(missing, 3)}"] if missing else []
    early = [run.label for run in runs if run.metadata and not run.metadata.complete]
    notes += [f"ended early: {', '.join(early)}"] if early else []
    if not any(run.trace.units for run in runs):
        notes.append("no units: a .run.json or .toml next to a trace, or a .parquet, contains them")
    return tuple(notes)
