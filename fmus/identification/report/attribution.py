"""Which effect a residual shows: what each variant of a part would change, compared with the residual.

The residual r(t) = measured - predicted of all signals, each over its own root mean square, is regressed on
what each effect would change in the identified machine, d_k(t) = y(t; variant k) - y(t; the usual machine):

    r = sum_k c_k d_k + sum_j b_j dy/dp_j + e        c_k >= 0

The identified parameters p_j may take what they can: a fit without the effect has bent them to cover for it.
c_k = 1 means an effect as strong as the numbers of the variant say. A share is that of the residual's sum of
squares. Alone: only effect k is there. Together: the mean over all orders in which effects can be added
[Shapley value; Lindeman, Merenda and Gold 1980], so that the shares add up to what all of them explain.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from math import factorial

import numpy as np
import statsmodels.api as sm
from scipy.optimize import nnls

from fmus.identification.report.prediction import Array, Excitation, Signals, predict
from orchestrator.base.errors import Problem

# effect -> the variants that have it
EFFECTS: Mapping[str, Mapping[str, str]] = {
    "swinging head": {"manipulator": "pendulum"},
    "dry friction": {"manipulator": "friction"},
    "hose walls, air and spools of boom and stick": {"boom_stick": "detailed"},
    "hose walls, air and spool of the swing": {"swing": "detailed"},
    "pump and engine": {"supply": "engine_pump"},
}
STEP = 1e-3  # relative, of finite differences: errors of the solver are 1e5 times smaller
ABOVE_NOISE = 1.5  # times the sensor's noise: a residual below shows nothing
MEMORY = 0.5  # s: over which neighbouring samples of a residual are taken to depend on each other
LEAST = 0.2  # share from which an effect is reported
CLOSE = 0.8  # of the largest share: an effect that explains as much cannot be distinguished from it
SMALL = 1e-3  # of the range: a residual below needs no effect to explain it, whatever the sensor resolves


def shown(given: Excitation) -> dict[str, Mapping[str, str]]:
    """The effects that a prediction can miss: where the supply pressure was measured, its cause is in it."""
    measured = given.supply_pressure is not None
    return {name: swap for name, swap in EFFECTS.items() if not (measured and "supply" in swap)}


def changes(given: Excitation, numbers: Mapping[str, float]) -> dict[str, dict[str, Array]]:
    """What each effect would change in every signal of the machine."""
    usual = predict(given, numbers)
    return {name: _difference(predict(given, numbers, swap), usual) for name, swap in shown(given).items()}


def slopes(
    given: Excitation, numbers: Mapping[str, float], names: Iterable[str]
) -> dict[str, dict[str, Array]]:
    """What each parameter would change, by finite differences: one `STEP` of its value.

    A name without its part means the numbers of all parts that have it.
    """
    usual, found = predict(given, numbers), {}
    for name in names:
        own = {key: (1 + STEP) * v for key, v in numbers.items() if name in (key, key.partition(".")[2])}
        if not own:
            raise Problem(f"{name}: expected its number among those of the machine")
        found[name] = _difference(predict(given, {**numbers, **own}), usual)
    return found


def _difference(one: Signals, other: Signals) -> dict[str, Array]:
    return {name: one[name] - other[name] for name in other if name in one}


@dataclass(frozen=True)
class EffectShare:
    """What one effect explains, as shares of the residual's sum of squares.

    coefficient, low, high   how strong it is, 1 as in the variant, with its 95 % interval
    signals                  share alone, by signal, of what the parameters leave
    """

    effect: str
    alone: float
    together: float
    coefficient: float
    low: float
    high: float
    signals: Mapping[str, float]


@dataclass(frozen=True)
class Explanation:
    """Which effects a residual shows.

    shares      largest alone first
    together    share that all effects explain
    parameters  share that other values of the identified parameters would take
    noise       share that is noise of the sensors
    quiet       signals left out, because their residual is not above the noise
    verdict     all this in words
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
        """The effect that the residual shows, empty if it shows none."""
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
    """Which effects the residual shows.

    residual   measured - predicted by signal, shape (n,); NaN where there is no sample
    effects    what each effect would change
    step       sample time [s]
    noise      standard deviation of a sample of each signal's sensor
    absorbed   what each identified parameter would change
    small      root mean square of each signal's residual up to which it is good enough to be left alone
    """
    noise, small = noise or {}, small or {}
    size = {name: rms(values) for name, values in residual.items()}
    used = [n for n in residual if size[n] > max(ABOVE_NOISE * noise.get(n, 0.0), small.get(n, 0.0))]
    quiet = tuple(n for n in residual if n not in used)
    if not used:
        only_small = any(size[n] > ABOVE_NOISE * noise.get(n, 0.0) for n in residual)
        return Explanation((), 0.0, 0.0, 1.0, (), quiet, nothing(only_small))
    known = {n: np.isfinite(residual[n]) for n in used}

    def column(signals: Signals) -> Array:
        """Signals under each other, each over its size; those with many samples count as much as others."""
        weights = {n: 1 / (size[n] * np.sqrt(known[n].sum())) for n in used}
        return np.concatenate(
            [weights[n] * (signals[n] if n in signals else 0 * residual[n])[known[n]] for n in used]
        )

    r = column(residual)
    d = np.column_stack([column(change) for change in effects.values()])
    whole = float(r @ r)
    ends = np.cumsum([0, *(int(known[n].sum()) for n in used)])
    ranges = {n: slice(int(ends[k]), int(ends[k + 1])) for k, n in enumerate(used)}
    if absorbed:
        slope = np.column_stack([column(change) for change in absorbed.values()])
        r, d = without(slope, r), without(slope, d)
    parameters = 1 - float(r @ r) / whole
    part = explained(d, r) / whole
    joint = shapley(part, len(effects))
    shares = [
        EffectShare(
            name,
            float(part[1 << k]),
            joint[k],
            *coefficient(d[:, k], r, round(MEMORY / step)),
            by_signal(d[:, k], r, ranges),
        )
        for k, name in enumerate(effects)
    ]
    ordered = tuple(sorted(shares, key=lambda s: -s.alone))
    noisy = float(np.mean([min(1.0, (noise.get(n, 0.0) / size[n]) ** 2) for n in used]))
    text = verdict(ordered, float(part[-1]), parameters, noisy)
    return Explanation(ordered, float(part[-1]), parameters, noisy, tuple(used), quiet, text)


