"""Forward sensitivities of the solver's steps as C functions, derived symbolically.

A step of the solver is (export/native/rosenbrock.c)

    M k_i = f(X_i) + sum_j c_ij / h k_j + g_i h f_u du,    M = I / (gamma h) - J(x),  X_i = x + sum_j a_ij k_j

The sensitivity with respect to an initial state or a parameter q, at fixed step size h, follows from

    M dk_i = J(X_i) dX_i + f_q(X_i) dq + sum_j c_ij / h dk_j + D,
    D = directional derivative of [J(x) k_i + g_i h f_u(x) du] along (dx, dq)

The solver has factorised M for the step itself; the LU factors are reused for all sensitivity columns.
D needs second derivatives of f. They are constant over the step (evaluated at x) and are contracted with
(k_i, g_i h du) in each stage.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import casadi as ca

from fmus.called_functions import without_zero_calls
from fmus.contract import Symbolic, column
from fmus.export.c_functions import Routine, hoist
from fmus.export.elimination import Elimination, Entry, eliminate, nonzeros
from fmus.identification.refinement.model_reduction import ReducedModel

Entries = Mapping[Entry, ca.SX]  # structural nonzeros of a matrix


@dataclass(frozen=True)
class SensitivityCode:
    """C functions, the lengths of the vectors between them, and sparsity patterns as (row, column)."""

    routines: Sequence[Routine]
    lengths: Mapping[str, int]
    patterns: Mapping[str, Sequence[Entry]]


def sensitivity_code(model: ReducedModel) -> SensitivityCode:
    """All functions that native/sensitivities.c calls in addition to those of an FMU."""
    eqs, q = model.equations, column(*(model.q[i] for i in model.dynamic))
    x, u, p, y = eqs.x, eqs.u, eqs.p, eqs.y
    jacobian = without_zero_calls(ca.jacobian(eqs.dx, x))
    system = eliminate(jacobian)
    k, h_du = ca.SX.sym("k", x.numel()), ca.SX.sym("h_du", u.numel())
    hessian, hessian_symbols, product_x, product_q = _second_derivatives(eqs, jacobian, q, column(k, h_du))
    f_q = nonzeros(ca.jacobian(eqs.dx, q))
    for entry, value in product_q.items():
        f_q[entry] = f_q[entry] + value if entry in f_q else value
    y_x, y_q = nonzeros(ca.jacobian(y, x)), nonzeros(ca.jacobian(y, q))
    values = {
        "hessian": hessian,
        "jac": system.entries,
        "f_q": column(*f_q.values()),
        "y": y,
        "y_x": column(*y_x.values()),
        "y_q": column(*y_q.values()),
    }
    values, d, prepared = hoist({name: ca.densify(value) for name, value in values.items()}, p)
    arguments = {"x": x, "u": u, "p": p, "d": d}
    stage = {"jac": values["jac"], "product": column(*product_x.values()), "f_q": values["f_q"]}
    return SensitivityCode(
        routines=[
            Routine("sens_prepare", {"p": p}, {"d": prepared}),
            Routine("sens_hessian", arguments, {"hessian": values["hessian"]}),
            Routine("sens_stage", arguments | {"hessian": hessian_symbols, "k": k, "h_du": h_du}, stage),
            Routine("sens_outputs", arguments, {"y": values["y"]}),
            Routine("sens_output_jacobians", arguments, {"y_x": values["y_x"], "y_q": values["y_q"]}),
            _stage_columns(system, nonzeros(jacobian), list(product_x)),
            _output_columns(y.numel(), x.numel(), list(y_x)),
        ],
        lengths={
            "NQ": q.numel(),
            "NOUT": y.numel(),
            "ND": d.numel(),
            "NHESSIAN": hessian.numel(),
            "NPRODUCT": len(product_x),
            "NF_Q": len(f_q),
            "NY_X": len(y_x),
            "NY_Q": len(y_q),
        },
        patterns={"F_Q": list(f_q), "Y_Q": list(y_q)},
    )


def _second_derivatives(
    eqs: Symbolic, jacobian: ca.SX, q: ca.SX, directions: ca.SX
) -> tuple[ca.SX, ca.SX, Entries, Entries]:
    """The second derivatives of f that are not structurally zero, symbols for them, and two products.

    The products are those of the second derivatives by x and by q with the directions (k, h du).
    """
    by_u = without_zero_calls(ca.jacobian(eqs.dx, eqs.u))
    first = ca.mtimes(ca.horzcat(jacobian, by_u), directions)
    by_x, by_q = (nonzeros(without_zero_calls(ca.jacobian(first, v))) for v in (eqs.x, q))
    hessian = ca.jacobian(column(*by_x.values(), *by_q.values()), directions)
    # linear in the directions, which CasADi does not see in the calls of functions
    hessian = without_zero_calls(ca.substitute(hessian, directions, ca.SX.zeros(directions.numel())))
    symbols = ca.SX.sym("hessian", hessian.nnz())
    products = ca.mtimes(ca.SX(hessian.sparsity(), symbols), directions)
    product_x = {entry: products[i] for i, entry in enumerate(by_x)}
    product_q = {entry: products[i] for i, entry in enumerate(by_q, len(by_x))}
    return column(*hessian.nonzeros()), symbols, product_x, product_q


def _stage_columns(system: Elimination, jacobian: Entries, product: Sequence[Entry]) -> Routine:
    """dk = M^-1 (J dX + H dx + r) with the factors of M; H holds the products of the second derivatives."""
    n = system.b.numel()
    dX, dx, r = (ca.SX.sym(name, n) for name in ("dX", "dx", "r"))
    symbols = ca.SX.sym("product", len(product))
    variable_entries = iter(ca.vertsplit(system.jac))
    J = [value if value.is_constant() else next(variable_entries) for value in jacobian.values()]
    b = r + ca.mtimes(_sparse(jacobian, J, n, n), dX) + ca.mtimes(_sparse(product, [symbols], n, n), dx)
    inputs = {"jac": system.jac, "product": symbols, "lu": system.lu, "dX": dX, "dx": dx, "r": r}
    dk = ca.substitute(system.k, system.b, b)
    return Routine("sens_stage_columns", inputs, {"dk": dk}, frozenset({"dX", "dx", "r", "dk"}))


def _output_columns(outputs: int, states: int, y_x: Sequence[Entry]) -> Routine:
    """dy = y_x dx: contribution of the state sensitivities to the output sensitivities."""
    dx, symbols = ca.SX.sym("dx", states), ca.SX.sym("y_x", len(y_x))
    dy = ca.densify(ca.mtimes(_sparse(y_x, [symbols], outputs, states), dx))
    return Routine("sens_output_columns", {"y_x": symbols, "dx": dx}, {"dy": dy}, frozenset({"dx", "dy"}))


def _sparse(entries: Iterable[Entry], values: Sequence[ca.SX], rows: int, columns: int) -> ca.SX:
    """Sparse matrix from the values of its entries."""
    pairs = list(entries)
    return ca.SX.triplet([i for i, _ in pairs], [j for _, j in pairs], column(*values), rows, columns)
