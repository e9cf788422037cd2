"""Where signals stand still, found by their slopes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.stats import median_abs_deviation

from fmus.identification.procedures.shared.given import filled, noise_of
from fmus.identification.recordings.derivatives import filter_for
from fmus.identification.recordings.recording import Recording
from fmus.identification.recordings.resampling import stretches

WINDOW = 0.25  # s over which a slope is seen
STANDS = 4.0  # standard deviations of the slope below which a signal stands
MARGIN, SHORTEST = 0.25, 0.25  # s left out of a stretch at both ends, and what must remain
NEEDED = 2 * MARGIN + SHORTEST


def standing(recording: Recording, names: Sequence[str]) -> list[slice]:
    """Stretches in which none of the signals has a slope that noise or ripple does not explain.

    Ripple of a pump is no white noise: the slope scatters by it, most of the time about zero. Gaps are
    bridged here; means leave them out.
    """
    used = filter_for(recording, WINDOW, 2)
    margin, least = (round(x * used.rate) for x in (MARGIN, SHORTEST))
    stands = np.ones(recording.time.size, dtype=bool)
    for name in names:
        slope = used.apply(filled(recording[name]), 1)
        ripple = float(median_abs_deviation(slope, scale="normal", nan_policy="omit"))
        stands &= np.abs(slope) < STANDS * max(used.gain(1) * noise_of(recording, name), ripple)  # not if NaN
    inner = [slice(s.start + margin, s.stop - margin) for s in stretches(stands)]
    return [s for s in inner if s.stop - s.start >= least]
