"""Data of an experiment: its training recordings, known parameters, steady stretches, means over steps."""

import math
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from fmus.identification.balance import SIGNIFICANT, Samples, Solution
from fmus.identification.recordings import masks
from fmus.identification.recordings.clock import filter_for, resample_uniformly
from fmus.identification.recordings.reading import TEMPERATURE, require
from fmus.identification.results import BAR, Estimate, Finding
from fmus.parameters import Number
from orchestrator.base.errors import Problem
from orchestrator.data.recording import Mask, Recording, Sensor, true_intervals
from orchestrator.data.table import Array

Stretches = TypeVar("Stretches", bound="Means")

# largest error of a zero over the range, if no data sheet is given: the usual class of pressure transducers
ZERO_ERROR = 0.0025
ZERO_NOISE = 10.0  # and at least so many standard deviations of the noise, if the range is unknown
SAME_PART = 1e-3  # largest relative difference between two measurements of one size
RATE_WINDOW = 0.25  # s, filter that estimates the rate of change of a signal
STEADY = 4.0  # standard deviations of the rate below which a signal is steady
MARGIN, SHORTEST_CORE = 0.25, 0.25  # s cut off both ends of a steady stretch, and minimum length of the rest
SHORTEST_STRETCH = 2 * MARGIN + SHORTEST_CORE
SETTLING_TIME = 0.5  # s cut off the beginning of each step of the command
SHORTEST_STEP = 0.3  # s, minimum length of the rest of a step
NOISE_ERROR = 3.0  # relative standard error of a noise estimate, times the root of the number of samples
MIN_SAMPLES = 100  # for a test of noise
FINEST = 1e-6  # smallest relative standard error of a mean, also of a signal without noise


def training_recordings(
    recordings: Sequence[Recording], procedure: str, signals: Mapping[str, str]
) -> tuple[Recording, ...]:
    """The recordings of a procedure that are not held out, at least one, with these signals in SI units."""
    selected = tuple(r for r in recordings if r.procedure == procedure and r.use == "train")
    if not selected:
        procedures = ", ".join(sorted({r.procedure for r in recordings})) or "no recording"
        raise Problem(
            f'{procedure}: expected a recording of this procedure with use = "train", got {procedures}'
        )
    for recording in selected:
        require(recording, signals)
    return tuple(map(resample_uniformly, selected))


def condition(recording: Recording, name: str, choices: Collection[str]) -> str:
    """A condition of the experiment that is one of some words."""
    word = recording.conditions.get(name)
    if isinstance(word, str) and word in choices:
        return word
    got = "nothing" if word is None else repr(word)
    raise Problem(f"{recording.source}: [experiment] {name}: expected {', '.join(choices)}, got {got}")


def check_conditions(recordings: Sequence[Recording], **choices: Collection[str]) -> None:
    """Raise Problem if a stated condition has another word than those that are possible."""
    for recording in recordings:
        for name in choices.keys() & recording.conditions.keys():
            condition(recording, name, choices[name])


def one_size(recordings: Sequence[Recording], name: str) -> float:
    """A condition [m] of the tested part, which must be equal in all recordings."""
    first = recordings[0]
    size = first.numeric_condition(name)
    for other in recordings[1:]:
        if abs(other.numeric_condition(name) / size - 1) > SAME_PART:
            raise Problem(
                f"{other.source}: [experiment] {name}: expected {size:g} m as in {first.source.name}, "
                f"got {other.numeric_condition(name):g} m: identify one part at a time"
            )
    return size


def stated(recording: Recording, name: str) -> float | None:
    """An optional condition of the experiment that is a number [SI]."""
    return recording.numeric_condition(name) if name in recording.conditions else None


def parameter(parameters: Mapping[str, Number], name: str) -> Number:
    """A parameter that the procedure takes as known."""
    if name not in parameters:
        raise Problem(f"known parameters: expected {name}, got none: the procedure needs this parameter")
    return parameters[name]


def parameter_value(parameters: Mapping[str, Number], name: str) -> float:
    """The value of a known parameter, in SI units."""
    return parameter(parameters, name).value


def tank_pressure(recording: Recording) -> float:
    """Gauge pressure of the return line [Pa]: mean of its signal, or the stated one, or 0."""
    if found := [x for n, x in recording.signals.items() if n.endswith("tank_pressure")]:
        return float(np.nanmean(found[0]))
    return stated(recording, "tank_pressure") or 0.0


def noise_sd(recording: Recording, name: str) -> float:
    """Standard deviation of the noise of a sample: as described, unless the data show another."""
    sensor = recording.sensor(name)
    seen, most, louder, quieter = _noise_test(recording[name], sensor)
    if math.isfinite(seen) and (not sensor.sd or louder > 1):
        return max(seen, sensor.resolution / math.sqrt(12))
    return math.hypot(most, sensor.resolution / 2) if quieter > 1 else sensor.sd


