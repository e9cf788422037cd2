"""QR factors of a tall matrix, in small blocks.

Small blocks stay in one thread of the linear algebra library; segments have threads of their own already,
and the two would wait for each other.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_TIMES = 3  # rows of a block over columns: each level of the tree has a third of the rows of that before


@dataclass(frozen=True)
class Factors:
    """Q as a tree of block factors, each of shape (blocks, rows, k), and R, shape (k, columns)."""

    levels: tuple[Array, ...]
    r: Array

    def project(self, vector: Array) -> Array:
        """Q' v, shape (k,)."""
        for q in self.levels:
            padded = np.zeros(q.shape[0] * q.shape[1])
            padded[: len(vector)] = vector
            vector = np.matmul(padded.reshape(q.shape[0], 1, q.shape[1]), q).ravel()
        return vector


def factors(rows: Array) -> Factors:
    """QR factors of `rows`, shape (m, columns)."""
    columns = rows.shape[1]
    height = max(1, _TIMES * columns)
    levels: list[Array] = []
    while True:
        blocks = max(1, -(-len(rows) // height))
        tall = len(rows) if blocks == 1 else height
        padded = np.zeros((blocks * tall, columns))
        padded[: len(rows)] = rows
        q, r = np.linalg.qr(padded.reshape(blocks, tall, columns))
        levels.append(q)
        rows = r.reshape(-1, columns)
        if blocks == 1:
            return Factors(tuple(levels), rows)


def triangular(rows: Array) -> Array:
    """R alone: the same least-squares problem in as few rows as possible."""
    columns = rows.shape[1]
    height = max(1, _TIMES * columns)
    while len(rows) > height:
        blocks = -(-len(rows) // height)
        padded = np.zeros((blocks * height, columns))
        padded[: len(rows)] = rows
        rows = np.asarray(np.linalg.qr(padded.reshape(blocks, height, columns), mode="r"))
        rows = rows.reshape(-1, columns)
    return np.asarray(np.linalg.qr(rows, mode="r"))
