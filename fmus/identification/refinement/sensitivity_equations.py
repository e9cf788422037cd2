"""Forward sensitivities of the solver's steps as C functions, derived symbolically, of a reduced model.

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
from dataclasses import dataclass, replace

import casadi as ca

from fmus.called_functions import without_zero_calls
from fmus.contract import Quantity, Subsystem, Symbolic, column, quantities, symbolic
from fmus.export.c_functions import Routine, hoist
from fmus.export.elimination import Elimination, Entry, eliminate, nonzeros
from orchestrator.base.errors import Problem

Entries = Mapping[Entry, ca.SX]  # structural nonzeros of a matrix


@dataclass(frozen=True)
class ReducedModel:
    """The part of a subsystem that the chosen outputs depend on.

    states, inputs   names of those that the outputs depend on, in the order of the declaration
    parameters       names of all parameters (p)
    estimated        names of the parameters to be estimated (q), a subset of p
    dynamic          indices in q that f or the outputs depend on; the others affect only the initial state
    quantities       declaration of each variable by name
    equations        equations of the reduced model; its initial state is x itself
    q                symbols of the parameters to be estimated
    start, all_x     initial states as expressions of all_x (all states of the full model), u and p
    """

    states: tuple[str, ...]
    inputs: tuple[str, ...]
    parameters: tuple[str, ...]
    outputs: tuple[str, ...]
    estimated: tuple[str, ...]
    dynamic: tuple[int, ...]
    quantities: dict[str, Quantity]
    equations: Symbolic
    q: ca.SX
    start: ca.SX
    all_x: ca.SX


def reduce_model(sub: Subsystem, outputs: Sequence[str], estimated: Sequence[str]) -> ReducedModel:
    """The subsystem without the states and inputs that have no effect on these outputs."""
    sym = symbolic(sub)
    groups = {g: quantities(getattr(sub, g)) for g in ("states", "inputs", "parameters", "outputs")}
    for article, causality, names in (("an", "output", outputs), ("a", "parameter", estimated)):
        for name in names:
            if name not in groups[causality + "s"]:
                expected = ", ".join(groups[causality + "s"])
                raise Problem(f"{sub.name}: {name} is not {article} {causality}; expected one of {expected}")
            if (count := list(names).count(name)) > 1:
                raise Problem(f"{sub.name}: {causality} {name}: expected once, got {count} times")
    order = {group: list(declared) for group, declared in groups.items()}
    y = column(*(sym.y[order["outputs"].index(name)] for name in outputs))
    states = _required_states(sym.dx, y, sym.x)
    if not states:
        listed = ", ".join(outputs)
        raise Problem(f"{sub.name}: {listed} depend on no state, so that there is nothing to identify")
    x, dx, start = (column(*(v[i] for i in states)) for v in (sym.x, sym.dx, sym.start))
    inputs = sorted(_dependencies(column(dx, y, start), sym.u))
    u = column(*(sym.u[i] for i in inputs))
    requirements = [i for i in range(len(sym.statements)) if _depends_only_on(sym.require[i], x, u, sym.p)]
    q = column(*(sym.p[order["parameters"].index(name)] for name in estimated))
    return ReducedModel(
        states=tuple(order["states"][i] for i in states),
        inputs=tuple(order["inputs"][i] for i in inputs),
        parameters=tuple(groups["parameters"]),
        outputs=tuple(outputs),
        estimated=tuple(estimated),
        dynamic=tuple(sorted(_dependencies(column(dx, y), q))),
        quantities={name: quantity for group in groups.values() for name, quantity in group.items()},
        equations=replace(
            sym,
            x=x,
            u=u,
            dx=dx,
            y=y,
            start=x,
            calculated=(),
            require=column(*(sym.require[i] for i in requirements)),
            statements=tuple(sym.statements[i] for i in requirements),
            next_event=ca.SX.inf(),  # no time events: the step-size control alone resolves jumps of a rate
        ),
        q=q,
        start=start,
        all_x=sym.x,
    )


def _required_states(dx: ca.SX, y: ca.SX, x: ca.SX) -> list[int]:
    """Indices of the states that y depends on, of those that their derivatives depend on, and so on."""
    required: set[int] = set()
    new = _dependencies(y, x)
    while new:
        required |= new
        new = _dependencies(column(*(dx[i] for i in sorted(new))), x) - required
    return sorted(required)


def _dependencies(value: ca.SX, symbols: ca.SX) -> set[int]:
    """Indices of the symbols that a value depends on."""
    return set(ca.jacobian_sparsity(value, symbols).get_triplet()[1])


def _depends_only_on(value: ca.SX, *symbols: ca.SX) -> bool:
    """Is each symbol that a value depends on one of these?"""
    allowed = column(*symbols)
    return all(ca.depends_on(allowed, s) for s in ca.symvar(value) if ca.depends_on(value, s))


def sensitivity_code(
    model: ReducedModel,
) -> tuple[list[Routine], dict[str, int], dict[str, Sequence[Entry]]]:
    """All functions that native/sensitivities.c calls in addition to those of an FMU.

    Also the lengths of the vectors between them, and sparsity patterns as (row, column).
    """
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
    # contribution of the state sensitivities to the output sensitivities
    dx, by_x = ca.SX.sym("dx", x.numel()), ca.SX.sym("y_x", len(y_x))
    dy = ca.densify(ca.mtimes(_sparse(y_x, [by_x], y.numel(), x.numel()), dx))
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
    routines = [
        Routine("sens_prepare", {"p": p}, {"d": prepared}),
        Routine("sens_hessian", arguments, {"hessian": values["hessian"]}),
        Routine("sens_stage", arguments | {"hessian": hessian_symbols, "k": k, "h_du": h_du}, stage),
        Routine("sens_outputs", arguments, {"y": values["y"]}),
        Routine("sens_output_jacobians", arguments, {"y_x": values["y_x"], "y_q": values["y_q"]}),
        _stage_columns(system, nonzeros(jacobian), list(product_x)),
        Routine("sens_output_columns", {"y_x": by_x, "dx": dx}, {"dy": dy}, frozenset({"dx", "dy"})),
    ]
    vectors = {"NQ": q, "NOUT": y, "ND": d, "NHESSIAN": hessian}
    entries = {"NPRODUCT": product_x, "NF_Q": f_q, "NY_X": y_x, "NY_Q": y_q}
    lengths = {name: vector.numel() for name, vector in vectors.items()}
    lengths |= {name: len(nonzero) for name, nonzero in entries.items()}
    return routines, lengths, {"F_Q": list(f_q), "Y_Q": list(y_q)}


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


def _sparse(entries: Iterable[Entry], values: Sequence[ca.SX], rows: int, columns: int) -> ca.SX:
    """Sparse matrix from the values of its entries."""
    pairs = list(entries)
    return ca.SX.triplet([i for i, _ in pairs], [j for _, j in pairs], column(*values), rows, columns)
