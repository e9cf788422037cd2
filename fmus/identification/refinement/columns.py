"""C functions that take many columns of derivatives through a stage of the solver at once."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import casadi as ca

from fmus.contract import column
from fmus.export.elimination import Elimination, Place
from fmus.export.emit import Routine

WIDTH = 8  # columns at once: a cache line, one to four registers of the processors of today


def stage_columns(
    system: Elimination, jacobian: Mapping[Place, ca.SX], bent_places: Sequence[Place]
) -> Routine:
    """k = M^-1 (J at + bent from + r), with the factors of M."""
    n = system.b.numel()
    at, start, r = (ca.SX.sym(name, n) for name in ("at", "from", "r"))
    bent = ca.SX.sym("bent", len(bent_places))
    moving = iter(range(system.jac.numel()))
    factors = {
        place: value if value.is_constant() else system.jac[next(moving)] for place, value in jacobian.items()
    }
    b = r + _times(n, factors, at) + _times(n, _numbered(bent_places, bent), start)
    k = ca.substitute(system.k, system.b, b)
    inputs = {"jac": system.jac, "bent": bent, "lu": system.lu, "at": at, "from": start, "r": r}
    return Routine("columns_stage", inputs, {"k": k}, frozenset({"at", "from", "r", "k"}))


def observe_columns(outputs: int, states: int, places: Sequence[Place]) -> Routine:
    """out = y_x s: what the states add to the derivatives of the outputs."""
    s, y_x = ca.SX.sym("s", states), ca.SX.sym("y_x", len(places))
    out = _times(outputs, _numbered(places, y_x), s)
    return Routine("columns_observe", {"y_x": y_x, "s": s}, {"out": out}, frozenset({"s", "out"}))


def _numbered(places: Sequence[Place], values: ca.SX) -> dict[Place, ca.SX]:
    return {place: values[i] for i, place in enumerate(places)}


def _times(rows: int, matrix: Mapping[Place, ca.SX], x: ca.SX) -> ca.SX:
    """Sparse matrix times column, shape (rows, 1)."""
    result = [ca.SX(0)] * rows
    for (i, j), value in matrix.items():
        result[i] += value * x[j]
    product: ca.SX = column(*result)
    return product
