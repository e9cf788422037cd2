"""What can be done with the signals of a recording, in one place.

parts        take, window, split, add, blank, bridged
clock        period, uniform_rate, evenly, thinned, resample
delay        delay, shift
derivatives  derivatives, SavitzkyGolay, filter_for
masks        good, good_all, dead, clipped, stretches, steady, averages, standard_error

Recordings: what was measured, with which instruments, and how far it can be trusted.
"""

from fmus.identification.recordings.clock import (
    bridged,
    evenly,
    period,
    resample,
    stretches,
    thinned,
    uniform_rate,
)
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
from fmus.identification.recordings.recording import add, blank, split, take, window

__all__ = [
    "Averages",
    "Delay",
    "Derivatives",
    "SavitzkyGolay",
    "add",
    "averages",
    "blank",
    "bridged",
    "clipped",
    "dead",
    "delay",
    "derivatives",
    "evenly",
    "filter_for",
    "good",
    "good_all",
    "period",
    "resample",
    "shift",
    "split",
    "standard_error",
    "steady",
    "stretches",
    "take",
    "thinned",
    "uniform_rate",
    "window",
]
