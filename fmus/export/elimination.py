"""The linear systems of the solver, written out for one Jacobian J: no loops, no zeros.

    (diagonal I - J) k = b

Gaussian elimination with pivots on the diagonal, in an order chosen when the code is generated, so that few
entries are filled in (Markowitz). No rows are exchanged while the model runs. That is accurate unless a
diagonal entry, before or after the elimination, is small compared with what was subtracted from it; `trust`
shows that. It looks at each entry by itself: what several that are only rather small lose together it does
not see, and leaves to the error estimate of the step. The diagonal is one over the step: a solver that
shortens the step where there is no trust gets on.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import casadi as ca

Place = tuple[int, int]  # row and column

# Of the sixteen digits of a diagonal entry at least eight survive its elimination: more than tolerances need.
SMALLEST = 1e-8


@dataclass(frozen=True)
class Elimination:
    """Columns of symbols, and of expressions of them.

    entries   the entries of J that are not constant, by rows
    factors   of the symbols `diagonal` and `jac`, which stand for the diagonal and the entries
    trust     of the same: 1 where the factors are accurate, else 0
    k         the solution, of the symbols `lu`, which stand for the factors, and b
    """

    entries: ca.SX
    diagonal: ca.SX
    jac: ca.SX
    factors: ca.SX
    trust: ca.SX
    lu: ca.SX
    b: ca.SX
    k: ca.SX


def eliminate(jacobian: ca.SX) -> Elimination:
    """The elimination for a square Jacobian; what is constant in it becomes a constant in the code."""
    n = jacobian.shape[0]
    values = nonzeros(jacobian)
    moving = [place for place, value in values.items() if not value.is_constant()]
    diagonal, jac = ca.SX.sym("diagonal"), ca.SX.sym("jac", len(moving))
    matrix = {(i, i): diagonal for i in range(n)}
    for place, value in (values | dict(zip(moving, _entries(jac), strict=True))).items():
        matrix[place] = matrix.get(place, 0) - value
    pivots = order(n, values)
    trust = _factorise(matrix, pivots)
    kept = [place for place, value in matrix.items() if not value.is_constant()]
    lu, b = ca.SX.sym("lu", len(kept)), ca.SX.sym("b", n)
    factors = matrix | dict(zip(kept, _entries(lu), strict=True))
    return Elimination(
        entries=_column([values[place] for place in moving]),
        diagonal=diagonal,
        jac=jac,
        factors=_column([matrix[place] for place in kept]),
        trust=trust,
        lu=lu,
        b=b,
        k=_column(_solve(factors, pivots, _entries(b))),
    )


def nonzeros(matrix: ca.SX) -> dict[Place, ca.SX]:
    """The structural nonzeros by row and column, row after row."""
    rows, columns = matrix.sparsity().get_triplet()
    found = {(row, column): matrix.nz[i] for i, (row, column) in enumerate(zip(rows, columns, strict=True))}
    return dict(sorted(found.items()))


def order(n: int, places: Collection[Place]) -> list[int]:
    """The order of the pivots of an n x n matrix: next comes where the fewest entries are filled in."""
    filled = {(i, i) for i in range(n)} | set(places)
    left, chosen = set(range(n)), list[int]()
    while left:
        updates = {
            k: [(i, j) for i in left - {k} if (i, k) in filled for j in left - {k} if (k, j) in filled]
            for k in sorted(left)
        }
        best = min(updates, key=lambda k: (len(set(updates[k]) - filled), len(updates[k])))
        filled.update(updates[best])
        left.remove(best)
        chosen.append(best)
    return chosen


def _factorise(m: dict[Place, ca.SX], pivots: Sequence[int]) -> ca.SX:
    """Replaces a matrix by its factors, each pivot by its inverse; returns whether to trust them."""
    first = {k: ca.fabs(m[k, k]) for k in pivots}
    most = dict(first)  # sum of the sizes of all that went into a pivot
    checks = []
    for step, k in enumerate(pivots):
        m[k, k] = 1 / m[k, k]
        checks.append(SMALLEST * most[k] * ca.fabs(m[k, k]) < 1)
        later = pivots[step + 1 :]
        for i in [i for i in later if (i, k) in m]:
            m[i, k] *= m[k, k]
            for j in [j for j in later if (k, j) in m]:
                change = m[i, k] * m[k, j]
                m[i, j] = m.get((i, j), 0) - change
                if i == j:
                    most[i] += ca.fabs(change)
    checks += [SMALLEST * most[k] < first[k] for k in pivots if most[k] is not first[k]]
    return sum(checks, ca.SX(0)) == len(checks)  # a comparison with NaN is false


def _solve(m: Mapping[Place, ca.SX], pivots: Sequence[int], b: Sequence[ca.SX]) -> list[ca.SX]:
    """Forward and back substitution with the factors."""
    k = list(b)
    for step, j in enumerate(pivots):
        for i in [i for i in pivots[step + 1 :] if (i, j) in m]:
            k[i] -= m[i, j] * k[j]
    for step, i in reversed(list(enumerate(pivots))):
        for j in [j for j in pivots[step + 1 :] if (i, j) in m]:
            k[i] -= m[i, j] * k[j]
        k[i] *= m[i, i]
    return k


def _entries(values: ca.SX) -> list[ca.SX]:
    return [values[i] for i in range(values.numel())]


def _column(values: Sequence[ca.SX]) -> ca.SX:
    return ca.vertcat(*values) if values else ca.SX(0, 1)