def rms(values: Array) -> float:
    """Root mean square of the samples that are there."""
    known = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(known**2))) if known.size else 0.0


def without(slope: Array, values: Array) -> Array:
    """The part of columns that is orthogonal to the columns of `slope`."""
    length = np.linalg.norm(slope, axis=0)
    q, s, _ = np.linalg.svd(slope[:, length > 0] / length[length > 0], full_matrices=False)
    q = q[:, s > 1e-6 * s[0]] if s.size else q  # directions that only rounding tells apart
    rest: Array = values - q @ (q.T @ values)
    return rest


def explained(d: Array, r: Array) -> Array:
    """Sum of squares that each set of effects explains, c >= 0; bit k of the index: effect k is in it."""
    q, upper = np.linalg.qr(d)
    seen = q.T @ r
    count = d.shape[1]
    found = np.zeros(1 << count)
    for index in range(1, 1 << count):
        chosen = [k for k in range(count) if index >> k & 1]
        found[index] = seen @ seen - nnls(upper[:, chosen], seen)[1] ** 2
    return np.maximum(found, 0.0)


def shapley(explained: Array, count: int) -> list[float]:
    """Mean increase by each effect over all orders of adding them."""
    found = []
    for k in range(count):
        others = [j for j in range(count) if j != k]
        total = 0.0
        for size in range(count):
            weight = factorial(size) * factorial(count - size - 1) / factorial(count)
            for chosen in combinations(others, size):
                index = sum(1 << j for j in chosen)
                total += weight * float(explained[index | 1 << k] - explained[index])
        found.append(total)
    return found


def coefficient(d: Array, r: Array, lags: int) -> tuple[float, float, float]:
    """Strength of an effect alone with its 95 % interval; errors depend on their neighbours [Newey, West]."""
    if not d.any():
        return 0.0, 0.0, 0.0
    fit = sm.OLS(r, d[:, None]).fit(cov_type="HAC", cov_kwds={"maxlags": max(1, lags)})
    low, high = fit.conf_int(alpha=0.05)[0]
    return float(fit.params[0]), float(low), float(high)


def by_signal(d: Array, r: Array, rows: Mapping[str, slice]) -> dict[str, float]:
    """Share of each signal's residual that the effect takes at the one strength that fits all signals."""
    strength = max(0.0, float(d @ r) / float(d @ d)) if d.any() else 0.0
    found = {}
    for name, where in rows.items():
        whole = float(r[where] @ r[where])
        left = r[where] - strength * d[where]
        found[name] = 1 - float(left @ left) / whole if whole else 0.0
    return found


def nothing(small: bool) -> str:
    """No signal has a residual worth an explanation; `small`: some are just small, not within the noise."""
    to = f" or to {100 * SMALL:g} % of its range" if small else ""
    return (
        f"Nothing is left to explain: each signal is predicted to the noise of its sensor{to}, "
        "so the residual shows no effect."
    )


def verdict(found: Sequence[EffectShare], together: float, parameters: float, noise: float) -> str:
    """The explanation in whole sentences; shares as in `Explanation`, largest alone first."""
    first = found[0]
    if first.alone < LEAST:
        text = (
            f"None of the effects below explains what the prediction misses: the largest share is "
            f"{_percent(first.alone)} ({first.effect}), all of them together explain {_percent(together)}."
        )
    else:
        text = (
            f"The residual shows one effect most: {first.effect}, {_percent(first.alone)} of it, "
            f"{first.coefficient:.2g} times as strong as in the variant. "
            f"All effects together explain {_percent(together)}."
        )
        close = [s.effect for s in found[1:] if s.alone >= CLOSE * first.alone]
        if close:
            text += f" The data hardly distinguish it from {' and '.join(close)}."
    left = 1 - together - parameters - noise
    if parameters > LEAST / 2:
        text += (
            f" {_percent(parameters)} would go if the identified parameters had slightly other values: that "
            "part is their uncertainty, or an effect that looks like it."
        )
    if noise > LEAST / 2:
        text += f" {_percent(noise)} is noise of the sensors."
    if left > LEAST / 2:
        text += f" The other {_percent(left)} has a cause that is not in the list."
    return text


def _percent(share: float) -> str:
    return f"{100 * share:.0f} %"
