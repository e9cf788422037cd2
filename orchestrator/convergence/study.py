"""Every setting at every step: error, cost, and whether the run came to its end."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import log
from statistics import median
from typing import Any

from orchestrator.convergence.settings import FINEST, Setting, possible, rates
from orchestrator.convergence.truth import Error, Truth, from_run
from orchestrator.errors import Problem
from orchestrator.runs.simulation import Result, RunFailed, run
from orchestrator.system.system import System

LOST = 1.0  # of its range: a signal that was once further off has left its place for good
ROUNDING = 1e-12  # NRMSE: below, a change says nothing about the order


@dataclass(frozen=True)
class Row:
    """One setting at one step. Times in [s].

    step     communication step, where the setting chooses it the first to try
    case     of a setting that chooses its steps: what it was told
    errors   group -> errors of its signals, the largest first; empty if the run ended early or was refused
    taken    communication steps
    walls    of each repetition of the run
    ended    why the run ended early; empty if it did not
    refused  why there was no run: the FMUs lack what the master needs
    """

    setting: Setting
    step: float
    case: str = ""
    errors: Mapping[str, tuple[Error, ...]] = field(default_factory=dict)
    taken: int = 0
    simulated: float = 0.0
    walls: tuple[float, ...] = ()
    ended: str = ""
    refused: str = ""

    @property
    def mean_step(self) -> float:
        """[s] of the steps that were taken."""
        return self.simulated / self.taken if self.taken else self.step

    @property
    def wall(self) -> float:
        """Median over the repetitions [s]."""
        return median(self.walls) if self.walls else float("nan")

    @property
    def cost(self) -> float:
        """Wall time over simulated time."""
        return self.wall / self.simulated if self.simulated else float("nan")

    @property
    def stable(self) -> bool:
        """It came to the end, and no signal was ever off by more than its range."""
        found = [e for errors in self.errors.values() for e in errors]
        return bool(found) and all(e.maximum < LOST * e.span for e in found)

    def error(self, group: str) -> float:
        """NRMSE of the worst signal of a group."""
        return self.errors[group][0].nrmse

    def maximum(self, group: str) -> Error:
        """The signal of a group with the largest difference."""
        return max(self.errors[group], key=lambda e: e.maximum)


@dataclass(frozen=True)
class Study:
    """The outcome, rows by setting with increasing steps."""

    truth: Truth
    rows: tuple[Row, ...]
    notes: tuple[str, ...] = ()

    @property
    def steps(self) -> list[float]:
        """All steps that were given [s], the smallest first."""
        return sorted({row.step for row in self.rows if not row.case})

    @property
    def settings(self) -> list[Setting]:
        """All settings, in their order."""
        found = {row.setting.label: row.setting for row in self.rows}
        return list(found.values())

    def of(self, setting: Setting) -> list[Row]:
        """The rows of a setting, the smallest step first."""
        found = (row for row in self.rows if row.setting.label == setting.label)
        return sorted(found, key=lambda row: row.mean_step if row.case else row.step)

    def order(self, row: Row, group: str) -> float | None:
        """Order of convergence between the next smaller step given and this one, where both are stable."""
        finer = [r for r in self.of(row.setting) if r.step < row.step]
        if not finer or not finer[-1].stable or not row.stable:
            return None
        small, large = finer[-1].error(group), row.error(group)
        if min(small, large) < ROUNDING:
            return None
        return log(large / small) / log(row.mean_step / finer[-1].mean_step)


def study(
    system: System,
    truth: Truth,
    settings: Sequence[Setting],
    steps: Sequence[float],
    repeats: int = 3,
    bare: Sequence[str] | None = None,
    **options: Any,
) -> Iterator[Row]:
    """Run every setting at every step.

    repeats   how often a stable run is done; its wall time is the median
    bare      the connections that bare settings go without; default: those of rate ports
    options   of `run`, such as scenario, start, stop
    """
    truth.check(system)
    held = rates(system) if bare is None else tuple(bare)
    lengths, (start, stop) = sorted(steps), _span(system, options)
    apart = {h: truth.interval(start, stop, h) for h in lengths}
    ports = [str(system.outputs[n].source) if n in system.outputs else n for n in truth.names]
    told = {"record": list(dict.fromkeys(ports))} | options
    any_run = False
    for setting in possible(settings, held):
        whole = system.without(*held) if setting.bare else system
        cases = [Row(setting, step) for step in lengths]
        if setting.own:
            cases = [Row(setting, lengths[0], case) for case in setting.own]
        for row in cases:
            coupling = setting.own.get(row.case, setting.coupling)
            interval = truth.coarse(start) if row.case else apart[row.step]
            given = {"master": coupling, "step": row.step, "record_step": interval} | told
            try:
                row = _done(row, truth, whole, repeats, given)
            except Problem as problem:
                if not any_run:  # then nothing runs at all: a mistake, no lack of the FMUs
                    raise
                row = replace(row, refused=str(problem))
            any_run = True
            yield row


def _span(system: System, options: Mapping[str, Any]) -> tuple[float, float | None]:
    """Start and, where it is given, stop time [s]."""
    start = next((t for t in (options.get("start"), system.start) if t is not None), 0.0)
    return float(start), options.get("stop")


def _done(row: Row, truth: Truth, system: System, repeats: int, given: Mapping[str, Any]) -> Row:
    """One run, then again for its wall time if it was stable."""
    try:
        result, ended = run(system, **given), ""
    except RunFailed as failed:
        result, ended = failed.result, str(failed)
    card = result.card
    errors = {} if ended else truth.errors(result.trace, row.step)
    row = replace(row, errors=errors, taken=card.steps, simulated=card.simulated, ended=ended)
    more = repeats - 1 if row.stable else 0
    return replace(row, walls=(card.wall, *(run(system, **given).card.wall for _ in range(more))))


def finest(system: System, signals: Sequence[str], steps: Sequence[float], **options: Any) -> Truth:
    """The truth where nobody knows it: `hermite` at half the smallest step, all points recorded."""
    step = min(steps) / 2
    result: Result = run(system, master=FINEST, step=step, record=list(signals), **options)
    return from_run(f"hermite at {1e3 * step:g} ms", result.trace)
