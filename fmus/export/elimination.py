"""Gaussian elimination in symbols, for the linear systems of the implicit solver: no loops, no zeros.

    (diagonal I - J) k = b

J is the Jacobian of the model, `diagonal` is 1 / (gamma h) for a step of size h. The pivots are on the
diagonal; their order is chosen when the code is generated, so that few entries are filled in (Markowitz). No
rows are exchanged while the model runs. The factors are accurate unless a diagonal entry, before or after the
elimination, is small compared with what was subtracted from it. Then `accurate` is 0, and the solver shortens
the step, which makes the diagonal larger. Each entry is checked separately. The check misses an error that
several moderately small entries cause together; the error estimate of the step detects that.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import casadi as ca

from fmus.contract import column

Entry = tuple[int, int]  # row and column

# smallest ratio of a diagonal entry to the terms of its sum: 8 of 16 digits remain, enough for tolerances
SMALLEST_RATIO = 1e-8


@dataclass(frozen=True)
class Elimination:
    """The elimination of a matrix as columns of symbols, and of expressions in these symbols.

    places     rows and columns of the entries of J that are not constant, row by row
    entries    these entries
    factors    expressions in the symbols `diagonal` and `jac`, which represent the diagonal and `entries`
    accurate   expression in the same symbols: 1 if the factors are accurate, else 0
    k          the solution, expressions in the symbols `lu`, which represent the factors, and b
    """

    places: Sequence[Entry]
    entries: ca.SX
    diagonal: ca.SX
    jac: ca.SX
    factors: ca.SX
    accurate: ca.SX
    lu: ca.SX
    b: ca.SX
    k: ca.SX


def eliminate(jacobian: ca.SX) -> Elimination:
    """The elimination for a square Jacobian; its constant entries become constants of the code."""
    n = jacobian.shape[0]
    values = nonzeros(jacobian)
    variable = [entry for entry, value in values.items() if not value.is_constant()]
    diagonal, jac = ca.SX.sym("diagonal"), ca.SX.sym("jac", len(variable))
    matrix = {(i, i): diagonal for i in range(n)}
    for entry, value in (values | dict(zip(variable, ca.vertsplit(jac), strict=True))).items():
        matrix[entry] = matrix.get(entry, 0) - value
    pivots = pivot_order(n, values)
    accurate = _factorise(matrix, pivots)
    stored = [entry for entry, value in matrix.items() if not value.is_constant()]
    lu, b = ca.SX.sym("lu", len(stored)), ca.SX.sym("b", n)
    factors = matrix | dict(zip(stored, ca.vertsplit(lu), strict=True))
    return Elimination(
        places=variable,
        entries=column(*(values[entry] for entry in variable)),
        diagonal=diagonal,
        jac=jac,
        factors=column(*(matrix[entry] for entry in stored)),
        accurate=accurate,
        lu=lu,
        b=b,
        k=column(*_solve(factors, pivots, ca.vertsplit(b))),
    )


def nonzeros(matrix: ca.SX) -> dict[Entry, ca.SX]:
    """The structural nonzeros by row and column, row after row."""
    rows, columns = matrix.sparsity().get_triplet()
    values = {(i, j): matrix.nz[k] for k, (i, j) in enumerate(zip(rows, columns, strict=True))}
    return dict(sorted(values.items()))


def pivot_order(n: int, entries: Collection[Entry]) -> list[int]:
    """The order of the pivots of an n x n matrix: the next pivot is the one with the least fill-in."""
    right, below = ([set[int]() for _ in range(n)] for _ in range(2))  # of the diagonal: columns, rows
    for i, j in entries:
        if i != j:
            right[i].add(j)
            below[j].add(i)
    remaining, pivots = list(range(n)), list[int]()

    def fill_in(k: int) -> tuple[int, int]:
        return sum(len(right[k] - right[i] - {i}) for i in below[k]), len(below[k]) * len(right[k])

    while remaining:
        best = min(remaining, key=fill_in)
        for i in below[best]:
            right[i] |= right[best] - {i}
            right[i].remove(best)
        for j in right[best]:
            below[j] |= below[best] - {j}
            below[j].remove(best)
        remaining.remove(best)
        pivots.append(best)
    return pivots


def _factorise(m: dict[Entry, ca.SX], pivots: Sequence[int]) -> ca.SX:
    """Replaces a matrix by its factors, each pivot by its inverse; returns whether they are accurate."""
    initial = {k: ca.fabs(m[k, k]) for k in pivots}
    total = dict(initial)  # sum of the magnitudes of all terms of a pivot
    checks = []
    for step, k in enumerate(pivots):
        m[k, k] = 1 / m[k, k]
        checks.append(SMALLEST_RATIO * total[k] * ca.fabs(m[k, k]) < 1)
        later = pivots[step + 1 :]
        for i in [i for i in later if (i, k) in m]:
            m[i, k] *= m[k, k]
            for j in [j for j in later if (k, j) in m]:
                change = m[i, k] * m[k, j]
                m[i, j] = m.get((i, j), 0) - change
                if i == j:
                    total[i] += ca.fabs(change)
    checks += [SMALLEST_RATIO * total[k] < initial[k] for k in pivots if total[k] is not initial[k]]
    return sum(checks, ca.SX(0)) == len(checks)  # a comparison with NaN is false


def _solve(m: Mapping[Entry, ca.SX], pivots: Sequence[int], b: Sequence[ca.SX]) -> list[ca.SX]:
    """The solution by forward and back substitution with the factors."""
    k = list(b)
    for step, j in enumerate(pivots):
        for i in [i for i in pivots[step + 1 :] if (i, j) in m]:
            k[i] -= m[i, j] * k[j]
    for step, i in reversed(list(enumerate(pivots))):
        for j in [j for j in pivots[step + 1 :] if (i, j) in m]:
            k[i] -= m[i, j] * k[j]
        k[i] *= m[i, i]
    return k
