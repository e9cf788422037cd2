"""Attribution of a residual to physical effects: regression on the changes that variants of parts cause.

The residual r(t) = measured - predicted of all signals, each over its own root mean square, is regressed on
the change that each effect causes in the identified machine, d_k(t) = y(t; variant k) - y(t; default
machine):

    r = sum_k c_k d_k + sum_j b_j dy/dp_j + e        c_k >= 0

The sensitivities dy/dp_j to the identified parameters absorb as much as they can, because a fit without the
effect has biased the parameters. c_k = 1 means an effect as strong as in the variant. Shares are fractions of
the residual's sum of squares. "Alone" is the share of effect k as the only one.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import repeat

import numpy as np
import statsmodels.api as sm
from scipy.optimize import nnls

from fmus.identification.recordings.clock import period
from fmus.identification.report import prediction
from fmus.identification.report.prediction import Excitation, Signals, excitation, predict
from fmus.identification.results import CONFIDENCE
from orchestrator.base.processes import mapping
from orchestrator.base.signals import rms
from orchestrator.data.table import Array

# effect -> the variants that have it
EFFECTS: Mapping[str, Mapping[str, str]] = {
    "swinging head": {"manipulator": "pendulum"},
    "dry friction": {"manipulator": "friction"},
    "hose walls, air and spools of boom and stick": {"boom_stick": "detailed"},
    "hose walls, air and spool of the swing": {"swing": "detailed"},
    "pump and engine": {"supply": "engine_pump"},
}
SHIFT = 0.02  # s, of the commands; the signals change nearly in proportion to it
LATE, EARLY = (f"commands {SHIFT:g} s {than} than logged" for than in ("later", "earlier"))
ABOVE_NOISE = 1.5  # rms residual over the sensor's noise below which a signal is left out
MEMORY = 0.5  # s, lag up to which samples of a residual are assumed to be correlated
LEAST = 0.2  # share above which an effect is reported
CLOSE = 0.8  # fraction of the largest share above which an effect cannot be distinguished from the largest
SMALL = 1e-3  # rms residual over the range of a signal below which it needs no explanation


def percent(ratio: float) -> str:
    """A ratio in whole percent; infinite for a simulation that failed."""
    return f"{100 * ratio:.0f} %" if math.isfinite(ratio) else "(could not be simulated)"


def candidate_effects(excitation: Excitation) -> dict[str, Mapping[str, str]]:
    """Effects that may explain a residual; a measured supply pressure includes those of the supply."""
    measured = "supply_pressure" in excitation.lines
    return {name: variants for name, variants in EFFECTS.items() if not (measured and "supply" in variants)}


def effect_changes(
    excitation: Excitation, parameters: Mapping[str, float], processes: int = 1
) -> dict[str, dict[str, Array]]:
    """Change of every signal of the machine by each effect, and by commands at other times."""
    default, effects = predict(excitation, parameters), candidate_effects(excitation)
    time, commands = excitation.time, excitation.commands
    late = replace(excitation, commands={n: np.interp(time - SHIFT, time, u) for n, u in commands.items()})
    excited = [late, *repeat(excitation, len(effects))]
    with mapping(min(processes, len(excited))) as each:
        predicted = each(predict, excited, repeat(parameters), [{}, *effects.values()])
        changes = {
            name: {n: y[n] - default[n] for n in default if n in y}
            for name, y in zip((LATE, *effects), predicted, strict=True)
        }
    return changes | {EARLY: {n: -y for n, y in changes[LATE].items()}}


def attribute(
    comparison: prediction.RecordingComparison, parameters: Mapping[str, float], processes: int = 1
) -> Explanation:
    """Which effect the residual shows, apart from errors of the identified parameters.

    parameters   values of the identified machine
    processes    number of processes that simulate the machine, which take most of the time
    """
    recording, residual = comparison.recording, comparison.residual()
    noise = {name: recording.sensor(name).sd for name in residual}
    measured = {n: y[np.isfinite(y)] for n, y in comparison.measured.items() if n in residual}
    small = {name: SMALL * float(np.ptp(y)) for name, y in measured.items() if y.size}
    effects: Mapping[str, Signals] = {}
    if unexplained(residual, noise, small):  # else the simulations, most of the time, would tell nothing
        effects = effect_changes(excitation(recording), parameters, processes)
    step = period(recording.time)
    return explain(residual, effects, step=step, noise=noise, small=small, absorbed=comparison.sensitivities)


@dataclass(frozen=True)
class EffectShare:
    """Share of the residual's sum of squares that one effect explains.

    alone                    as the only effect
    coefficient, low, high   strength (1: as in the variant) with its 95 % interval
    signals                  share alone by signal, after subtraction of what the parameters absorb
    """

    effect: str
    alone: float
    coefficient: float
    low: float
    high: float
    signals: Mapping[str, float]


@dataclass(frozen=True)
class Explanation:
    """Effects that a residual shows.

    shares       by effect, the largest share alone first
    together     share that all effects explain
    parameters   share that other values of the identified parameters would explain
    noise        share of the noise of the sensors
    quiet        signals left out because their residual is small or not above the noise
    verdict      summary in sentences
    """

    shares: tuple[EffectShare, ...]
    together: float
    parameters: float
    noise: float
    signals: tuple[str, ...]
    quiet: tuple[str, ...]
    verdict: str

    @property
    def effect(self) -> str:
        """The effect with the largest share, empty if that share is small."""
        return self.shares[0].effect if self.shares and self.shares[0].alone >= LEAST else ""


def explain(
    residual: Signals,
    effects: Mapping[str, Signals],
    *,
    step: float,
    noise: Mapping[str, float] | None = None,
    absorbed: Mapping[str, Signals] | None = None,
    small: Mapping[str, float] | None = None,
) -> Explanation:
    """Explanation of a residual by effects.

    residual   measured - predicted by signal, shape (n,); NaN if there is no sample
    effects    change of the signals by each effect
    step       sample time [s]
    noise      standard deviation of a sample of each signal's sensor
    absorbed   change of the signals by each identified parameter
    small      root mean square of each signal's residual below which the signal is left out
    """
    noise, small = noise or {}, small or {}
    size = {name: rms(values[np.isfinite(values)]) for name, values in residual.items()}
    used = unexplained(residual, noise, small)
    quiet = tuple(n for n in residual if n not in used)
    if not used:
        above_noise = any(size[n] > ABOVE_NOISE * noise.get(n, 0.0) for n in residual)
        limit = f" or to {100 * SMALL:g} % of its range" if above_noise else ""
        predicted = f"each signal is predicted to the noise of its sensor{limit}"
        text = f"Nothing is left to explain: {predicted}, so the residual shows no effect."
        return Explanation((), 0.0, 0.0, 1.0, (), quiet, text)
    valid = {n: np.isfinite(residual[n]) for n in used}
    counts = [int(valid[n].sum()) for n in used]

    def column(signals: Signals) -> Array:
        """All signals in one column, each over its rms residual and the root of its number of samples."""
        parts = [signals.get(n, 0 * residual[n])[valid[n]] / size[n] for n in used]
        return np.concatenate([y / np.sqrt(y.size) for y in parts])

    r = column(residual)
    d = np.column_stack([column(change) for change in effects.values()])
    total = float(r @ r)
    if absorbed:
        s = np.column_stack([column(change) for change in absorbed.values()])
        r, d = orthogonal_part(r, s), orthogonal_part(d, s)
    parameters = 1 - float(r @ r) / total
    shares = [
        EffectShare(
            name,
            explained_squares(change[:, None], r) / total,
            *strength_interval(change, r, round(MEMORY / step)),
            dict(zip(used, shares_by_part(change, r, counts), strict=True)),
        )
        for name, change in zip(effects, d.T, strict=True)
    ]
    together = explained_squares(d, r) / total
    ordered = tuple(sorted(shares, key=lambda s: -s.alone))
    of_noise = float(np.mean([min(1.0, (noise.get(n, 0.0) / size[n]) ** 2) for n in used]))
    text = verdict(ordered, together, parameters, of_noise)
    return Explanation(ordered, together, parameters, of_noise, tuple(used), quiet, text)


def unexplained(residual: Signals, noise: Mapping[str, float], small: Mapping[str, float]) -> list[str]:
    """Signals whose residual is above the noise of their sensor, and not small; arguments as in `explain`."""
    least = {n: max(ABOVE_NOISE * noise.get(n, 0.0), small.get(n, 0.0)) for n in residual}
    return [n for n, values in residual.items() if rms(values[np.isfinite(values)]) > least[n]]


def orthogonal_part(columns: Array, regressors: Array) -> Array:
    """The part of columns that is orthogonal to the regressors."""
    length = np.linalg.norm(regressors, axis=0)
    scaled = regressors / np.where(length > 0, length, 1.0)
    # without directions that are rounding errors
    orthogonal: Array = columns - scaled @ np.linalg.lstsq(scaled, columns, rcond=1e-6)[0]
    return orthogonal


def explained_squares(d: Array, r: Array) -> float:
    """Sum of squares of r that the effects d (columns) explain together, c >= 0."""
    return max(float(r @ r) - float(nnls(d, r)[1]) ** 2, 0.0)


def strength_interval(d: Array, r: Array, lags: int) -> tuple[float, float, float]:
    """Strength of an effect alone with its 95 % interval for correlated errors [Newey, West]."""
    if not d.any():
        return 0.0, 0.0, 0.0
    fit = sm.OLS(r, d[:, None]).fit(cov_type="HAC", cov_kwds={"maxlags": max(1, lags)})
    low, high = fit.conf_int(alpha=1 - CONFIDENCE)[0]
    return float(fit.params[0]), float(low), float(high)


def shares_by_part(d: Array, r: Array, counts: Sequence[int]) -> list[float]:
    """Share of each part of a residual that an effect explains at its strength from all parts."""
    strength = max(0.0, float(d @ r) / float(d @ d)) if d.any() else 0.0
    left, total = (np.add.reduceat(x**2, np.cumsum([0, *counts[:-1]])) for x in (r - strength * d, r))
    return [1 - float(x / of) if of else 0.0 for x, of in zip(left, total, strict=True)]


def verdict(shares: Sequence[EffectShare], together: float, parameters: float, noise: float) -> str:
    """Summary of an explanation in sentences; arguments as in `Explanation`."""
    first = shares[0]
    if first.alone < LEAST:
        text = (
            f"None of the effects below explains the residual: the largest share is {percent(first.alone)} "
            f"({first.effect}), and all effects together explain {percent(together)}."
        )
    else:
        text = (
            f"The largest part of the residual comes from one effect: {first.effect}, "
            f"{percent(first.alone)}, {first.coefficient:.2g} times as strong as in the variant. "
            f"All effects together explain {percent(together)}."
        )
        if close := [s.effect for s in shares[1:] if s.alone >= CLOSE * first.alone]:
            text += f" The data can hardly distinguish it from {' and '.join(close)}."
        if first.effect in (LATE, EARLY):
            delay = first.coefficient * (SHIFT if first.effect == LATE else -SHIFT)
            most = math.ceil(20 * abs(delay)) / 10  # s: twice the delay
            text += (
                f" The key `delay = {delay:.2g}` at each command, or that much more than it has, corrects "
                f"most of it. With `delay_error = {most:g}` in its place identify estimates the delay of "
                "each command."
            )
    if parameters > LEAST / 2:
        text += (
            f" Slightly different values of the identified parameters would remove {percent(parameters)}: "
            "this part is their uncertainty, or an effect that resembles it."
        )
    if noise > LEAST / 2:
        text += f" {percent(noise)} is noise of the sensors."
    unexplained = 1 - together - parameters - noise
    if unexplained > LEAST / 2:
        text += f" {percent(unexplained)} has a cause that is not in the list."
    return text
