"""Uncertainty of the estimates, and tests of the residuals.

Covariances, noise of the inputs, and parameters that the data do not determine; simulation error (NRMSE),
whiteness of the residuals, and their cross-correlation with the inputs.

All covariances are those of the search variable z, in relative changes for most parameters. They include the
uncertainty of the initial states of the runs, which are unknowns too.

Smoothing leaves an error in a measured input that is small but as slow as the smoothing window. The estimates
follow this error, and the residuals do not show it. Its effect is therefore computed by simulation: smoothed
noise is added to the inputs, and the change of the estimates follows from the linearisation at the optimum.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse.csgraph import connected_components
from scipy.stats import norm
from statsmodels.tsa.stattools import acf

from fmus.identification.recordings.masks import autocorrelation_time, noise
from fmus.identification.refinement.compiled_model import CompiledModel, SimulationFailed
from fmus.identification.refinement.problem import FreeParameter, MeasuredRun, local_parabolas
from fmus.identification.refinement.shooting import LARGEST_RADIUS, CondensedRun, Minimum, Shooting, linearise
from orchestrator.base.signals import rms
from orchestrator.base.text import join_words
from orchestrator.data.table import Array

VAGUE = 100.0  # standard deviation of z in a weak prior on every parameter, which keeps all matrices regular
DRAWS = 24  # of the input noise: relative error of a standard deviation 1 / sqrt(2 n), 15 %
LIMIT = 0.5  # standard deviation of z; the data do not determine a combination with a larger one
_TAKES_PART = 0.05  # smallest entry of the projector on such combinations that counts
LAGS = 40  # samples
NOISE_ERROR = 1.8  # relative standard deviation of `masks.noise` times root n, for white noise (computed)
_BOUND = float(norm.ppf(0.995))  # 99 % bound of a correlation, in standard deviations


@dataclass(frozen=True)
class Statistics:
    """Covariances of z, shape (np, np), and their basis.

    covariance           for independent residuals, corrected for the correlation time of the scales
    robust_covariance    cluster-robust over segments: for residuals correlated over no more than a segment
    data_covariance      from the data alone, without priors
    degrees_of_freedom   samples that count (those of one correlation time as one) minus unknowns
    segments             number of segments
    condition            condition number of the Jacobian of the data, columns scaled to length one

    The covariances include the noise of measured inputs.
    """

    covariance: Array
    robust_covariance: Array
    data_covariance: Array
    degrees_of_freedom: int
    segments: int
    condition: float

    def sd(self, robust: bool) -> Array:
        """Standard deviations of z."""
        return np.sqrt(np.diag(self.robust_covariance if robust else self.covariance))

    def degrees(self, robust: bool) -> int:
        """Degrees of freedom of these standard deviations."""
        return max(1, self.segments - 1) if robust else self.degrees_of_freedom

    @property
    def correlation(self) -> Array:
        """Correlation matrix of `covariance`."""
        sd = self.sd(False)
        return np.asarray(self.covariance / np.outer(sd, sd))


def statistics(solution: Minimum, prior_sd: Array, by_inputs: Array) -> Statistics:
    """Statistics at the end of a search.

    prior_sd    prior standard deviations of z
    by_inputs   covariance that the noise of the inputs causes
    """
    linear, parameters = solution.linear, len(prior_sd)
    at, scales = linear.at, linear.scales
    weighted = at.residual / scales.sd[at.column]
    samples = float(np.sum(1 / scales.correlation_time[at.column]))
    initial_states = sum(len(run.top) for run in linear.runs)
    degrees_of_freedom = max(1, round(samples) - parameters - initial_states)
    variance = float(weighted @ weighted) / degrees_of_freedom
    jacobian = np.vstack([run.bottom[:, :-1] for run in linear.runs])
    prior = np.diag(1 / prior_sd**2 + 1 / VAGUE**2)
    information = jacobian.T @ jacobian
    lengths = np.linalg.norm(jacobian, axis=0)
    condition = float(np.linalg.cond(jacobian / np.where(lengths > 0, lengths, 1.0)))
    return Statistics(
        covariance=_inverse(information / variance + prior) + by_inputs,
        robust_covariance=_jackknife(linear.runs, prior, _inverse(information + prior)) + by_inputs,
        data_covariance=_inverse(information / variance + np.eye(parameters) / VAGUE**2) + by_inputs,
        degrees_of_freedom=degrees_of_freedom,
        segments=len(at.segments),
        condition=condition if len(jacobian) >= parameters else math.inf,
    )


def _inverse(matrix: Array) -> Array:
    """Inverse of a positive definite matrix, scaled because magnitudes differ widely.

    Eigenvalues are bounded from below by rounding, so that rounding errors do not count as information.
    """
    diagonal = np.diag(matrix)
    scale = 1 / np.sqrt(np.maximum(diagonal, np.finfo(float).eps * max(diagonal.max(), 1.0)))
    eigenvalues, vectors = np.linalg.eigh(matrix * np.outer(scale, scale))
    floor = np.finfo(float).eps * (eigenvalues[-1] or 1.0)  # 1: no information at all
    return np.asarray((vectors / np.maximum(eigenvalues, floor)) @ vectors.T * np.outer(scale, scale))


def _jackknife(runs: Sequence[CondensedRun], prior: Array, inverse: Array) -> Array:
    """Jackknife covariance over segments [CR3: Bell and McCaffrey 2002]; priors add their known variance.

    Each segment is left out in turn; the change of z is computed to first order.
    """
    changes: list[Array] = []
    bottoms = [run.bottom[:, :-1].T @ run.bottom[:, :-1] for run in runs]
    for run in runs:
        nx = len(run.top)
        information = np.zeros((nx + len(prior), nx + len(prior)))
        information[nx:, nx:] = sum(bottoms, prior)
        information += run.top[:, :-1].T @ run.top[:, :-1]
        # exactly optimal initial state: the first segment knows nearly all of it, so without that segment
        # what a search leaves of its gradient would become a large change
        start = np.zeros(nx + len(prior))
        start[:nx] = -np.linalg.solve(run.top[:, :nx], run.top[:, -1])
        for rows in run.blocks:
            contribution, residual = rows[:, :-1].T @ rows[:, :-1], rows[:, -1] + rows[:, :-1] @ start
            gradient = rows[:, :-1].T @ residual
            changes.append((_inverse(information - contribution) @ gradient)[nx:])
    count, all_changes = len(changes), np.array(changes)
    if count == 1:
        return inverse
    return np.asarray((count - 1) / count * all_changes.T @ all_changes + inverse @ prior @ inverse)


def input_covariance(shooting: Shooting, solution: Minimum) -> Array:
    """Covariance of z that the noise of the inputs causes, shape (np, np): that which smoothing leaves."""
    parameters, problem, names = len(solution.z), shooting.problem, shooting.simulator.inputs
    if not any(run.input_noise for run in problem.training):
        return np.zeros((parameters, parameters))
    rng, changes = np.random.default_rng(0), []
    optimum, reference = solution.linear.at, solution.linear.step(LARGEST_RADIUS)

    def noisy(run: MeasuredRun) -> MeasuredRun:
        noise = {n: run.input_noise[n] for n in names if n in run.input_noise}
        drawn = {
            n: run.inputs[n] + local_parabolas(sd * rng.standard_normal(len(run.time)), window)
            for n, (sd, window) in noise.items()
        }
        return replace(run, inputs={**run.inputs, **drawn})

    for _ in range(DRAWS):
        drawn = replace(problem, training=tuple(map(noisy, problem.training)))
        try:
            new = replace(shooting, problem=drawn).evaluate(optimum.z, optimum.starts, False)
        except SimulationFailed:
            continue
        changed = linearise(shooting, optimum, new, solution.linear.scales)
        changes.append(changed.step(LARGEST_RADIUS) - reference)
    draws = np.array(changes).reshape(-1, parameters)
    return np.asarray(draws.T @ draws / max(1, len(draws)))


def unidentified(free: Sequence[FreeParameter], data_covariance: Array) -> tuple[str, ...]:
    """One sentence per group of parameters that the data do not determine, alone or in combination.

    data_covariance   covariance of z from the data alone, shape (np, np)
    """
    variances, vectors = np.linalg.eigh(data_covariance)
    undetermined = vectors[:, variances > LIMIT**2]
    projector = undetermined @ undetermined.T  # its diagonal blocks are the groups
    part = np.flatnonzero(np.diag(projector) > _TAKES_PART)
    count, groups = connected_components(np.abs(projector[np.ix_(part, part)]) > _TAKES_PART)
    sentences = []
    for group in (part[groups == k] for k in range(count)):
        block = np.ix_(group, group)
        sentences.append(_sentence([free[j] for j in group], projector[block], data_covariance[block]))
    return tuple(sentences)


def _sentence(group: list[FreeParameter], projector: Array, data_covariance: Array) -> str:
    names = [f.name for f in group]
    listed, dimension = join_words(names), round(float(np.trace(projector)))
    if len(names) == 1:
        sd = float(np.sqrt(data_covariance[0, 0]))
        limit = f"leave a standard deviation of {100 * sd:.0f} %"
        reason = "do not determine it" if sd > 0.5 * VAGUE else limit
        if group[0].sd is None:
            return f"{listed}: the data {reason}"
        return f"{listed}: these recordings alone {reason}; the interval is that of the prior"
    if len(names) > 2 or dimension > 1 or not all(f.log for f in group):
        return f"{listed}: the data determine {len(names) - dimension} of {len(names)} combinations"
    # along the undetermined direction (a, b) of two logarithms z_1 - a / b z_2 stays the same
    exponent = float(projector[0, 1] / projector[1, 1])
    power = "" if abs(abs(exponent) - 1) < 0.05 else f"^{abs(exponent):.2g}"
    combination = f"{names[0]} {'/' if exponent > 0 else '*'} {names[1]}{power}"
    return f"{listed}: the data determine only {combination}, not each parameter"


@dataclass(frozen=True)
class SimulatedRun:
    """A run simulated from its initial state without any correction: outputs, shape (n, ny)."""

    run: MeasuredRun
    y: Array

    @property
    def error(self) -> Array:
        """Simulation minus measurement; NaN for samples that are not compared."""
        return np.where(self.run.compared, self.y - self.run.measured, np.nan)


def nrmse(simulated: Sequence[SimulatedRun]) -> Array:
    """Per output, over all runs: root mean square error over the largest range of the measurement.

    If a joint is at rest in a run, the range of its angle there is noise. NaN without a measurement, infinite
    if a simulation failed; no values without runs.
    """
    relative = []
    for k in range(simulated[0].y.shape[1] if simulated else 0):
        runs = [s for s in simulated if s.run.compared[:, k].any()]
        error = np.concatenate([s.error[s.run.compared[:, k], k] for s in runs] or [np.zeros(0)])
        relative.append(
            np.nan_to_num(rms(error), nan=np.inf) / max(s.run.scale[k] for s in runs) if runs else np.nan
        )
    return np.array(relative)


def simulate(
    run: MeasuredRun, simulator: CompiledModel, p: Array, start: Array | None = None
) -> SimulatedRun:
    """Simulate a run; the initial state is by default that of the first samples. NaN if it fails."""
    state = run.initial_state(simulator, p)[0] if start is None else start
    try:
        return SimulatedRun(run, simulator.segment(state, p, run.time, run.delayed(simulator, p), False).y)
    except SimulationFailed:
        return SimulatedRun(run, np.full(run.measured.shape, np.nan))


@dataclass(frozen=True)
class Whiteness:
    """Tests of one output's residuals.

    outside     fraction of the lags of the autocorrelation outside its 99 % bounds, 0.01 if white
    rms         root mean square of the residuals in standard deviations of the sensor
    excess      p-value of this root mean square if the residuals are noise of the sensor, see `excess`
    """

    outside: float
    rms: float
    excess: float = 1.0

    @property
    def white(self) -> bool:
        """Do the residuals look like sensor noise? A tenth of the lags outside is far beyond chance."""
        return self.outside < 0.1 and self.rms < 1.5


def whiteness(simulated: Sequence[SimulatedRun], output: int) -> Whiteness:
    """Tests over several runs; gaps between the runs keep lags from reaching from one into the next."""
    gap = np.full(LAGS + 1, np.nan)
    parts = []
    for s in simulated:
        weight = s.run.weight[:, output]
        parts += [np.where(weight > 0, s.error[:, output] * weight, np.nan), gap]
    residual = np.concatenate(parts)
    count = int(np.isfinite(residual).sum())
    if count < 4 * LAGS:
        return Whiteness(np.nan, np.nan)
    correlation = acf(residual, nlags=LAGS, fft=True, missing="conservative", result_object=False)[1:]
    outside = float(np.mean(np.abs(correlation) > _BOUND / np.sqrt(count)))
    return Whiteness(outside, float(np.sqrt(np.nanmean(residual**2))), excess(residual))


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
