"""Which part of a residual r the columns of d explain: sums of squares, alone and together.

r has shape (n,), d shape (n, m): a column for each effect.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import combinations
from math import factorial

import numpy as np
import statsmodels.api as sm
from numpy.typing import NDArray
from scipy.optimize import nnls

Array = NDArray[np.float64]


def without(slope: Array, values: Array) -> Array:
    """What is left of columns beside the columns of `slope`."""
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
