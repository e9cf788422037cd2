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
    """Both curves along the path of least squared distance [dynamic time warping, Sakoe and Chiba 1978]."""
    n = len(c)
    band = int(np.ceil(WINDOW * n)) - 1
    cost = np.full((n + 1, n + 1), np.inf)  # cost[i, j] of the best path to samples i - 1 and j - 1
    cost[0, 0] = 0.0
    for k in range(2, 2 * n + 1):  # all cells with i + j = k follow from cells before
        i = np.arange(max(1, k - n, (k - band + 1) // 2), min(n, k - 1, (k + band) // 2) + 1)
        j = k - i
        cheapest = np.minimum(np.minimum(cost[i - 1, j], cost[i, j - 1]), cost[i - 1, j - 1])
        cost[i, j] = cheapest + (c[i - 1] - t[j - 1]) ** 2
    path = [(n, n)]
    while path[-1] != (1, 1):
        row, column = path[-1]
        predecessors = ((row - 1, column - 1), (row - 1, column), (row, column - 1))
        path.append(min(predecessors, key=lambda cell: cost[cell]))
    rows, columns = np.array(path).T - 1
    return c[rows], t[columns]
