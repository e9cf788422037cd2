"""What is stored of a run of a study: its outputs, and signals over time."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from orchestrator.data.table import Array
from orchestrator.data.trace import inside
from orchestrator.engine.result import BondEnergy, bonds_above
from orchestrator.lanes.group import FAILED, OK, Ended
from orchestrator.studies.cases import StudyCase, signal
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


def judged(outcome: RunOutcome, bonds: Sequence[BondEnergy], end: Ended | None) -> RunOutcome:
    """An outcome with its energy error, and with why the run ended early or is not reliable."""
    error = max((abs(b.relative) for b in bonds_above(bonds, 0.0)), default=0.0)
    outcome = replace(outcome, energy_error=error)
    return replace(outcome, status=end.status, reason=end.reason) if end else outcome


def complete(
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
