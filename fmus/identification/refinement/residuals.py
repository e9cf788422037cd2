"""What is left: fit by pure simulation, memory of the residuals, correlation with the inputs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import correlate
from scipy.stats import norm
from statsmodels.tsa.stattools import acf

from fmus.identification.refinement.data import first_state, input_matrix
from fmus.identification.refinement.problem import MeasuredRun
from fmus.identification.refinement.simulation import SimulationFailed, Simulator

Array = NDArray[np.float64]

LAGS = 40  # samples
_BOUND = float(norm.ppf(0.995))  # of a correlation, in standard deviations: 99 % stay inside


@dataclass(frozen=True)
class Traces:
    """A run simulated from its start without any correction: outputs, shape (n, ny)."""

    run: MeasuredRun
    y: Array

    @property
    def error(self) -> Array:
        """Simulation minus measurement; NaN where nothing usable was measured."""
        return np.where(self.run.compared, self.y - self.run.measured, np.nan)

    def nrmse(self) -> Array:
        """Per output: root mean square of the error over the range of the whole measurement."""
        error = self.error
        power = np.full(error.shape[1], np.nan)
        some = self.run.compared.any(axis=0)
        power[some] = np.nanmean(error[:, some] ** 2, axis=0)
        return np.asarray(np.sqrt(power) / self.run.scale)


def simulated(
    run: MeasuredRun, simulator: Simulator, p: Array, start: Array | None = None, inputs: Array | None = None
) -> Traces:
    """A pure simulation; without a start state from what the first samples show."""
    inputs = input_matrix(run, simulator) if inputs is None else inputs
    state = first_state(run, simulator, p, inputs) if start is None else start
    try:
        return Traces(run, simulator.segment(state, p, run.time, inputs, False).y)
    except SimulationFailed:
        return Traces(run, np.full(run.measured.shape, np.nan))


@dataclass(frozen=True)
class Whiteness:
    """Tests of one output's residuals.

    ljung_box   probability of such correlations, over `LAGS` lags, if the residuals were white
    outside     share of the lags of the autocorrelation outside its 99 % bounds, 0.01 if white
    inputs      the same for the correlation with each input that moves
    rms         root mean square of the residuals in standard deviations of the sensor
    """

    ljung_box: float
    outside: float
    inputs: Mapping[str, float]
    rms: float

    @property
    def white(self) -> bool:
        """Do they look like the sensor's noise? A tenth of the lags outside is far beyond chance."""
        return self.outside < 0.1 and self.rms < 1.5


def whiteness(traces: Sequence[Traces], inputs: Sequence[str], output: int) -> Whiteness:
    """Tests over several runs; no lag reaches from one into the next."""
    gap = np.full(LAGS + 1, np.nan)
    parts = []
    for t in traces:
        weight = t.run.weight[:, output]
        parts += [np.where(weight > 0, t.error[:, output] * weight, np.nan), gap]
    residual = np.concatenate(parts)
    count = int(np.isfinite(residual).sum())
    if count < 4 * LAGS:
        return Whiteness(np.nan, np.nan, {}, np.nan)
    memory, _, chance = acf(
        residual, nlags=LAGS, qstat=True, fft=True, missing="conservative", result_object=False
    )
    signals = {n: np.concatenate([p for t in traces for p in (t.run.inputs[n], gap)]) for n in inputs}
    return Whiteness(
        ljung_box=float(chance[-1]),
        outside=float(np.mean(np.abs(memory[1:]) > _BOUND / np.sqrt(count))),
        inputs={n: _outside(residual, u) for n, u in signals.items() if np.nanstd(u) > 0},
        rms=float(np.sqrt(np.nanmean(residual**2))),
    )


def _outside(residual: Array, signal: Array) -> float:
    """Share of lags at which a residual goes with an earlier input, beyond chance.

    The variance of a cross-correlation of independent signals is sum_k r_e(k) r_u(k) / n [Bartlett 1955].
    """
    # of mean 0 and standard deviation 1; gaps become 0
    e, u = (np.nan_to_num((s - np.nanmean(s)) / (np.nanstd(s) or 1.0)) for s in (residual, signal))
    count = np.count_nonzero(e)
    cross = correlate(e, u, method="fft")[len(e) - 1 : len(e) + LAGS] / count
    reach = min(int(count) // 4, 4000)
    own = [correlate(s, s, method="fft")[len(s) - 1 : len(s) + reach] / np.count_nonzero(s) for s in (e, u)]
    variance = float(own[0][0] * own[1][0] + 2 * own[0][1:] @ own[1][1:]) / count
    return float(np.mean(np.abs(cross) > _BOUND * np.sqrt(max(variance, 1 / count))))
