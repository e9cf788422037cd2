"""Inertance and capacitance by their definitions, as in section 4(c): sample by sample, then a mean.

    I = (P_in - P_out - drop)/(dQ_in/dt)        C = (Q_in - Q_out)/(dP_out/dt)

Derivatives by the Savitzky-Golay filter that smooths the other signals too. Only samples with a clear
derivative count, as a ratio with nothing below it says nothing. The result is that of the paper: the mean of
each group, then the mean of these; its scatter is that of the groups. Noise of the derivative draws it to
zero, and what the machine's model leaves out (a share s of the hose, `equations`) goes into it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from fmus.identification.finding import Estimate
from fmus.identification.procedures.hose_dynamics.equations import SIGNALS
from fmus.identification.recordings.recording import Recording
from fmus.identification.recordings.signals import filter_for, good_all, period

Array = NDArray[np.float64]

WINDOW = 0.055  # s, of the filter: a third of the shortest change
SAMPLES = 4  # from the first to the last at least: more than the degree of the filter's polynomial
CLEAR = 0.3  # of the largest derivative of the recording


@dataclass(frozen=True)
class ByDefinition:
    """Samples of I and C of one group."""

    inertance: Array
    capacitance: Array


def by_definition(recording: Recording, resistance: float) -> ByDefinition:
    """Samples of both; the drop is C_R Q|Q| with the hose's C_R [Pa.s2/m6]."""
    window = max(WINDOW, SAMPLES * period(recording.time))
    used, good = filter_for(recording, window), good_all(recording, SIGNALS)
    value, rate = (
        {name: used.apply(np.where(good, recording[name], np.nan), order) for name in SIGNALS}
        for order in (0, 1)
    )
    flow = value["flow_in"]
    driving = value["pressure_in"] - value["pressure_out"] - resistance * flow * np.abs(flow)
    return ByDefinition(
        inertance=_ratio(driving, rate["flow_in"]),
        capacitance=_ratio(flow - value["flow_out"], rate["pressure_out"]),
    )


def _ratio(top: Array, rate: Array) -> Array:
    size = np.abs(rate)
    clear = size > CLEAR * np.max(size, initial=0.0, where=np.isfinite(size))
    found: Array = top[clear] / rate[clear]
    return found


def mean_of_means(name: str, unit: str, groups: list[Array]) -> Estimate:
    """The mean of the groups' means; its interval by Student's t from their scatter."""
    means = np.array([group.mean() for group in groups if group.size])
    value, n = float(means.mean()) if means.size else float("nan"), means.size
    sd = float(means.std(ddof=1) / np.sqrt(n)) if n > 1 else float("inf")
    half = float(stats.t.ppf(0.975, n - 1)) * sd if n > 1 else float("inf")
    note = f"by definition, mean of {n} group means, section 4(c); the interval is their scatter"
    return Estimate(name, value, unit, sd, value - half, value + half, note)
