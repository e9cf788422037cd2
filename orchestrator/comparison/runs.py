"""What is compared: traces with their units, and what is known of the runs that made them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from orchestrator.errors import Problem
from orchestrator.files.trace import Trace, read
from orchestrator.runs.sidecar import Facts, facts, read_facts
from orchestrator.runs.simulation import Result
from orchestrator.validation.reference import read_reference

Source = str | Path | Trace | Result


@dataclass(frozen=True)
class Run:
    """A trace under a short name; `facts` are None where nobody noted them."""

    label: str
    trace: Trace
    facts: Facts | None = None
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
        named = _named(files if more is None or str(more) in _named(files) else [*files, Path(more)])
    if len(named) < 2:
        raise Problem(f"compare: expected two or more traces, got {', '.join(map(str, named)) or 'none'}")
    return _with_units([_run(label, source) for label, source in named.items()])


def _named(files: Sequence[Path]) -> dict[str, Source]:
    """Files by their stems, or by their paths where stems are the same."""
    files = list(dict.fromkeys(files))
    stems = [f.stem for f in files]
    return {f.stem if stems.count(f.stem) == 1 else str(f): f for f in files}


def _run(label: str, source: Source) -> Run:
    if isinstance(source, Result):
        return Run(label, source.trace, facts(source))
    if isinstance(source, Trace):
        return Run(label, source)
    path = Path(source)
    if path.suffix.lower() == ".csv" and path.with_suffix(".toml").is_file():
        known = read_reference(path)
        signals = {name: s.values for name, s in known.signals.items()}
        trace = Trace(known.time, signals, {name: s.unit for name, s in known.signals.items()})
        return Run(label, trace, None, str(path))
    trace = read(path)
    found = read_facts(path)
    units = {name: unit for name, unit in (found.units if found else {}).items() if name in trace.signals}
    return Run(label, replace(trace, units={**trace.units, **units}), found, str(path))


def _with_units(runs: list[Run]) -> list[Run]:
    """A signal without a unit has that of the first run that states one."""
    known: dict[str, str] = {}
    for run in runs:
        known = {**run.trace.units, **known}
    return [replace(run, trace=replace(run.trace, units=_complete(run.trace, known))) for run in runs]


def _complete(trace: Trace, known: Mapping[str, str]) -> dict[str, str]:
    return {name: unit for name in trace.signals if (unit := trace.units.get(name) or known.get(name))}
