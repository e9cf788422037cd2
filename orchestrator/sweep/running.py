"""One run of a study: a sample becomes a row."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from orchestrator.errors import Problem
from orchestrator.runs.result import Result
from orchestrator.runs.simulation import run
from orchestrator.sweep.cases import Case, Options, signal
from orchestrator.sweep.measures import measure
from orchestrator.sweep.study import Study
from orchestrator.system.interface import Value

NAN = float("nan")
OK, EARLY, FAILED = "ok", "early", "failed"


@dataclass(frozen=True)
class Sample:
    """What a run is run with: its number, its options and the numbers of its factors, those it has."""

    run: int
    options: Options
    factors: Mapping[str, Value]


@dataclass(frozen=True)
class Row:
    """What is kept of a run.

    status    ok, early (an FMU asked to end the run), or failed
    reason    in one line, if it is not ok
    outputs   shape (outputs,); NaN of a failed run, and where a window holds nothing
    bands     shape (signals, times), at `band_times`; None of a failed run, or where nothing is kept
    start     time of the first point [s]
    wall      [s]; not part of the results
    """

    run: int
    status: str
    reason: str
    outputs: NDArray[np.float64]
    bands: NDArray[np.float64] | None = None
    start: float = 0.0
    wall: float = 0.0


def failed(study: Study, run: int, reason: str) -> Row:
    """The row of a run that did not come to its end."""
    return Row(run, FAILED, " ".join(reason.split()), np.full(len(study.outputs), NAN))


def row(study: Study, case: Case, sample: Sample) -> Row:
    """Run a sample; whatever goes wrong is its result."""
    try:
        result = _run(study, case, sample)
    except Problem as problem:
        return failed(study, sample.run, str(problem))
    except Exception as defect:  # of this one run; the others go on
        return failed(study, sample.run, f"{type(defect).__name__}: {defect}")
    early = _ended(result)
    return Row(
        run=sample.run,
        status=EARLY if early else OK,
        reason=early,
        outputs=_outputs(study, case, result),
        bands=_bands(study, case, result) if study.bands else None,
        start=float(result.trace.time[0]),
    )


def _run(study: Study, case: Case, sample: Sample) -> Result:
    names = dict.fromkeys(str(signal(case.system, o.signal)) for o in study.outputs)
    return run(
        case.system,
        case.scenario,
        step=study.step,
        stop=study.stop,
        set=sample.factors,
        record=list(names),
        record_step=study.record_step,
        bonds=(),
    )


def _ended(result: Result) -> str:
    """Why a run that stands ended early; empty if it did not."""
    told = [n for n in result.card.notes if n.startswith("the run ends early: ")]
    return " ".join(told[0].removeprefix("the run ends early: ").split()) if told else ""


def _outputs(study: Study, case: Case, result: Result) -> NDArray[np.float64]:
    trace = result.trace
    of = {o.signal: trace[_name(case, o.signal)] for o in study.outputs}
    return np.array([measure(o, trace.time, of[o.signal]) for o in study.outputs], np.float64)


def _bands(study: Study, case: Case, result: Result) -> NDArray[np.float64]:
    """Between the recorded points straight lines; as far as the run came."""
    time = result.trace.time
    count = int((time[-1] - time[0]) / study.band_step + 1e-6) + 1
    times = band_times(study, float(time[0]), count)
    return np.stack([np.interp(times, time, result.trace[_name(case, n)]) for n in study.bands])


def band_times(study: Study, start: float, count: int) -> NDArray[np.float64]:
    """The times [s] at which signals are kept."""
    return np.array([start + study.band_step * k for k in range(count)])


def _name(case: Case, name: str) -> str:
    """A signal as the trace of a run names it: an output of the system by its own name, in its own unit."""
    return name if name in case.system.outputs else str(signal(case.system, name))
