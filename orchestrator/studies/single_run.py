"""One run of a study: a sample is simulated, and its outputs and stored signals are computed."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from orchestrator.base.errors import Problem
from orchestrator.data.table import Array
from orchestrator.data.trace import inside
from orchestrator.engine.job import Job
from orchestrator.engine.result import BondEnergy, bonds_above
from orchestrator.engine.run import run
from orchestrator.engine.time_grid import Grid
from orchestrator.lanes.batch import machine_values, recorded_times
from orchestrator.lanes.compiled import LANES
from orchestrator.lanes.group import EARLY, FAILED, NOT_RELIABLE, OK, Group, Lanes
from orchestrator.lanes.one_by_one import early_end
from orchestrator.studies.cases import Sample, StudyCase, Unit, signal
from orchestrator.studies.study import Output, Study

NAN = float("nan")


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
    wall     wall time [s]; not part of the results
    """

    run: int
    status: str
    reason: str
    outputs: Array
    bands: Array | None = None
    start: float = 0.0
    wall: float = 0.0
    energy_error: float = NAN


def failed(study: Study, run: int, reason: str) -> RunOutcome:
    """The outcome of a run that failed."""
    return RunOutcome(run, FAILED, " ".join(reason.split()), np.full(len(study.outputs), NAN))


def outcomes(study: Study, case: StudyCase, unit: Unit) -> list[RunOutcome]:
    """Run samples with equal options, several in lanes. One that fails there is run again by itself."""
    found: dict[int, RunOutcome] = {}
    if len(unit) > 1:
        with suppress(Problem):  # a value is not allowed: its own run tells the reason
            found = _in_lanes(study, case, unit)
    return [found.get(sample.run) or outcome(study, case, sample) for sample in unit]


def _in_lanes(study: Study, case: StudyCase, unit: Unit) -> dict[int, RunOutcome]:
    """The outcomes of the samples that come to their end."""
    group, times = _lane_group(study, case)
    names = unit[0].factors
    values, _ = machine_values(group.lanes.job, {n: [float(s.factors[n]) for s in unit] for n in names})
    rows = [np.full((len(unit), times.rows), NAN) for _ in group.lanes.signals]
    ended = group.run(0, values, rows, len(unit))
    time = recorded_times(times)
    signals = dict(zip(map(str, group.lanes.signals), rows, strict=True))
    found = {}
    for i, sample in enumerate(unit):
        if i in ended and ended[i].status != NOT_RELIABLE:
            continue
        values_of = {name: values[i] for name, values in signals.items()}
        outcome = _outcome(study, case, sample.run, time, values_of)
        found[sample.run] = _judged(outcome, group.energies(i), ended[i].reason if i in ended else "")
    return found


def group_size(study: Study, case: StudyCase) -> int:
    """How many samples of a case are run together: those of a group in lanes, or one."""
    try:
        _lane_group(study, case)
    except Problem:
        return 1
    return LANES


def _lane_group(study: Study, case: StudyCase) -> tuple[Group, Grid]:
    """A group of machines of a case, and their communication points; raises Problem if that is impossible."""
    if id(case) not in _groups:
        job = Job.of(case.system, case.scenario, _options(study, case))
        lanes = Lanes(job, [job.system.port(name) for name in job.signals or ()])
        _groups[id(case)] = case, Group(lanes), job.times
    return _groups[id(case)][1:]


_groups: dict[int, tuple[StudyCase, Group, Grid]] = {}  # by the id of the case


def _options(study: Study, case: StudyCase) -> dict[str, Any]:
    """Arguments of `run` that all samples of a case have in common."""
    return {
        "step": study.step,
        "tolerance": case.tolerance,
        "stop": study.stop,
        "record": list(dict.fromkeys(str(signal(case.system, o.signal)) for o in study.outputs)),
        "record_step": study.record_step,
        "isolate": False,  # the process of the study is one already
    }


def outcome(study: Study, case: StudyCase, sample: Sample) -> RunOutcome:
    """Run a sample; an error becomes its outcome."""
    try:
        result = run(case.system, case.scenario, set=sample.factors, **_options(study, case))
        found = _outcome(study, case, sample.run, result.trace.time, result.trace.signals)
        found = _judged(found, result.card.bonds, "; ".join(result.card.unreliable))
        reason = early_end(result.card.notes)
        return replace(found, status=EARLY, reason=reason) if reason else found
    except Exception as error:  # a defect ends this run only
        kind = "" if isinstance(error, Problem) else f"{type(error).__name__}: "
        return failed(study, sample.run, f"{kind}{error}")


def _judged(outcome: RunOutcome, bonds: Sequence[BondEnergy], unreliable: str) -> RunOutcome:
    """An outcome with its energy error, and why it is not reliable; empty if it is."""
    error = max((abs(b.relative) for b in bonds_above(bonds, 0.0)), default=0.0)
    status = NOT_RELIABLE if unreliable else outcome.status
    return replace(outcome, status=status, reason=unreliable or outcome.reason, energy_error=error)


def _outcome(
    study: Study, case: StudyCase, run: int, time: Array, signals: Mapping[str, Array]
) -> RunOutcome:
    """The outcome of a complete run; signals: by `component.variable`."""

    def values(name: str) -> Array:
        outlet = case.system.outputs.get(name)
        values = signals[str(signal(case.system, name))]
        return values if outlet is None else outlet.map.factor * values + outlet.map.offset

    start = float(time[0])
    outputs = np.array([measure(o, time, values(o.signal)) for o in study.outputs], np.float64)
    # up to the end of the run, interpolated linearly between recorded points
    times = band_times(study, start, int((time[-1] - time[0]) / study.band_step + 1e-6) + 1)
    bands = [np.interp(times, time, values(name)) for name in study.bands]
    return RunOutcome(run, OK, "", outputs, np.stack(bands) if bands else None, start)


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
