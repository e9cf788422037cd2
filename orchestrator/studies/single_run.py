"""One run of a study: a sample is simulated, and its outputs and stored signals are computed."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from orchestrator.base.errors import Problem
from orchestrator.engine.run import run
from orchestrator.studies.cases import Sample, StudyCase, signal
from orchestrator.studies.study import Output, Study

OK, EARLY, FAILED = "ok", "early", "failed"
NAN = float("nan")

Array = NDArray[np.float64]


@dataclass(frozen=True)
class RunOutcome:
    """The stored results of a run.

    status   ok, early (an FMU requested the end of the run), or failed
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


def failed(study: Study, run: int, reason: str) -> RunOutcome:
    """The outcome of a run that failed."""
    return RunOutcome(run, FAILED, " ".join(reason.split()), np.full(len(study.outputs), NAN))


def outcome(study: Study, case: StudyCase, sample: Sample) -> RunOutcome:
    """Run a sample; an error becomes its outcome."""
    system = case.system
    try:
        result = run(
            system,
            case.scenario,
            step=study.step,
            stop=study.stop,
            set=sample.factors,
            record=list(dict.fromkeys(str(signal(system, o.signal)) for o in study.outputs)),
            record_step=study.record_step,
            bonds=(),
            isolate=False,  # the process of the study is one already
        )
        # In a trace, outputs of the system have the name and unit that the system declares.
        names = {o.signal: o.signal for o in study.outputs if o.signal in system.outputs}
        names |= {o.signal: str(signal(system, o.signal)) for o in study.outputs if o.signal not in names}
        trace, marker = result.trace, "the run ends early: "
        early = [note for note in result.card.notes if note.startswith(marker)]
        outputs = [measure(o, trace.time, trace[names[o.signal]]) for o in study.outputs]
        return RunOutcome(
            run=sample.run,
            status=EARLY if early else OK,
            reason=" ".join(early[0].removeprefix(marker).split()) if early else "",
            outputs=np.array(outputs, np.float64),
            bands=_bands(study, trace.time, [trace[names[name]] for name in study.bands]),
            start=float(trace.time[0]),
        )
    except Problem as problem:
        return failed(study, sample.run, str(problem))
    except Exception as defect:  # a defect ends this run only
        return failed(study, sample.run, f"{type(defect).__name__}: {defect}")


def _bands(study: Study, time: Array, signals: list[Array]) -> Array | None:
    """Signals at `band_times` up to the end of the run, interpolated linearly between recorded points."""
    if not signals:
        return None
    count = int((time[-1] - time[0]) / study.band_step + 1e-6) + 1
    times = band_times(study, float(time[0]), count)
    return np.stack([np.interp(times, time, values) for values in signals])


def band_times(study: Study, start: float, count: int) -> Array:
    """Times [s] of the stored signals."""
    return np.asarray(start + study.band_step * np.arange(count), np.float64)


def measure(output: Output, time: Array, signal: Array) -> float:
    """The value of an output; shapes (n,), time [s]. NaN if the window contains no point.

    Mean, rms and integral use linear interpolation between the points (rms: between the squares). The time
    of the maximum is the first of several.
    """
    rounding = 1e-9 * float(time[-1] - time[0]) if len(time) else 0.0  # in a time that is a sum of steps
    begin = 0 if output.start is None else int(np.searchsorted(time, output.start - rounding, "left"))
    end = len(time) if output.stop is None else int(np.searchsorted(time, output.stop + rounding, "right"))
    t, x = time[begin:end], signal[begin:end]
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
