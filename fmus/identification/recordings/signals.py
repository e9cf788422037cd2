"""What can be done with the signals of a recording, in one place.

parts        take, window, split, add, blank, bridged
clock        period, uniform_rate, evenly, thinned, resample
delay        delay, shift
derivatives  derivatives, SavitzkyGolay, filter_for
masks        good, good_all, dead, clipped, stretches, steady, averages, standard_error
"""

from fmus.identification.recordings.cutting import add, blank, split, take, window
from fmus.identification.recordings.delay import Delay, delay, shift
from fmus.identification.recordings.derivatives import Derivatives, SavitzkyGolay, derivatives, filter_for
from fmus.identification.recordings.flat import clipped
from fmus.identification.recordings.gaps import bridged
from fmus.identification.recordings.masks import (
    Averages,
    averages,
    dead,
    good,
    good_all,
    standard_error,
    steady,
)
from fmus.identification.recordings.resampling import period, resample, stretches, uniform_rate
from fmus.identification.recordings.uniform import evenly, thinned

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
