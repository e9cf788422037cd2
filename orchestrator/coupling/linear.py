"""Small systems of linear equations; C has the same, operation by operation."""

from __future__ import annotations

from collections.abc import Sequence
from math import inf
from typing import Any

import numpy as np
from numpy.typing import NDArray

Matrix = list[list[float]]


def factorised(a: Matrix, rows: list[int]) -> bool:
    """Put the triangular factors in the place of `a`, and the exchanges of rows into `rows`.

    Gaussian elimination; the pivot is the largest element of its column. False where there is none.
    """
    n = len(a)
    for k in range(n):
        best = k
        for i in range(k + 1, n):
            if abs(a[i][k]) > abs(a[best][k]):
                best = i
        rows[k] = best
        a[k], a[best] = a[best], a[k]
        if a[k][k] == 0.0 or not abs(a[k][k]) < inf:
            return False
        for i in range(k + 1, n):
            a[i][k] /= a[k][k]
            for j in range(k + 1, n):
                a[i][j] -= a[i][k] * a[k][j]
    return True


def solve(a: Matrix, rows: Sequence[int], b: list[float]) -> None:
    """Put the solution into `b`; `a` and `rows` as `factorised` left them."""
    n = len(b)
    for k in range(n):
        b[k], b[rows[k]] = b[rows[k]], b[k]
    for k in range(n):
        for i in range(k + 1, n):
            b[i] -= a[i][k] * b[k]
    for k in reversed(range(n)):
        for j in range(k + 1, n):
            b[k] -= a[k][j] * b[j]
        b[k] /= a[k][k]


def inverted(a: NDArray[Any], rows: NDArray[np.int32]) -> bool:
    """Put the inverse of `a`, shape (n, n), in its place, by the method of Gauss and Jordan.

    The pivot is the largest element of its column; `rows` notes the exchanges. False where there is none.
    """
    n = len(a)
    for k in range(n):
        best = k
        column = a[:, k].tolist()
        for i in range(k + 1, n):
            if abs(column[i]) > abs(column[best]):
                best = i
        rows[k] = best
        if best != k:
            a[[k, best]] = a[[best, k]]
        pivot = float(a[k, k])
        if pivot == 0.0 or not abs(pivot) < inf:
            return False
        a[k, k] = 1.0
        a[k] /= pivot
        for i, factor in enumerate(a[:, k].tolist()):
            if i != k and factor != 0.0:
                a[i, k] = 0.0
                a[i] -= a[k] * factor
    for k in reversed(range(n)):
        if rows[k] != k:
            a[:, [k, rows[k]]] = a[:, [rows[k], k]]
    return True
