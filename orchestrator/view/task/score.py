"""Smoothness of a movement: the arc length of the spectrum of its speed, negative.

    S = - int_0^w sqrt((1 / w)^2 + (dV / dw)^2) dw,   V(f) = |FFT v(f)| / |FFT v(0)|

up to w: at most 10 Hz, and where V stays below 0.05. One bell-shaped movement has about -1.4 to -1.6; each
further start and stop makes it more negative. It depends neither on the size of the movement nor, closely, on
its duration. Balasubramanian, Melendez-Calderon, Roby-Brami, Burdet, J. NeuroEng. Rehabil. 12:112, 2015.

How well a task was done: from the start of its clock to its end, or to the last sample.

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
from numpy.typing import NDArray

from orchestrator.data.trace import Trace
from orchestrator.view.task.exercise import EXERCISES, Exercise, Progress, Samples, follow, of_trace, phase

HIGHEST = 10.0  # Hz
SMALLEST = 0.05  # of the spectrum at zero frequency
RATE = 50.0  # Hz, of the samples that the spectrum is taken from
PADDING = 4  # powers of two beyond the length, so that the arc has no corners


def spectral_arc_length(time: NDArray[np.float64], speed: NDArray[np.float64]) -> float | None:
    """Spectral arc length [1] of a speed over time; None where nothing moves or there is too little."""
    if len(time) < 2 or time[-1] - time[0] < 5 / RATE:
        return None
    even = np.interp(np.arange(time[0], time[-1], 1 / RATE), time, speed)
    size = 2 ** (int(np.ceil(np.log2(len(even)))) + PADDING)
    spectrum = np.abs(np.fft.rfft(even, size))
    if not spectrum[0] > 0:
        return None
    heights = (spectrum / spectrum[0])[np.fft.rfftfreq(size, 1 / RATE) <= HIGHEST]
    last = int(np.flatnonzero(heights >= SMALLEST)[-1])
    if last == 0:
        return None
    return float(-np.sum(np.hypot(1 / last, np.diff(heights[: last + 1]))))


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
