"""One run of a study: a sample becomes the numbers and signals that are kept of it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from orchestrator.base.errors import Problem
from orchestrator.engine.run import run
from orchestrator.studies.cases import StudyCase, signal
from orchestrator.studies.design import Sample
from orchestrator.studies.study import Output, Study

OK, EARLY, FAILED = "ok", "early", "failed"
NAN = float("nan")

Array = NDArray[np.float64]


@dataclass(frozen=True)
class RunOutcome:
    """What is kept of a run.

    status   ok, early (an FMU asked to end the run), or failed
    reason   in one line, if the status is not ok
    outputs  shape (outputs,); NaN of a failed run, and where a window holds no point
    bands    shape (signals, times), at `band_times`; None of a failed run, or where nothing is kept
    start    time of the first point [s]
    wall     [s]; not part of the results
    """

    run: int
    status: str
    reason: str
    outputs: Array
    bands: Array | None = None
    start: float = 0.0
    wall: float = 0.0


def failed(study: Study, run: int, reason: str) -> RunOutcome:
    """The outcome of a run that did not come to its end."""
    return RunOutcome(run, FAILED, " ".join(reason.split()), np.full(len(study.outputs), NAN))


def outcome(study: Study, case: StudyCase, sample: Sample) -> RunOutcome:
    """Run a sample; an error is its outcome."""
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
        )
        # outputs of the system have their own name and unit in a trace
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
    except Exception as defect:  # of this one run; the others go on
        return failed(study, sample.run, f"{type(defect).__name__}: {defect}")


def _bands(study: Study, time: Array, signals: list[Array]) -> Array | None:
    """Signals at the times that are kept, as far as the run came; straight lines between recorded points."""
    if not signals:
        return None
    count = int((time[-1] - time[0]) / study.band_step + 1e-6) + 1
    times = band_times(study, float(time[0]), count)
    return np.stack([np.interp(times, time, values) for values in signals])


def band_times(study: Study, start: float, count: int) -> Array:
    """The times [s] at which signals are kept."""
    return np.asarray(start + study.band_step * np.arange(count), np.float64)


def measure(output: Output, time: Array, signal: Array) -> float:
    """The number of an output; shapes (n,), time [s]. NaN where the window holds no point.

    Mean, rms and integral are those of straight lines between the points (rms: between the squares). Of
    several points with the largest value the first counts.
    """
    rounding = 1e-9 * float(time[-1] - time[0]) if len(time) else 0.0  # of a time that is a sum of steps
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
