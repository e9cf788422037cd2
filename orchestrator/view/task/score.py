"""How well a task was done: from the start of its clock to its end, or to the last sample.

    cycle time        s   first movement to the last target done
    reach time        s   first movement until the first target is entered
    path length       m   of the tip, sum of the distances between samples; "crane tip distance" of Polowy and
                          Rutkowski, Forests 15:1277, 2024
    simultaneous      1   share of time with two or more of swing, boom and stick moving (faster than MOVING)
    functions         1   mean number of them that move while any does; Polowy and Rutkowski 2024 give 1.8 at
                          the end of a training on a simulator, by their definition and of more functions
    energy            J   integral of supply pressure times supply flow: what the drives take
    peak pressure     Pa  of the lines of the three drives
    smoothness        1   spectral arc length of the speed of the tip, see `smoothness`

Where no source is named the definition is ours. Integrals are by the trapezoidal rule.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from orchestrator.files.trace import Trace
from orchestrator.view.task.exercise import EXERCISES, Exercise, Progress, follow, phase
from orchestrator.view.task.samples import Samples, of_trace
from orchestrator.view.task.smoothness import spectral_arc_length

MOVING = 0.02  # rad/s; ours: a tenth of an ordinary speed, far above what a closed valve lets through
DEFAULT = EXERCISES["stem on the left"]


@dataclass(frozen=True)
class Score:
    """Figures of one attempt; None where the run does not hold what is needed."""

    finished: bool
    cycle_time: float
    reach_time: float | None
    path_length: float
    simultaneous: float
    functions: float
    energy: float | None
    peak_pressure: float | None
    smoothness: float | None


def score(trace: Trace, exercise: Exercise = DEFAULT) -> Score | None:
    """The score of any run with a tip in it; None if the tip never moved."""
    samples = of_trace(trace)
    return judge(samples, exercise, follow(exercise, Progress(), samples))


def judge(samples: Samples, exercise: Exercise, progress: Progress) -> Score | None:
    """The score of samples whose progress is known; None if the clock has not started."""
    if progress.started is None:
        return None
    finished = phase(exercise, progress) == "done"
    end = progress.done[-1] if finished else progress.now
    part = samples[slice(*np.searchsorted(samples.time, (progress.started, np.nextafter(end, np.inf))))]
    moving = np.sum(np.abs(part.functions) > MOVING, axis=1)
    return Score(
        finished=finished,
        cycle_time=end - progress.started,
        reach_time=progress.reached[0] - progress.started if progress.reached else None,
        path_length=float(np.sum(np.linalg.norm(np.diff(part.tip, axis=0), axis=1))),
        simultaneous=_mean(moving >= 2, part.time),
        functions=_mean(moving, part.time) / (_mean(moving >= 1, part.time) or 1.0),
        energy=float(np.trapezoid(part.power, part.time)) if len(part.power) else None,
        peak_pressure=float(part.pressure.max()) if len(part.pressure) else None,
        smoothness=spectral_arc_length(part.time, part.speed),
    )


def _mean(values: np.typing.NDArray[np.generic], time: np.typing.NDArray[np.float64]) -> float:
    """Mean over time; 0 where there is no time."""
    if len(time) < 2:
        return 0.0
    return float(np.trapezoid(values.astype(float), time) / (time[-1] - time[0]))
