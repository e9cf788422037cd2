"""Residual analysis: simulation error (NRMSE), whiteness tests, cross-correlation with the inputs."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.signal import correlate
from scipy.stats import norm
from statsmodels.tsa.stattools import acf

from fmus.identification.recordings.masks import autocorrelation_time, noise
from fmus.identification.refinement.compiled_model import SimulationFailed, Simulator
from fmus.identification.refinement.measured_runs import MeasuredRun
from orchestrator.data.table import Array

LAGS = 40  # samples
NOISE_ERROR = 1.8  # relative standard deviation of `masks.noise` times root n, for white noise (computed)
_BOUND = float(norm.ppf(0.995))  # 99 % bound of a correlation, in standard deviations


@dataclass(frozen=True)
class SimulatedRun:
    """A run simulated from its initial state without any correction: outputs, shape (n, ny)."""

    run: MeasuredRun
    y: Array

    @property
    def error(self) -> Array:
        """Simulation minus measurement; NaN for samples that are not compared."""
        return np.where(self.run.compared, self.y - self.run.measured, np.nan)

    def nrmse(self) -> Array:
        """Per output: root mean square error over the range of the measurement; NaN without a measurement."""
        error = self.error
        mean_square = np.full(error.shape[1], np.nan)
        measured = self.run.compared.any(axis=0)
        mean_square[measured] = np.nanmean(error[:, measured] ** 2, axis=0)
        return np.asarray(np.sqrt(mean_square) / self.run.scale)


def simulate(
    run: MeasuredRun, simulator: Simulator, p: Array, start: Array | None = None, inputs: Array | None = None
) -> SimulatedRun:
    """Simulate a run; the initial state is by default that of the first samples. NaN if it fails."""
    inputs = run.input_matrix(simulator.inputs) if inputs is None else inputs
    state = run.initial_state(simulator, p, inputs)[0] if start is None else start
    try:
        return SimulatedRun(run, simulator.segment(state, p, run.time, inputs, False).y)
    except SimulationFailed:
        return SimulatedRun(run, np.full(run.measured.shape, np.nan))


@dataclass(frozen=True)
class Whiteness:
    """Tests of one output's residuals.

    ljung_box   p-value of the Ljung-Box test over `LAGS` lags
    outside     fraction of the lags of the autocorrelation outside its 99 % bounds, 0.01 if white
    inputs      the same fraction for the cross-correlation with each input that is not constant
    rms         root mean square of the residuals in standard deviations of the sensor
    excess      p-value of this root mean square if the residuals are noise of the sensor, see `excess`
    """

    ljung_box: float
    outside: float
    inputs: Mapping[str, float]
    rms: float
    excess: float = 1.0

    @property
    def white(self) -> bool:
        """Do the residuals look like sensor noise? A tenth of the lags outside is far beyond chance."""
        return self.outside < 0.1 and self.rms < 1.5


def whiteness(simulated: Sequence[SimulatedRun], inputs: Sequence[str], output: int) -> Whiteness:
    """Tests over several runs; gaps between the runs keep lags from reaching from one into the next."""
    gap = np.full(LAGS + 1, np.nan)
    parts = []
    for s in simulated:
        weight = s.run.weight[:, output]
        parts += [np.where(weight > 0, s.error[:, output] * weight, np.nan), gap]
    residual = np.concatenate(parts)
    count = int(np.isfinite(residual).sum())
    if count < 4 * LAGS:
        return Whiteness(np.nan, np.nan, {}, np.nan)
    autocorrelation, _, p_values = acf(
        residual, nlags=LAGS, qstat=True, fft=True, missing="conservative", result_object=False
    )
    signals = {n: np.concatenate([p for s in simulated for p in (s.run.inputs[n], gap)]) for n in inputs}
    return Whiteness(
        ljung_box=float(p_values[-1]),
        outside=float(np.mean(np.abs(autocorrelation[1:]) > _BOUND / np.sqrt(count))),
        inputs={n: _cross_outside(residual, u) for n, u in signals.items() if np.nanstd(u) > 0},
        rms=float(np.sqrt(np.nanmean(residual**2))),
        excess=excess(residual),
    )


def excess(residual: Array) -> float:
    """P-value of the mean square of residuals over their noise, if they are noise alone.

    residual   in standard deviations of the sensor, NaN in gaps

    The noise is that of the sensor, or the white noise of the residuals if that is clearly larger: a noise
    that is stated too small is no error of the model. Squares that are correlated, as those of an encoder
    between two counts, are as few as their autocorrelation time tells.
    """
    squares = residual[np.isfinite(residual)] ** 2
    white, relative_error = float(np.nan_to_num(noise(residual))), NOISE_ERROR / math.sqrt(len(squares))
    if white < 1 + 3 * relative_error:
        white, relative_error = 1.0, 0.0
    above = float(squares.mean()) - white**2
    deviations = squares - squares.mean()
    if not above > 0 or not deviations.any():
        return 1.0
    variance = float(squares.var()) * max(1.0, autocorrelation_time(deviations)) / len(squares)
    return float(norm.sf(above / math.hypot(math.sqrt(variance), 2 * white**2 * relative_error)))


def _cross_outside(residual: Array, signal: Array) -> float:
    """Fraction of the lags at which a residual is correlated with an earlier input beyond chance.

    The variance of a cross-correlation of independent signals is sum_k r_e(k) r_u(k) / n [Bartlett 1955].
    """
    # normalised to mean 0 and standard deviation 1; gaps become 0
    e, u = (np.nan_to_num((s - np.nanmean(s)) / (np.nanstd(s) or 1.0)) for s in (residual, signal))
    count = np.count_nonzero(e)
    cross = correlate(e, u, method="fft")[len(e) - 1 : len(e) + LAGS] / count
    reach = min(int(count) // 4, 4000)
    r_e, r_u = (
        correlate(s, s, method="fft")[len(s) - 1 : len(s) + reach] / np.count_nonzero(s) for s in (e, u)
    )
    variance = float(r_e[0] * r_u[0] + 2 * r_e[1:] @ r_u[1:]) / count
    return float(np.mean(np.abs(cross) > _BOUND * np.sqrt(max(variance, 1 / count))))
