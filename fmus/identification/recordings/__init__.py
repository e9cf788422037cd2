"""What a recording for identification is read and prepared with, in one place.

reading      take, window, split, add, blank
clock        period, uniform_rate, evenly, thinned, resample
derivatives  derivatives, SavitzkyGolay, filter_for, delay, shift
masks        good, good_all, dead, clipped, steady, averages, standard_error
data         stretches, bridged (orchestrator.data.recording)
"""

from fmus.identification.recordings.clock import evenly, period, resample, thinned, uniform_rate
from fmus.identification.recordings.derivatives import (
    Delay,
    Derivatives,
    SavitzkyGolay,
    delay,
    derivatives,
    filter_for,
    shift,
)
from fmus.identification.recordings.masks import (
    Averages,
    averages,
    clipped,
    dead,
    good,
    good_all,
    standard_error,
    steady,
)
from fmus.identification.recordings.reading import add, blank, split, take, window
from orchestrator.data.recording import fill_gaps, true_intervals

__all__ = [
    "Averages",
    "Delay",
    "Derivatives",
    "SavitzkyGolay",
    "add",
    "averages",
    "blank",
    "clipped",
    "dead",
    "delay",
    "derivatives",
    "evenly",
    "fill_gaps",
    "filter_for",
    "good",
    "good_all",
    "period",
    "resample",
    "shift",
    "split",
    "standard_error",
    "steady",
    "take",
    "thinned",
    "true_intervals",
    "uniform_rate",
    "window",
]  # fmt: skip
