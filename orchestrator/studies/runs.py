"""The runs of a study, in processes and in lanes as those of `batch`, and what is stored of them.

A crash of an FMU ends only its own run.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from hashlib import sha256
from operator import attrgetter
from typing import Any

import numpy as np
import pandas as pd

from orchestrator.base.errors import Problem
from orchestrator.base.files import Location
from orchestrator.base.processes import machine_memory
from orchestrator.base.text import grouped
from orchestrator.data.table import Array
from orchestrator.data.trace import Trace, inside
from orchestrator.engine.job import Job
from orchestrator.engine.result import BondEnergy, bonds_above
from orchestrator.lanes.batch import machine_values, recorded_times
from orchestrator.lanes.compiled import LANES
from orchestrator.lanes.group import Ended, Lanes, Status
from orchestrator.lanes.many import Runs, archives_of
from orchestrator.ssp.system import System
from orchestrator.studies import design
from orchestrator.studies.cases import Options, Sample, Unit, doubts, resolve, signal
from orchestrator.studies.design import Samples
from orchestrator.studies.study import Output, Study

NAN = float("nan")
STOPPED = re.compile(r"(time_limit|memory_limit) = ([\d.e+-]+): ")  # begins the reason of a stopped run
WRITTEN = 1e-8  # relative rounding of a limit in a reason, of 9 digits
MEMORY_SHARE = 0.25  # of the machine's memory, for one run without a limit of its own
STORE_TIME = 1.5  # [s] between two times at which outcomes are stored: short to lose by a kill


def digest(data: bytes) -> str:
    """SHA-256 digest."""
    return sha256(data).hexdigest()


# ---- what is run


@dataclass(frozen=True)
class PreparedStudy:
    """A study, ready to run.

    cases      the runs without the values of a sample, by options
    archives   the FMUs of all runs
    table      the samples, one row per run
    samples    the same, in the order of the runs, each made when it is asked for
    warnings   doubtful values in the study
    """

    study: Study
    cases: Mapping[Options, Job]
    archives: Mapping[Location, bytes]
    table: pd.DataFrame
    samples: Samples
    warnings: tuple[str, ...] = ()


def prepare(study: Study) -> PreparedStudy:
    """Load the systems of a study and draw its samples; raises a Problem if the study is impossible."""
    resolved, cases = resolve(study)
    table, archives = design.table(resolved), archives_of(case.system for case in cases.values())
    samples = design.runs(resolved, table, cases)
    return PreparedStudy(resolved, cases, archives, table, samples, doubts(resolved, cases.values()))


def limits_of(study: Study) -> Mapping[str, float]:
    """The limits of a run of a study on this machine, by the keys of its file, [s] and [GB]."""
    memory = MEMORY_SHARE * machine_memory() / 1e9 if study.memory_limit is None else study.memory_limit
    return {"time_limit": study.time_limit, "memory_limit": memory}


def limit_is_raised(reason: str, study: Study) -> bool:
    """Did a limit stop the run that failed for this reason, and is that limit larger now?"""
    stopped = STOPPED.match(reason)
    return stopped is not None and limits_of(study)[stopped[1]] > float(stopped[2]) * (1 + WRITTEN)


# ---- the runs


class StudyRuns:
    """The runs of a study on this computer: each in a process of its own, or several in lanes."""

    def __init__(self, prepared: PreparedStudy, in_lanes: Iterable[Options] = ()) -> None:
        """in_lanes: options whose runs are in lanes here, because they are so where the study was started."""
        self._prepared = prepared
        self._study, (time, memory) = prepared.study, limits_of(prepared.study).values()
        self._runs = Runs([job.system for job in prepared.cases.values()], prepared.archives)
        pairs = zip(prepared.cases.items(), self._runs.systems, strict=True)
        self._jobs = {
            options: replace(
                job, system=system, options=replace(job.options, time_limit=time, memory_limit=memory)
            )
            for (options, job), system in pairs
        }
        self.stop, self.close = self._runs.stop, self._runs.close
        try:
            self._lanes = {options: self._lanes_of(options, generated=True) for options in in_lanes}
        except BaseException:
            self.close()
            raise

    def __reduce__(self) -> tuple[Any, ...]:
        """Opened anew, without the samples."""
        given = self._prepared
        prepared = replace(given, table=given.table[:0], samples=given.samples.at(()))
        return StudyRuns, (prepared, tuple(self._lanes))

    @property
    def compiled(self) -> bool:
        """Are some in lanes?"""
        return bool(self._lanes)

    def units(self, samples: Samples, lanes: bool = True) -> list[Samples]:
        """The samples that are run together: where possible groups in lanes, of samples with equal options.

        The groups do not depend on which samples have results already, nor on the workers of a cluster, so
        neither do the results. lanes: False if such a worker has no compiler.
        """
        units = list[Samples]()
        for options, some in grouped(range(len(samples)), samples.options.__getitem__).items():
            together = 1
            if lanes and len(some) >= LANES:  # fewer are not worth a compilation
                with suppress(Problem):
                    self._lanes[options] = self._lanes_of(options)
                    together = LANES
            units += [samples.at(some[i : i + together]) for i in range(0, len(some), together)]
        return sorted(units, key=attrgetter("rows"))

    def _lanes_of(self, options: Options, generated: bool = False) -> Lanes:
        job = self._jobs[options]
        return Lanes(job, [job.system.port(n) for n in job.signals or ()], generated)

    def lost(self, unit: Unit, reason: str) -> list[RunOutcome]:
        """Outcomes of samples that cannot be run."""
        return [failed(self._study, sample.run, reason) for sample in unit]

    def run(self, unit: Unit) -> list[RunOutcome]:
        """Run samples with equal options, several in lanes. One that fails there is run again by itself."""
        unit, found = tuple(unit), dict[int, RunOutcome]()
        if len(unit) > 1:
            with suppress(Problem):  # a value is not allowed: its own run tells the reason
                found = self._in_lanes(unit)
        return [found.get(sample.run) or self._alone(sample) for sample in unit]

    def _alone(self, sample: Sample) -> RunOutcome:
        """Run a sample; an error becomes its outcome."""
        study, job = self._study, self._jobs[sample.options]
        try:
            result, end = self._runs.alone(replace(job, system=job.system.with_start(sample.factors)))
            if result is None or (end and end.status in (Status.FAILED, Status.INTERRUPTED)):
                reason = end.reason if end else ""
                limit = f"{end.limit} = {limits_of(study)[end.limit]:.9g}: " if end and end.limit else ""
                return failed(study, sample.run, f"{limit}{reason}")
            return complete(study, job.system, sample.run, result.trace, result.card.bonds, end)
        except OSError:  # of this computer
            raise
        except Exception as error:  # a defect ends this run only
            kind = "" if isinstance(error, Problem) else f"{type(error).__name__}: "
            return failed(study, sample.run, f"{kind}{error}")

    def _in_lanes(self, unit: Unit) -> dict[int, RunOutcome]:
        """The outcomes of the samples that come to their end within the time limit of a run."""
        study, options = self._study, unit[0].options
        job, lanes = self._jobs[options], self._lanes[options]
        values, count = machine_values(job, {n: [float(s.factors[n]) for s in unit] for n in unit[0].factors})
        rows = [np.full((count, job.times.rows), np.nan) for _ in lanes.signals]
        found: dict[int, RunOutcome] = {}
        ends = self._runs.together(lanes, values, rows, 0, count, job)
        for i, (sample, (bonds, end)) in enumerate(zip(unit, ends, strict=True)):
            if not end or end.status == Status.NOT_RELIABLE:
                signals = {str(port): values[i] for port, values in zip(lanes.signals, rows, strict=True)}
                trace = Trace(recorded_times(job.times), signals)
                found[sample.run] = complete(study, job.system, sample.run, trace, bonds, end)
        return found


# ---- what is stored of a run


@dataclass(frozen=True)
class RunOutcome:
    """The stored results of a run.

    status   ok, unreliable (the error of the coupling is too large), early (an FMU requested the end of the
             run), or failed
    energy_error   largest energy error of the coupling over the energy that its bond exchanged; NaN if the
                   run failed
    reason   why the status is not ok, in one line
    outputs  shape (outputs,); NaN if the run failed or the window contains no point
    bands    signals at `band_times`, shape (signals, times); None if the run failed or no signal is stored
    start    time of the first point [s]
    """

    run: int
    status: str
    reason: str
    outputs: Array
    bands: Array | None = None
    start: float = 0.0
    energy_error: float = NAN


def failed(study: Study, run: int, reason: str) -> RunOutcome:
    """The outcome of a run that failed."""
    return RunOutcome(run, Status.FAILED, " ".join(reason.split()), np.full(len(study.outputs), NAN))


def complete(
    study: Study, system: System, run: int, trace: Trace, bonds: Sequence[BondEnergy], end: Ended | None
) -> RunOutcome:
    """The outcome of a run that came to its end; end: of one that an FMU ended, or that is not reliable."""

    def values(name: str) -> Array:
        outlet = system.outputs.get(name)
        values = trace.signals[str(signal(system, name))]
        return values if outlet is None else outlet.map.factor * values + outlet.map.offset

    time, start = trace.time, float(trace.time[0])
    outputs = np.array([measure(o, time, values(o.signal)) for o in study.outputs], np.float64)
    # up to the end of the run, interpolated linearly between recorded points
    times = band_times(study, start, int((time[-1] - time[0]) / study.band_step + 1e-6) + 1)
    bands = [np.interp(times, time, values(name)) for name in study.bands]
    status, reason = (end.status, end.reason) if end else (Status.OK, "")
    error = max((abs(b.relative) for b in bonds_above(bonds, 0.0)), default=0.0)
    stored = np.stack(bands) if bands else None
    return RunOutcome(run, status, reason, outputs, stored, start, energy_error=error)


def band_times(study: Study, start: float, count: int) -> Array:
    """Times [s] of the stored signals."""
    return np.asarray(start + study.band_step * np.arange(count), np.float64)


def measure(output: Output, time: Array, signal: Array) -> float:
    """The value of an output; shapes (n,), time [s]. NaN if the window contains no point.

    Mean, rms and integral use linear interpolation between the points (rms: between the squares). The time
    of the maximum is the first of several.
    """
    start, stop = -np.inf if output.start is None else output.start, output.stop
    window = inside(time, start, np.inf if stop is None else stop)
    t, x = time[window], signal[window]
    return MEASURES[output.measure](t, x) if len(t) else NAN


def _mean(t: Array, x: Array) -> float:
    span = float(t[-1] - t[0])
    return float(np.trapezoid(x, t)) / span if span > 0 else float(x[0])


MEASURES: Mapping[str, Callable[[Array, Array], float]] = {
    "maximum": lambda _, x: float(np.max(x)),
    "minimum": lambda _, x: float(np.min(x)),
    "range": lambda _, x: float(np.ptp(x)),
    "final": lambda _, x: float(x[-1]),
    "mean": _mean,
    "rms": lambda t, x: float(np.sqrt(_mean(t, np.square(x)))),
    "integral": lambda t, x: float(np.trapezoid(x, t)),
    "time_of_maximum": lambda t, x: float(t[np.argmax(x)]),
}
