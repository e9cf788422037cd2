"""What a procedure starts from: its recordings, numbers known before, means over steady steps of a test."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.stats import median_abs_deviation

from fmus.identification.recordings.clock import evenly
from fmus.identification.recordings.derivatives import filter_for
from fmus.identification.recordings.masks import averages, dead, good, noise
from fmus.identification.recordings.reading import require
from fmus.parameters import Number
from orchestrator.base.errors import Problem
from orchestrator.data.recording import Recording, true_intervals

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Table = TypeVar("Table")

BAR, LITRES = ("bar", 1e5), ("L/min", 1e-3 / 60)  # units of figures: name, SI value of one
SAME_HOSE = 1e-3  # relative difference of two tape measures of one hose
WINDOW = 0.25  # s over which a slope is estimated
STANDS = 4.0  # standard deviations of the slope below which a signal stands
MARGIN, SHORTEST_STAND = 0.25, 0.25  # s left out of a stretch at both ends, and what must remain
NEEDED = 2 * MARGIN + SHORTEST_STAND
SETTLE = 0.5  # s, left out at the beginning of each step
SHORTEST = 0.3  # s that must remain of it
FINEST = 1e-6  # of a mean: no instrument is better, whatever a noise-free signal says
NAMES = ("pressure_in", "pressure_out", "flow")


def training(
    recordings: Sequence[Recording], procedure: str, signals: Mapping[str, str]
) -> tuple[Recording, ...]:
    """The recordings of one procedure that are not held out, at least one, with these signals in SI units."""
    own = tuple(r for r in recordings if r.procedure == procedure and r.use == "train")
    if not own:
        there = ", ".join(sorted({r.procedure for r in recordings})) or "no recording"
        raise Problem(f"{procedure}: expected a recording with this procedure to train with, found {there}")
    for recording in own:
        require(recording, signals)
    return tuple(map(evenly, own))


def hose_size(recordings: Sequence[Recording]) -> tuple[float, float]:
    """Length and inside diameter [m] of the hose that was tested; the same in all recordings."""
    first = recordings[0]
    for name in ("length", "diameter"):
        size = first.numeric_condition(name)
        for other in recordings[1:]:
            if abs(other.numeric_condition(name) / size - 1) > SAME_HOSE:
                raise Problem(
                    f"{other.source}: [experiment] {name} is {other.numeric_condition(name):g} m,"
                    f" expected {size:g} m as in {first.source.name}: identify one hose at a time"
                )
    return first.numeric_condition("length"), first.numeric_condition("diameter")


def density_ratio(recordings: Sequence[Recording], known: Mapping[str, Number]) -> float:
    """Density of the machine's oil over that of the test's oil; 1 if the test's is not recorded."""
    if "density" not in recordings[0].conditions:
        return 1.0
    return value(known, "boom_stick.density") / recordings[0].numeric_condition("density")


def number(known: Mapping[str, Number], name: str) -> Number:
    """A number that is known."""
    if name not in known:
        raise Problem(f"{name} is needed to identify, expected among the known parameters, found nothing")
    return known[name]


def value(known: Mapping[str, Number], name: str) -> float:
    """Its value, in SI units."""
    return number(known, name).value


def tank_pressure(recording: Recording) -> float:
    """Gauge pressure of the tank [Pa], 0 if it is not recorded."""
    return recording.numeric_condition("tank_pressure") if "tank_pressure" in recording.conditions else 0.0


def noise_of(recording: Recording, name: str) -> float:
    """Standard deviation of one sample: of the sensor's description, else as the signal shows."""
    sensor = recording.sensor(name)
    sd = sensor.sd or noise(recording[name], sensor)
    return sd if math.isfinite(sd) else 0.0


def filled(row: Array) -> Array:
    """A signal with straight lines over its gaps, zero if there is nothing else."""
    there = np.isfinite(row)
    if not there.any():
        return np.zeros_like(row)
    index = np.arange(row.size)
    return np.interp(index, index[there], row[there])


