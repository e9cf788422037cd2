"""The derivatives of a step of the solver, as C functions.

A step is (export/native/rosenbrock.c)

    M k_i = f(X_i) + sum_j c_ij / h k_j + g_i h f_u du,    M = I / (gamma h) - J(x),  X_i = x + sum_j a_ij k_j

so a derivative by a start value or a parameter q, with the size h of the step as it is, follows from

    M dk_i = J(X_i) dX_i + f_q(X_i) dq + sum_j c_ij / h dk_j + d/d(x, q) [J(x) k_i + g_i h f_u(x) du] (dx, dq)

M is factorised for the step itself, and these factors serve all columns. The last term needs second
derivatives of f: they do not change over a step, in which they are only multiplied by (k_i, g_i h du).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import casadi as ca

from fmus.contract import column
from fmus.export.elimination import Place, eliminate, nonzeros
from fmus.export.emit import Routine
from fmus.export.equations import hoist
from fmus.identification.refinement.columns import observe_columns, stage_columns
from fmus.identification.refinement.reduced import Reduced


@dataclass(frozen=True)
class Derivatives:
    """C functions, the lengths of the vectors between them, and where sparse values belong (row, column)."""

    routines: Sequence[Routine]
    lengths: Mapping[str, int]
    places: Mapping[str, Sequence[Place]]


def derivatives(model: Reduced) -> Derivatives:
    """All functions that native/sensitivities.c calls beside those of an FMU."""
    x, u, p, q = model.x, model.u, model.p, column(*(model.q[i] for i in model.acting))
    jacobian = ca.jacobian(model.dx, x)
    system, entries = eliminate(jacobian), nonzeros(jacobian)
    k, h_du = ca.SX.sym("k", x.numel()), ca.SX.sym("h_du", u.numel())
    second, bends, bent_x, bent_q = _second(model, jacobian, q, column(k, h_du))
    direct = _sum(nonzeros(ca.jacobian(model.dx, q)), bent_q)
    y_x, y_q = nonzeros(ca.jacobian(model.y, x)), nonzeros(ca.jacobian(model.y, q))
    wanted = {
        "bends": second,
        "jac": system.entries,
        "direct": column(*direct.values()),
        "y": model.y,
        "y_x": column(*y_x.values()),
        "y_q": column(*y_q.values()),
    }
    values, d, prepared = hoist({name: ca.densify(value) for name, value in wanted.items()}, p)
    known = {"x": x, "u": u, "p": p, "d": d}
    stage = {"jac": values["jac"], "bent": column(*bent_x.values()), "direct": values["direct"]}
    return Derivatives(
        routines=[
            Routine("slopes_prepare", {"p": p}, {"d": prepared}),
            Routine("slopes_bends", known, {"bends": values["bends"]}),
            Routine("slopes_stage", known | {"bends": bends, "k": k, "h_du": h_du}, stage),
            Routine("slopes_observe", known, {"y": values["y"]}),
            Routine("slopes_observed", known, {"y_x": values["y_x"], "y_q": values["y_q"]}),
            stage_columns(system, entries, list(bent_x)),
            observe_columns(model.y.numel(), x.numel(), list(y_x)),
        ],
        lengths={
            "NQ": q.numel(),
            "NOUT": model.y.numel(),
            "ND": d.numel(),
            "NBENDS": bends.numel(),
            "NBENT": len(bent_x),
            "NDIRECT": len(direct),
            "NYX": len(y_x),
            "NYQ": len(y_q),
        },
        places={"DIRECT": list(direct), "OBSERVED": list(y_q)},
    )


def _second(
    model: Reduced, jacobian: ca.SX, q: ca.SX, directions: ca.SX
) -> tuple[ca.SX, ca.SX, dict[Place, ca.SX], dict[Place, ca.SX]]:
    """The second derivatives that count, symbols for them, and their products with the directions (k, h du).

    The products belong to x and to q, row and column as in the first derivatives.
    """
    first = ca.mtimes(ca.horzcat(jacobian, ca.jacobian(model.dx, model.u)), directions)
    by_x, by_q = nonzeros(ca.jacobian(first, model.x)), nonzeros(ca.jacobian(first, q))
    tensor = ca.jacobian(column(*by_x.values(), *by_q.values()), directions)
    bends = ca.SX.sym("bends", tensor.nnz())
    products = ca.mtimes(ca.SX(tensor.sparsity(), bends), directions)
    parts = [products[i] for i in range(len(by_x) + len(by_q))]
    return (
        column(*tensor.nonzeros()),
        bends,
        dict(zip(by_x, parts[: len(by_x)], strict=True)),
        dict(zip(by_q, parts[len(by_x) :], strict=True)),
    )


def _sum(first: Mapping[Place, ca.SX], second: Mapping[Place, ca.SX]) -> dict[Place, ca.SX]:
    """The sum of two sparse matrices."""
    total = dict(first)
    for place, value in second.items():
        total[place] = total[place] + value if place in total else value
    return total