def _noise_test(values: Array, sensor: Sensor) -> tuple[float, float, float, float]:
    """Noise of one sample, the most that it may be, and `masks.misstated`, 0 if the noise is unknown.

    The most is the largest noise of means of 1, 4 and 16 samples. Correlated noise shows itself in means; so
    does a fast motion, which makes the result too large.
    """
    seen, found = masks.noise(values, sensor), [masks.noise(values, sensor, moving=True)]
    values = values[np.isfinite(values)]
    for size in (4, 16):
        blocks = values[: values.size // size * size].reshape(-1, size).mean(axis=1)
        found.append(masks.noise(blocks) * math.sqrt(size))
    most = max((x for x in found if math.isfinite(x)), default=0.0)
    louder, quieter = masks.misstated(sensor, seen, most)
    return seen, most, louder, quieter if math.isfinite(seen) and most > 0 else 0.0


def signal_findings(recordings: Sequence[Recording], names: Collection[str], label: str) -> Iterator[Finding]:
    """Whether the described noise is wrong by more than a factor, or a signal is held at its extreme."""
    every = [(r, n) for r in recordings for n in names if np.isfinite(r[n]).sum() > MIN_SAMPLES]
    for test in (_noise_finding, _saturation_finding):
        found = [test(r, n, label) for r, n in every]
        if found:  # the least probable one of all signals, by Bonferroni's inequality
            least = min(found, key=lambda finding: finding.p)
            yield replace(least, p=min(1.0, least.p * len(found)))


def _noise_finding(recording: Recording, name: str, label: str) -> Finding:
    values, sensor = recording[name], recording.sensor(name)
    seen, _, louder, quieter = _noise_test(values, sensor)
    p = 1.0
    if sensor.noise > 0 and seen > 0 and quieter > 0:
        error = NOISE_ERROR / math.sqrt(np.isfinite(values).sum())  # of the logarithm
        p = float(min(1.0, 2 * stats.norm.sf(math.log(max(louder, quieter)) / error)))
    return Finding(
        "noise",
        p,
        f"{label}: {recording.source.name}: the noise of {name} is described as {sensor.sd:.3g} "
        f"{recording.units[name]}, the data show {seen:.3g}",
    )


def _saturation_finding(recording: Recording, name: str, label: str) -> Finding:
    values, sensor = recording[name][np.isfinite(recording[name])], recording.sensor(name)
    ends = [float(values.max())] + ([float(values.min())] if values.min() < 0 else [])
    chance = max(masks.equal_by_chance(values, sensor), masks.MIN_CHANCE)
    runs = [s.stop - s.start for end in ends for s in true_intervals((values == end) & (end != 0))]
    longest = max(runs, default=0)
    p = min(1.0, values.size * chance ** (longest - 1)) if longest and chance <= masks.MAX_CHANCE else 1.0
    held = f"{label}: {recording.source.name}: {name} is held at its extreme over {longest} samples"
    return Finding("saturated signal", p, held)


def zero_limit(recording: Recording, name: str) -> float:
    """Largest error of a sensor's zero: that of its data sheet, else `ZERO_ERROR` of its range.

    Without a range it is that fraction of the largest reading, and at least ten times the noise.
    """
    sensor, samples = recording.sensor(name), recording[name]
    if sensor.zero_error is not None:
        return sensor.zero_error
    if math.isfinite(sensor.high - sensor.low):
        return ZERO_ERROR * (sensor.high - sensor.low)
    largest = float(np.nanmax(np.abs(samples), initial=0.0))
    return max(ZERO_ERROR * largest, ZERO_NOISE * sensor.noise)


def zero_limits(recordings: Sequence[Recording], names: Iterable[str]) -> dict[str, float]:
    """Largest error of each sensor's zero in any recording.

    It is above zero: a perfect sensor has an error of `FINEST` of its largest reading.
    """
    return {
        n: max(
            max(zero_limit(r, n), FINEST * float(np.nanmax(np.abs(r[n]), initial=0.0))) for r in recordings
        )
        for n in names
    }


def declared_limits(recordings: Sequence[Recording], names: Collection[str]) -> dict[str, float]:
    """Largest errors of zeros that data sheets of these sensors give; other sensors count as exact."""
    errors = {n: [r.sensor(n).zero_error for r in recordings] for n in names}
    return {n: max(x for x in own if x is not None) for n, own in errors.items() if any(own)}


def course(recording: Recording, when: Array | Sequence[slice]) -> tuple[Array, str]:
    """What may change a coefficient: the oil's temperature, or the time since the start.

    when   times since the start (n,), or stretches, at whose middles it is
    """
    start = recording.time[0]
    time = np.array(
        [recording.time[x].mean() - start if isinstance(x, slice) else x for x in when], dtype=float
    )
    if TEMPERATURE not in recording.signals:
        return time, "time"
    values = recording.interpolated(TEMPERATURE)
    return np.interp(start + time, recording.time, values), "oil temperature"


def with_course(recording: Recording, samples: Samples) -> tuple[Samples, tuple[Array, str]]:
    """Samples of windows, with the `course` at their centres."""
    return samples, course(recording, samples.times)


def steady_stretches(recording: Recording, names: Sequence[str]) -> list[slice]:
    """Stretches in which no signal changes faster than its noise or ripple explains.

    The ripple of a pump is not white: its effect on the rate is measured as the scatter of the rate, which is
    close to zero most of the time. Gaps are interpolated here and left out of means.
    """
    derivative = filter_for(recording, RATE_WINDOW, 2)
    margin, shortest = (round(x * derivative.rate) for x in (MARGIN, SHORTEST_CORE))
    steady = np.ones(recording.time.size, dtype=bool)
    for name in names:
        rate = derivative.apply(recording.interpolated(name), 1)
        ripple = float(stats.median_abs_deviation(rate, scale="normal", nan_policy="omit"))
        noise_of_rate = derivative.gain(1) * noise_sd(recording, name)
        steady &= np.abs(rate) < STEADY * max(noise_of_rate, ripple)  # false if NaN
    cores = [slice(s.start + margin, s.stop - margin) for s in true_intervals(steady)]
    return [s for s in cores if s.stop - s.start >= shortest]


@dataclass(frozen=True)
class Means:
    """Means of signals over steady stretches, and their standard errors, shape (signals, n).

    along     the `course` of each stretch, shape (n,), as the following
    dead      a meter is in its dead zone at least at times, so that its mean is wrong
    clipped   an instrument is at an end of its range, or stuck, at least at times
    good      neither dead nor clipped, and half of the samples are valid
    """

    means: Array
    errors: Array
    along: Array
    dead: Mask
    clipped: Mask
    good: Mask

    def __getitem__(self: Stretches, rows: Mask | NDArray[np.intp]) -> Stretches:
        """Some of the stretches."""
        return type(self)(**{name: column[..., rows] for name, column in vars(self).items()})

    def omissions(self) -> str:
        """Numbers of stretches that are not good, with the reasons; empty if all are good."""
        reasons = (
            (self.dead, "in the dead zone of the flow meter"),
            (self.clipped, "with an instrument at an end of its range"),
            (~(self.dead | self.clipped | self.good), "without enough samples or without flow"),
        )
        return ", ".join(f"{np.count_nonzero(mask)} {reason}" for mask, reason in reasons if mask.any())


def concatenate(tables: Sequence[Stretches]) -> Stretches:
    """The stretches of several recordings, one table after the other."""
    columns: dict[str, Any] = {
        n: np.concatenate([vars(t)[n] for t in tables], axis=-1) for n in vars(tables[0])
    }
    return type(tables[0])(**columns)


def means_over(recording: Recording, signals: Collection[str], stretches: Sequence[slice]) -> Means:
    """Means of signals over stretches of a recording, also those of readings in the dead zone of a meter."""
    means, errors = masks.averages(recording, tuple(signals), stretches)
    dead, wrong = (np.zeros(len(stretches), dtype=bool) for _ in range(2))
    for i, name in enumerate(signals):
        causes = masks.faults(recording, name)
        for k, part in enumerate(stretches):
            if causes["dead zone"][part].any():
                dead[k], means[i, k] = True, np.nanmean(recording[name][part])
            # a missing sample only drops out of the mean, but a sample with a wrong value biases it
            wrong[k] |= (causes["clipped"] | causes["stuck"])[part].any()
    return Means(
        means=means,
        errors=np.maximum(errors, FINEST * np.abs(means)),
        along=course(recording, stretches)[0],
        dead=dead,
        clipped=wrong & ~dead,
        good=~dead & ~wrong & np.isfinite(means).all(axis=0),
    )


def steady_means(
    recordings: Sequence[Recording],
    signals: Collection[str],
    steady: Sequence[str],
    least: int,
    zero: Callable[[Recording], float] = lambda _: 0.0,
) -> tuple[Means, tuple[Array, str]]:
    """Means over the stretches in which the signals `steady` are, and the `course` of the good ones.

    least   number of good stretches below which there is a Problem
    zero    of each recording, which is taken off its steady signals
    """
    tables, rows = list[Means](), np.array([[n in steady] for n in signals])
    for recording in recordings:
        found = means_over(recording, signals, steady_stretches(recording, steady))
        tables.append(replace(found, means=found.means - rows * zero(recording)))
    every = concatenate(tables)
    if (count := np.count_nonzero(every.good)) < least:
        raise Problem(
            f"{recordings[0].source}: expected {least} or more stretches of {SHORTEST_STRETCH:g} s with "
            f"steady {', '.join(steady)}, got {count}; left out of {every.good.size}: "
            f"{every.omissions() or 'none'}"
        )
    return every, (every.along[every.good], course(recordings[0], ())[1])


def pressure_offset(solution: Solution) -> Estimate:
    """Difference of the two pressures without flow."""
    value, sd = solution.every.combination({"pressure_in": 1.0, "pressure_out": -1.0})
    return Estimate.normal("pressures without flow", value, "Pa", sd, "pressure_in - pressure_out")


def pressure_offset_remark(zero: Estimate) -> Iterator[str]:
    """A sentence if the estimated difference of the two pressures without flow is significant."""
    if abs(zero.value) > SIGNIFICANT * zero.sd:
        offset = f"{zero.value / BAR[1]:.2g} +- {zero.sd / BAR[1]:.1g} bar"
        yield (
            f"Without flow the two pressures would differ by {offset}. "
            "This offset of the transducers is subtracted."
        )