def where(table: Table, mask: Mask) -> Table:
    """The rows of a dataclass of arrays for which a mask is true."""
    return type(table)(**{name: array[mask] for name, array in vars(table).items()})


def joined(tables: Sequence[Table]) -> Table:
    """The rows of several dataclasses of arrays, one after the other."""
    columns: dict[str, Any] = {n: np.concatenate([vars(t)[n] for t in tables]) for n in vars(tables[0])}
    return type(tables[0])(**columns)


def standing(recording: Recording, names: Sequence[str]) -> list[slice]:
    """Stretches in which none of the signals has a slope that noise or ripple does not explain.

    Ripple of a pump is no white noise: the slope scatters by it, most of the time about zero. Gaps are
    bridged here; means leave them out.
    """
    used = filter_for(recording, WINDOW, 2)
    margin, least = (round(x * used.rate) for x in (MARGIN, SHORTEST_STAND))
    stands = np.ones(recording.time.size, dtype=bool)
    for name in names:
        slope = used.apply(filled(recording[name]), 1)
        ripple = float(median_abs_deviation(slope, scale="normal", nan_policy="omit"))
        stands &= np.abs(slope) < STANDS * max(used.gain(1) * noise_of(recording, name), ripple)  # not if NaN
    inner = [slice(s.start + margin, s.stop - margin) for s in true_intervals(stands)]
    return [s for s in inner if s.stop - s.start >= least]


@dataclass(frozen=True)
class StepMeans:
    """One entry per step; arrays of shape (n,).

    drop, flow   means [Pa], [m3/s] and their standard errors
    dead         the flow meter is in its dead zone, if only at times: a mean of what it shows would be wrong
    clipped      an instrument is at an end of its range, if only at times
    good         measured: not dead, not clipped, half of the samples there
    """

    drop: Array
    drop_error: Array
    flow: Array
    flow_error: Array
    dead: Mask
    clipped: Mask
    good: Mask

    @property
    def measured(self) -> StepMeans:
        """The steps that are measured."""
        return where(self, self.good)


def step_means(recording: Recording, parts: Sequence[slice]) -> StepMeans:
    """Means of pressure_in - pressure_out and of flow over stretches."""
    if not parts:
        raise Problem(
            f"{recording.source}: expected steps that stand for {SETTLE + SHORTEST:g} s or longer, found none"
        )
    means = averages(recording, NAMES, parts)
    asleep, flow = dead(recording, "flow"), recording["flow"]
    # a gap takes nothing but its sample; what is read, but wrong, bends the mean
    wrong = np.logical_or.reduce([np.isfinite(recording[n]) & ~good(recording, n) for n in NAMES]) & ~asleep
    error = {n: np.maximum(means.error[n], FINEST * np.abs(means.mean[n])) for n in NAMES}
    drop = means.mean["pressure_in"] - means.mean["pressure_out"]
    in_dead, clipped = (np.array([bool(mask[part].any()) for part in parts]) for mask in (asleep, wrong))
    shown = [flow[part][np.isfinite(flow[part])] for part in parts]  # also where it is masked
    return StepMeans(
        drop=drop,
        drop_error=np.hypot(error["pressure_in"], error["pressure_out"]),
        flow=np.array([part.mean() if part.size else math.nan for part in shown]),
        flow_error=error["flow"],
        dead=in_dead,
        clipped=clipped & ~in_dead,
        good=~in_dead & ~clipped & np.isfinite(drop + means.mean["flow"]),
    )


def left_out(dead: Mask, clipped: Mask, good: Mask) -> str:
    """How many steps are not measured and why, in words; empty if all are."""
    rest = ~(dead | clipped | good)
    counts = (
        (dead, "in the dead zone of the flow meter"),
        (clipped, "with an instrument at an end of its range"),
        (rest, "without enough samples or without flow"),
    )
    return ", ".join(f"{np.count_nonzero(mask)} {words}" for mask, words in counts if mask.any())
