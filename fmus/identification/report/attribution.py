"""Which effect a residual shows.

The residual r(t) = measured - predicted of all signals, each over its own root mean square, is regressed on
what each effect would change, d_k(t) of `effects`:

    r = sum_k c_k d_k + sum_j b_j dy/dp_j + e        c_k >= 0

The identified parameters p_j may take what they can: a fit without the effect has bent them to cover for it.
c_k = 1 means an effect as strong as the numbers of the variant say. A share is that of the residual's sum of
squares. Alone: only effect k is there. Together: the mean over all orders in which effects can be added
[Shapley value; Lindeman, Merenda and Gold 1980], so that the shares add up to what all of them explain.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from fmus.identification.report import shares, stacked
from fmus.identification.report.prediction import Signals
from fmus.identification.report.verdict import LEAST, nothing, verdict

ABOVE_NOISE = 1.5  # times the sensor's noise: a residual below shows nothing
MEMORY = 0.5  # s: over which neighbouring samples of a residual are taken to depend on each other


@dataclass(frozen=True)
class Share:
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

    shares: tuple[Share, ...]
    together: float
    parameters: float
    noise: float
    signals: tuple[str, ...]
    quiet: tuple[str, ...]
    verdict: str

    @property
    def named(self) -> str:
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
    size = {name: stacked.rms(values) for name, values in residual.items()}
    used = [n for n in residual if size[n] > max(ABOVE_NOISE * noise.get(n, 0.0), small.get(n, 0.0))]
    quiet = tuple(n for n in residual if n not in used)
    if not used:
        only_small = any(size[n] > ABOVE_NOISE * noise.get(n, 0.0) for n in residual)
        return Explanation((), 0.0, 0.0, 1.0, (), quiet, nothing(only_small))
    r = stacked.stack({n: residual[n] for n in used}, residual, size, used)
    d = np.column_stack([stacked.stack(change, residual, size, used) for change in effects.values()])
    whole = float(r @ r)
    rows = stacked.rows(residual, used)
    if absorbed:
        slope = np.column_stack([stacked.stack(change, residual, size, used) for change in absorbed.values()])
        r, d = shares.without(slope, r), shares.without(slope, d)
    parameters = 1 - float(r @ r) / whole
    part = shares.explained(d, r) / whole
    alone = [float(part[1 << k]) for k in range(len(effects))]
    joint = shares.shapley(part, len(effects))
    fits = [shares.coefficient(d[:, k], r, round(MEMORY / step)) for k in range(len(effects))]
    found = tuple(
        Share(name, alone[k], joint[k], *fits[k], shares.by_signal(d[:, k], r, rows))
        for k, name in enumerate(effects)
    )
    ordered = tuple(sorted(found, key=lambda s: -s.alone))
    noisy = float(np.mean([min(1.0, (noise.get(n, 0.0) / size[n]) ** 2) for n in used]))
    told = verdict(ordered, float(part[-1]), parameters, noisy)
    return Explanation(ordered, float(part[-1]), parameters, noisy, tuple(used), quiet, told)
