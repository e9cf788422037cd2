"""Prediction of steps by the FMU: curves, 95 % bands, and their distance from the measured runs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from fit import OUTPUTS, speeds
from numpy.typing import NDArray

from orchestrator import Trace, run
from orchestrator.data.recording import Recording

Array = NDArray[np.float64]
PRESSURES = OUTPUTS[1:]
LEVEL = 0.95
STEPS = 2  # communication steps from sample to sample


@dataclass(frozen=True)
class Band:
    """The prediction of one command, and draws of it.

    time    shape (n,), from the first sample of the recordings [s]
    curve   output -> shape (n,)
    draws   output -> curves of other parameters and runs, shape (draws, n)
    """

    time: Array
    curve: Mapping[str, Array]
    draws: Mapping[str, Array]

    def limits(self, output: str, noise: float, count: int) -> tuple[Array, Array]:
        """Lower and upper limit of the first `count` samples that a run with this noise is in, shape (n,)."""
        spread = np.random.default_rng(1).normal(0.0, noise, (4, *self.draws[output][:, :count].shape))
        samples = (self.draws[output][None, :, :count] + spread).reshape(-1, count)
        low, high = np.quantile(samples, [(1 - LEVEL) / 2, (1 + LEVEL) / 2], axis=0)
        return low, high


def simulate(
    fmu: Path, recording: Recording, parameters: Mapping[str, float] | None = None
) -> dict[str, Array]:
    """Outputs of the FMU at the samples of a recording, driven by its command."""
    time = recording.time - recording.time[0]
    step = float(time[-1] / (len(time) - 1))
    result = run(
        str(fmu),
        Trace(time, {"command": recording["command"]}),
        step=step / STEPS,
        stop=float(time[-1]),
        record_step=step,
        set={f"axis.{name}": value for name, value in (parameters or {}).items()},
        record=[f"axis.{name}" for name in OUTPUTS],
        isolate=False,
    )
    return {name: result[f"axis.{name}"] for name in OUTPUTS}


def predict(fmu: Path, recording: Recording, drawn: Sequence[Mapping[str, float]]) -> Band:
    """The curve of the FMU as it is, and one for each draw."""
    others = [simulate(fmu, recording, p) for p in drawn]
    return Band(
        recording.time,
        simulate(fmu, recording),
        {name: np.array([y[name] for y in others]) for name in OUTPUTS},
    )


def residuals(band: Band, recordings: Sequence[Recording], output: str) -> Array:
    """Prediction minus measurement of all runs that have the output, shape (runs, n), NaN where clipped."""
    runs = [r[output] for r in recordings if output in r.signals]
    count = min(len(values) for values in runs)
    return np.array([band.curve[output][:count] - values[:count] for values in runs])


def held(band: Band, recordings: Sequence[Recording], output: str, noise: float) -> float:
    """Share of the samples within the limits."""
    inside = []
    for recording in recordings:
        if output in recording.signals:
            values = recording[output]
            count = min(len(values), len(band.time))
            low, high = band.limits(output, noise, count)
            used = np.isfinite(values[:count])
            inside.append(((values[:count] >= low) & (values[:count] <= high))[used])
    return float(np.mean(np.concatenate(inside)))


def calibrated_noise(bands: Mapping[int, Band], recordings: Sequence[Recording], output: str) -> float:
    """Standard deviation of sensor and model with which the bands hold 95 % of the identification set.

    bands   by step [V]
    """

    def share(noise: float) -> float:
        shares = [
            held(band, [r for r in recordings if r.conditions["step"] == volts], output, noise)
            for volts, band in bands.items()
        ]
        return float(np.mean(shares))

    low, high = 1e-3, 100.0
    unit = next(r.sensor(output).sd for r in recordings if output in r.signals)
    for _ in range(12):  # bisection of the logarithm to 0.3 %
        middle = float(np.sqrt(low * high))
        low, high = (low, middle) if share(middle * unit) > LEVEL else (middle, high)
    return high * unit


@dataclass(frozen=True)
class Errors:
    """Distance of the prediction from the runs with one step.

    stroke          RMS error of the position over its range [1]
    speeds          relative error of the mean speeds out and in, shape (2,)
    pressures       output -> RMS error of the pressure [Pa]
    repeatability   output -> standard deviation of the runs at equal times, RMS over the time [Pa]; NaN for a
                    single run
    held            output -> share of the samples in the 95 % band
    """

    stroke: float
    speeds: Array
    pressures: dict[str, float]
    repeatability: dict[str, float]
    held: dict[str, float]


def compare(band: Band, recordings: Sequence[Recording], noise: Mapping[str, float]) -> Errors:
    """The errors of the prediction of one step."""
    measured = np.mean([speeds(r) for r in recordings], axis=0)
    predicted = speeds(_as_recording(band, recordings[0]))
    error = {name: residuals(band, recordings, name) for name in OUTPUTS}
    return Errors(
        stroke=_rms(error["position"]) / float(np.ptp(band.curve["position"])),
        speeds=predicted / measured - 1,
        pressures={name: _rms(error[name]) for name in PRESSURES},
        repeatability={name: _deviation(error[name]) for name in PRESSURES},
        held={name: held(band, recordings, name, noise[name]) for name in OUTPUTS},
    )


def _as_recording(band: Band, like: Recording) -> Recording:
    signals = {"command": like["command"], "position": band.curve["position"]}
    return Recording(like.time, signals, {"command": "V", "position": "m"}, like.source)


def _deviation(values: Array) -> float:
    """Standard deviation over the runs, RMS over the time, of values with shape (runs, n)."""
    runs = len(values)
    return _rms(values - values.mean(axis=0)) * np.sqrt(runs / (runs - 1)) if runs > 1 else np.nan


def _rms(values: Array) -> float:
    return float(np.sqrt(np.nanmean(values**2)))
