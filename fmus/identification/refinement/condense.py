"""From linearised segments to a small least-squares problem, and back.

Each segment i of a run, with start state s_i and parameters z, is linearised to

    residuals    r_i + J_i (ds_i, dz)          QR: only R_i (ds_i, dz) + Q_i' r_i matters
    continuity   d_i + X_i ds_i + P_i dz - ds_(i+1) = 0

The recursion writes every ds_i as a function of (ds_0, dz) [condensing: Bock and Plitt 1984]; a second QR per
run eliminates ds_0. What is left has as many rows and columns as there are parameters.
States are counted in their nominal values throughout.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fmus.identification.refinement.factor import Factors, triangular

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Local:
    """One linearised segment.

    factors    of the weighted Jacobian, shape (m, nx + np)
    x_x, x_p   end state with respect to start state and parameters
    """

    factors: Factors
    x_x: Array
    x_p: Array

    def loose(self) -> Local:
        """The same segment, after which the next one starts from somewhere else."""
        return Local(self.factors, 0 * self.x_x, 0 * self.x_p)


@dataclass(frozen=True)
class Condensed:
    """One run condensed: rows [start | parameters | residual] in upper triangular form.

    recursion   per segment, shape (nx, nx + np + 1): ds_i = recursion (ds_0, dz, 1)
    """

    top: Array
    bottom: Array
    recursion: tuple[Array, ...]

    def start(self, dz: Array) -> Array:
        """ds_0 of a step in the parameters."""
        nx = len(self.top)
        rest = self.top[:, nx:-1] @ dz + self.top[:, -1]
        return np.asarray(-np.linalg.solve(self.top[:, :nx], rest)) if nx else rest

    def states(self, dz: Array) -> list[Array]:
        """All ds_i of a step in the parameters."""
        full = np.concatenate([self.start(dz), dz, [1.0]])
        return [rows @ full for rows in self.recursion]


def recursion(locals_: Sequence[Local], defects: Sequence[Array], free: int) -> tuple[Array, ...]:
    """ds_i as a function of (ds_0, dz, 1), per segment."""
    nx = locals_[0].x_x.shape[0]
    rows: Array = np.hstack([np.eye(nx), np.zeros((nx, free + 1))])
    found: list[Array] = [rows]
    for local, defect in zip(locals_[:-1], defects, strict=True):
        rows = local.x_x @ rows
        rows[:, nx:-1] += local.x_p
        rows[:, -1] += defect
        found.append(rows)
    return tuple(found)


def spread(local: Local, rows: Array, projected: Array) -> Array:
    """A segment's rows [start | parameters | residual] of the condensed problem."""
    nx = rows.shape[0]
    full: Array = local.factors.r[:, :nx] @ rows
    full[:, nx:-1] += local.factors.r[:, nx:]
    full[:, -1] += projected
    return full


def condense(
    locals_: Sequence[Local], defects: Sequence[Array], projected: Sequence[Array], prior: Array
) -> Condensed:
    """Condense one run.

    defects     d_i, one fewer than segments
    projected   Q_i' r_i
    prior       rows [start | parameters | residual] of what is known about the start state
    """
    free = prior.shape[1] - 1 - locals_[0].x_x.shape[0]
    nx = prior.shape[1] - 1 - free
    chain = recursion(locals_, defects, free)
    blocks = [spread(a, rows, c) for a, rows, c in zip(locals_, chain, projected, strict=True)]
    triangle = triangular(np.vstack([prior, *blocks]))
    return Condensed(triangle[:nx], triangle[nx:, nx:], chain)
