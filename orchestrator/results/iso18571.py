"""ISO/TS 18571:2014, objective rating of two curves: four ratings from 0 to 1, and their weighted sum.

For a simulated curve C and a reference T, N samples each at equal steps:

    corridor    Z = mean of ((0.5 - d) / 0.45)^2, d = |C - T| / max |T|; 1 for d < 0.05, 0 for d > 0.5
    phase       E_P = 1 - n / (0.2 N), where a shift by n samples correlates best; at least 80 % must overlap
    magnitude   E_M = 1 - eps / 0.5,   eps = |C* - T*|_1 / |T*|_1 of the shifted curves, warped in time
    slope       E_S = 1 - eps / 2,     eps = |C' - T'|_1 / |T'|_1 of the shifted curves' smoothed derivatives
    overall     R = 0.4 Z + 0.2 (E_P + E_M + E_S)

The standard is made for crash pulses. It compares shapes and has little meaning for constant signals.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from orchestrator.data.table import Array

INNER, OUTER = 0.05, 0.5  # half widths of the corridors, fractions of max |T|
SHIFT = 0.2  # largest shift, fraction of N
WINDOW = 0.1  # largest warping of time, fraction of N
MAGNITUDE, SLOPE = 0.5, 2.0  # errors with rating 0
SMOOTH = 4  # samples on each side in the moving average


class Parts(NamedTuple):
    """The ratings; NaN if a rating is undefined for a constant reference."""

    overall: float
    corridor: float
    phase: float
    magnitude: float
    slope: float


def rate(simulation: Array, reference: Array) -> Parts:
    """Ratings of two curves of shape (n,) each, n at least 2 SMOOTH + 2."""
    shift, c, t = _aligned(simulation, reference)
    corridor = _corridor(simulation, reference)
    phase = max(0.0, 1.0 - shift / (SHIFT * len(reference)))
    magnitude = _score(*_warped(c, t), MAGNITUDE)
    slope = _score(_derivative(c), _derivative(t), SLOPE)
    return Parts(0.4 * corridor + 0.2 * (phase + magnitude + slope), corridor, phase, magnitude, slope)


def _corridor(c: Array, t: Array) -> float:
    magnitude = float(np.max(np.abs(t)))
    rating = (OUTER * magnitude - np.abs(c - t)) / ((OUTER - INNER) * magnitude)
    return float(np.mean(np.clip(rating, 0.0, 1.0) ** 2))


def _aligned(c: Array, t: Array) -> tuple[int, Array, Array]:
    """The smallest shift with the largest correlation [samples], and the overlapping parts of the curves."""
    largest, aligned = _correlation(c, t), (0, c, t)
    for n in range(1, int(SHIFT * len(c)) + 1):
        for a, b in ((c[n:], t[:-n]), (c[:-n], t[n:])):  # the simulation is late, or early
            if (correlation := _correlation(a, b)) > largest:
                largest, aligned = correlation, (n, a, b)
    return aligned


def _correlation(a: Array, b: Array) -> float:
    a, b = a - a.mean(), b - b.mean()
    return float(a @ b / np.sqrt((a @ a) * (b @ b)))


def _score(c: Array, t: Array, worst: float) -> float:
    return max(0.0, 1.0 - float(np.abs(c - t).sum() / np.abs(t).sum()) / worst)


def _derivative(y: Array) -> Array:
    """Central differences per sample, averaged over nine samples; over fewer on each side near the ends."""
    n, i = len(y), np.arange(len(y))
    half = np.minimum(SMOOTH, np.minimum(i, n - 1 - i))
    total = np.concatenate([[0.0], np.cumsum(np.gradient(y))])
    return np.asarray((total[i + half + 1] - total[i - half]) / (2 * half + 1))


def _warped(c: Array, t: Array) -> tuple[Array, Array]:
    """Both curves along the path of least squared distance [dynamic time warping, Sakoe and Chiba 1978].

    cost[i + j, i] is that of the best path to samples i - 1 and j - 1: a row is a diagonal i + j, which
    follows from the two rows before in a few operations on adjacent numbers.
    """
    n = len(c)
    band = int(np.ceil(WINDOW * n)) - 1
    backwards = t[::-1]
    cost = np.empty((2 * n + 1, n + 3))
    cost[:2] = np.inf
    cost[0, 0] = 0.0
    for k in range(2, 2 * n + 1):
        first, last = max(1, k - n, (k - band + 1) // 2), min(n, k - 1, (k + band) // 2)
        cost[k, max(first - 2, 0) : last + 3] = np.inf  # next to the band
        row, before, skipped = cost[k, first : last + 1], cost[k - 1], cost[k - 2]
        np.subtract(c[first - 1 : last], backwards[n - k + first : n - k + last + 1], out=row)
        row *= row
        shorter = np.minimum(before[first - 1 : last], before[first : last + 1])
        row += np.minimum(shorter, skipped[first - 1 : last], out=shorter)
    rows, columns = _path(cost, n)
    return c[rows - 1], t[columns - 1]


def _path(cost: Array, n: int) -> tuple[NDArray[np.int_], NDArray[np.int_]]:
    """Rows i and columns j of the cheapest path from (n, n) to (1, 1); of equal ones the diagonal step."""
    at = cost.item  # as Python numbers, which compare faster
    k, i = 2 * n, n
    path = [(n, n)]
    while k > 2:
        diagonal, up, left = at(k - 2, i - 1), at(k - 1, i - 1), at(k - 1, i)
        if diagonal <= up and diagonal <= left:
            k, i = k - 2, i - 1
        else:
            k, i = k - 1, i - (up <= left)
        path.append((i, k - i))
    rows, columns = np.array(path).T
    return rows, columns
