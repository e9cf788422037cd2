"""One number from a signal over a window of time."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
from numpy.typing import NDArray

from orchestrator.sweep.study import Output

Signal = NDArray[np.float64]
NAN = float("nan")


def _mean(t: Signal, x: Signal) -> float:
    span = float(t[-1] - t[0])
    return float(np.trapezoid(x, t)) / span if span > 0 else float(x[0])


MEASURES: Mapping[str, Callable[[Signal, Signal], float]] = {
    "maximum": lambda _, x: float(np.max(x)),
    "minimum": lambda _, x: float(np.min(x)),
    "range": lambda _, x: float(np.ptp(x)),
    "final": lambda _, x: float(x[-1]),
    "mean": _mean,
    "rms": lambda t, x: float(np.sqrt(_mean(t, np.square(x)))),
    "integral": lambda t, x: float(np.trapezoid(x, t)),
    "time_of_maximum": lambda t, x: float(t[np.argmax(x)]),
}


def measure(output: Output, time: Signal, signal: Signal) -> float:
    """The number of an output; shapes (n,), time [s]. NaN where the window holds no point.

    Mean, rms and integral are those of straight lines between the points (rms: between the squares). Of
    several points with the largest value the first counts.
    """
    inside = slice(
        0 if output.start is None else int(np.searchsorted(time, output.start - _least(time), "left")),
        len(time) if output.stop is None else int(np.searchsorted(time, output.stop + _least(time), "right")),
    )
    t, x = time[inside], signal[inside]
    return MEASURES[output.measure](t, x) if len(t) else NAN


def _least(time: Signal) -> float:
    """Rounding of a time that is a sum of steps [s]."""
    return 1e-9 * float(time[-1] - time[0]) if len(time) else 0.0


def unit(measure_: str, unit: str) -> str:
    """The unit of a measure of a signal."""
    if measure_ == "time_of_maximum":
        return "s"
    if measure_ != "integral":
        return unit
    return f"{unit}.s" if unit and unit != "1" else "s"
