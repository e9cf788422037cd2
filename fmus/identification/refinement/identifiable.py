"""Names of what the data cannot tell: single parameters, and those of which only a combination shows."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fmus.identification.refinement.problem import Free
from fmus.identification.refinement.statistics import VAGUE

Array = NDArray[np.float64]

LIMIT = 0.5  # of z: a combination with a larger standard deviation is not determined by the data
_TAKES_PART = 0.05  # share of a parameter in such a combination, and bond between two, that count


def unidentified(free: tuple[Free, ...], data: Array, limit: float = LIMIT) -> tuple[str, ...]:
    """One sentence per group of parameters that the data leave open.

    data   covariance of z by the data alone, shape (np, np)
    """
    variances, vectors = np.linalg.eigh(data)
    open_ = vectors[:, variances > limit**2]
    bond = open_ @ open_.T  # projector on what is open: its blocks are the groups
    return tuple(
        _sentence([free[j] for j in group], bond[np.ix_(group, group)], data[np.ix_(group, group)])
        for group in _groups(bond)
    )


def _groups(bond: Array) -> list[list[int]]:
    """Parameters that hang together."""
    left = [j for j in range(len(bond)) if bond[j, j] > _TAKES_PART]
    groups = []
    while left:
        group, new = [left[0]], [left[0]]
        while new:
            j = new.pop()
            more = [i for i in left if i not in group and abs(bond[i, j]) > _TAKES_PART]
            group, new = group + more, new + more
        left = [j for j in left if j not in group]
        groups.append(sorted(group))
    return groups


def _sentence(group: list[Free], bond: Array, data: Array) -> str:
    names = [f.name for f in group]
    dimension = round(float(np.trace(bond)))
    if len(names) == 1:
        sd = float(np.sqrt(data[0, 0]))
        told = "do not show it" if sd > 0.5 * VAGUE else f"leave it open by {100 * sd:.0f} %"
        if group[0].sd is not None:
            return (
                f"{names[0]}: these recordings alone {told}; its interval is that of what was known before, "
                "such as from the bench"
            )
        return f"{names[0]}: the data {told}"
    listed = ", ".join(names[:-1]) + f" and {names[-1]}"
    if len(names) == 2 and dimension == 1 and all(f.log for f in group):
        return f"{listed}: the data show only {_together(names, bond)}, not each"
    return f"{listed}: the data show {len(names) - dimension} of {len(names)} combinations"


def _together(names: list[str], bond: Array) -> str:
    """What stays the same along the open direction (a, b) of two logarithms: z_1 - a / b z_2."""
    exponent = float(bond[0, 1] / bond[1, 1])
    power = "" if abs(abs(exponent) - 1) < 0.05 else f"^{abs(exponent):.2g}"
    return f"{names[0]} {'/' if exponent > 0 else '*'} {names[1]}{power}"
