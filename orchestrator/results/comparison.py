"""Traces against one of them: every common signal, on the samples that `validate` would take.

Traces come with their units and with what is known of the runs that made them.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from pathlib import Path

import numpy as np

from orchestrator.base.errors import Problem, suggest
from orchestrator.base.text import first_names
from orchestrator.base.units import factor_and_offset, parse
from orchestrator.data.recording import Criterion, Recording, read_recording
from orchestrator.data.table import Array
from orchestrator.data.trace import Trace, read
from orchestrator.engine.result import FLOOR, Result, RunMetadata, metadata, read_metadata
from orchestrator.results.metrics import constant
from orchestrator.results.validation import ValidatedSignal, Validation, validate

Source = str | Path | Trace | Result


@dataclass(frozen=True)
class Run:
    """A trace under a short name; `facts` are None where nobody noted them."""

    label: str
    trace: Trace
    facts: RunMetadata | None = None
    file: str = ""

    @property
    def inputs(self) -> frozenset[str]:
        """The signals that are inputs of components."""
        return frozenset(self.facts.inputs if self.facts else ())


def gather(sources: Sequence[str | Path] | Mapping[str, Source], more: str | Path | None = None) -> list[Run]:
    """The runs behind files, or behind traces, results and files with names; `more`: a further file."""
    if isinstance(sources, Mapping):
        named: Mapping[str, Source] = sources
    else:
        files = [Path(s) for s in sources]
        named = _named(files)
        if more is not None and str(more) not in named:
            named = _named([*files, Path(more)])
    if len(named) < 2:
        raise Problem(f"compare: expected two or more traces, got {', '.join(map(str, named)) or 'none'}")
    return _with_units([_run(label, source) for label, source in named.items()])


def _named(files: Sequence[Path]) -> dict[str, Source]:
    """Files by their stems, or by their paths where stems are the same."""
    stems = [f.stem for f in dict.fromkeys(files)]
    return {f.stem if stems.count(f.stem) == 1 else str(f): f for f in files}


def _run(label: str, source: Source) -> Run:
    if isinstance(source, Result):
        return Run(label, source.trace, metadata(source))
    if isinstance(source, Trace):
        return Run(label, source)
    path = Path(source)
    if path.suffix.lower() == ".csv" and path.with_suffix(".toml").is_file():
        return Run(label, read_recording(path).trace(), None, str(path))
    trace = read(path)
    found = read_metadata(path)
    units = {name: unit for name, unit in (found.units if found else {}).items() if name in trace.signals}
    return Run(label, replace(trace, units={**trace.units, **units}), found, str(path))


def _with_units(runs: list[Run]) -> list[Run]:
    """A signal without a unit has that of the first run that states one."""
    known: dict[str, str] = {}
    for run in reversed(runs):
        known |= {name: unit for name, unit in run.trace.units.items() if unit}
    complete = []
    for run in runs:
        units = {n: u for n in run.trace.signals if (u := run.trace.units.get(n) or known.get(n, ""))}
        complete.append(replace(run, trace=replace(run.trace, units=units)))
    return complete


# What signals of a unit are called together; the first three are looked at unless the user names signals.
QUANTITIES = {"speed": "rad/s", "angle": "rad", "pressure": "Pa", "velocity": "m/s", "position": "m"}
QUANTITIES |= {"acceleration": "m/s2", "angular acceleration": "rad/s2"}
QUANTITIES |= {"force": "N", "torque": "N.m", "flow": "m3/s", "power": "W", "voltage": "V"}
DEFAULT_QUANTITIES = ("speed", "pressure", "angle")
# A signal that moves less than this share of the widest of its quantity is at rest: a difference over its
# range says nothing about the machine.
AT_REST = 1e-3
CONSTANT = "reference constant"


@dataclass(frozen=True)
class Comparison:
    """The outcome.

    reference   the run that the others are compared with
    against     label -> comparison of that run with the reference, signal by signal
    signals     the signals to show
    notes       what to know about it
    """

    runs: tuple[Run, ...]
    reference: Run
    against: Mapping[str, Validation]
    signals: tuple[str, ...]
    notes: tuple[str, ...] = ()

    @property
    def window(self) -> tuple[float, float]:
        """What is compared, from first to last [s]."""
        windows = [validation.window for validation in self.against.values()]
        return min(a for a, _ in windows), max(b for _, b in windows)

    def quantities(self) -> dict[str, list[str]]:
        """All common signals by quantity."""
        found: dict[str, list[str]] = {}
        for row in next(iter(self.against.values())).rows:
            found.setdefault(row.group, []).append(row.signal)
        return found

    def worst(self, label: str, quantity: str) -> ValidatedSignal | None:
        """The signal of a quantity with the largest NRMSE among those that move in either run.

        Where the reference does not move, NRMSE is over the range of the other run; then CONSTANT is a note.
        """
        rows = [row for row in self.against[label].rows if row.group == quantity]
        ranges = [_range(values) for row in rows for values in (row.reference, row.simulation)]
        least = max(AT_REST * max(ranges, default=0.0), FLOOR)
        moving = [found for row in rows if (found := _moving(row, least))]
        return max(moving, key=lambda r: r.metrics.nrmse or 0.0, default=None)

    def largest(self, label: str, quantity: str) -> ValidatedSignal:
        """The signal of a quantity with the largest difference, whether it moves or not."""
        rows = [row for row in self.against[label].rows if row.group == quantity]
        return max(
            rows, key=lambda r: r.metrics.maximum_error * factor_and_offset(r.unit, rows[0].unit, r.signal)[0]
        )


def compare(
    sources: Sequence[str | Path] | Mapping[str, Source],
    against: str | Path | None = None,
    signals: Iterable[str] = (),
    start: float | None = None,
    stop: float | None = None,
) -> Comparison:
    """Compare runs with one of them.

    sources   files of traces, or {name: file, Trace or Result}
    against   the file or name of the one to compare with; default: the first
    signals   what to show, with * and ?; default: speeds, pressures and angles that all have as outputs
    start, stop   the window to compare [s]; default: all that both have
    """
    runs = gather(sources, against)
    asked = str(against) if isinstance(sources, Mapping) else str(Path(against or ""))
    reference = runs[0] if against is None else next((r for r in runs if asked in (r.label, r.file)), None)
    if reference is None:
        raise Problem(f"compare: against {against}: expected one of {', '.join(r.label for r in runs)}")
    common = _common(runs, reference)
    truth = _as_recording(reference, common, start, stop)
    found = {run.label: _against(truth, run) for run in runs if run is not reference}
    return Comparison(tuple(runs), reference, found, _chosen(runs, common, signals), _notes(runs, common))


def _range(values: Array) -> float:
    return 0.0 if constant(values) else float(np.ptp(values))


def _moving(row: ValidatedSignal, least: float) -> ValidatedSignal | None:
    """The row if one of its runs moves, its NRMSE over the range of that run."""
    if _range(row.reference) > least:
        return row
    span = _range(row.simulation)
    metrics = replace(row.metrics, nrmse=row.metrics.rmse / span) if span > least else None
    return replace(row, metrics=metrics, notes=(*row.notes, CONSTANT)) if metrics else None


def _against(truth: Recording, run: Run) -> Validation:
    try:
        return validate(run.trace, truth, rate=False)
    except Problem as problem:
        raise Problem(f"compare {run.label} with {problem}") from None


def quantity(unit: str) -> str:
    """The quantity that is measured in a unit; the unit itself where there is no word for it."""
    known: dict[tuple[int, ...], str] = {parse(u).exponents: name for name, u in QUANTITIES.items()}
    try:
        found = known.get(parse(unit).exponents, "")
    except Problem:
        found = ""
    if found == "torque" and unit.endswith("J"):
        return "energy"
    if found == "power" and not unit.endswith("W"):
        found = ""  # N.m/s is the rate of a torque
    return found or (f"[{unit}]" if unit else "without unit")


def _as_recording(run: Run, names: Sequence[str], start: float | None, stop: float | None) -> Recording:
    """Signals of a run as what others are compared with, grouped by quantity."""
    units = {name: run.trace.units.get(name, "") for name in names}
    return Recording(
        source=Path(run.file or run.label),
        title=run.label,
        time=run.trace.time,
        signals=run.trace.select(names).signals,
        units=units,
        criteria={name: Criterion(group=quantity(unit)) for name, unit in units.items()},
        start=-np.inf if start is None else start,
        stop=np.inf if stop is None else stop,
    )


def _common(runs: Sequence[Run], reference: Run) -> list[str]:
    """The signals of the reference that all have."""
    common = [n for n in reference.trace.signals if all(n in run.trace.signals for run in runs)]
    if not common:
        each = "; ".join(f"{r.file or r.label} has {first_names(r.trace.signals, 3) or 'none'}" for r in runs)
        raise Problem(f"compare: expected signals that all have, got none: {each}")
    return common


def _chosen(runs: Sequence[Run], common: Sequence[str], patterns: Iterable[str]) -> tuple[str, ...]:
    """The signals to show."""
    wanted = tuple(patterns)
    for pattern in wanted:
        if not any(fnmatchcase(name, pattern) for name in common):
            near = suggest(pattern, common) or f"; there are {first_names(common, 3)}"
            raise Problem(f"compare: signals {pattern}: no signal that all have fits{near}")
    if wanted:
        return tuple(name for name in common if any(fnmatchcase(name, p) for p in wanted))
    units, inputs = runs[0].trace.units, frozenset[str]().union(*(run.inputs for run in runs))
    outputs = [name for name in common if name not in inputs]
    usual = [n for q in DEFAULT_QUANTITIES for n in outputs if quantity(units.get(n, "")) == q]
    return tuple(usual or outputs or common)


def _notes(runs: Sequence[Run], common: Sequence[str]) -> tuple[str, ...]:
    everything = dict.fromkeys(name for run in runs for name in run.trace.signals)
    lost = [name for name in everything if name not in set(common)]
    notes = [f"not in all traces, so left out: {first_names(lost, 3)}"] if lost else []
    early = [run.label for run in runs if run.facts and not run.facts.complete]
    notes += [f"ended early: {', '.join(early)}"] if early else []
    if not any(run.trace.units for run in runs):
        notes.append(
            "no units are known: they stand in the .run.json or .toml beside a trace, or in a .parquet"
        )
    return tuple(notes)
