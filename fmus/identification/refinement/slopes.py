"""The C of one model for output error: that of an FMU, and the derivatives of each step by many columns.

A step of the solver is (native/rosenbrock.c)

    M k_i = f(X_i) + sum_j c_ij / h k_j + g_i h f_u du,    M = I / (gamma h) - J(x),  X_i = x + sum_j a_ij k_j

so the derivative of a stage by a start value or a parameter, with the size h of the step as it is, follows from

    M dk_i = J(X_i) dX_i + f_p(X_i) + sum_j c_ij / h dk_j + d/d(x, p) [J(x) k_i + g_i h f_u(x) du]

The last term needs second derivatives of f. It is linear in (k_i, g_i h du); the factors of these are
evaluated once a step. M is factorised anyway, and one factorisation serves all columns.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import casadi as ca

from fmus.contract import Quantity, Symbolic, column
from fmus.export.codegen import generated
from fmus.export.elimination import Elimination, eliminate, nonzeros
from fmus.export.emit import Routine, routine
from fmus.export.interface import Interface, Kind, Variable, assembled
from fmus.identification.refinement.reduced import Reduced

WIDTH = 8  # columns that are worked on at once: a cache line, one to four registers


def sources(model: Reduced) -> dict[str, str]:
    """Generated files by name: sizes.h and model.c as in an FMU, slopes.h and slopes.c."""
    face = _face(model)
    routines, sizes, tables = _routines(model)
    names = {"x": list(model.states), "u": list(model.inputs), "p": list(model.parameters)}
    return generated(face, "", 2) | {
        "slopes.h": _header(sizes),
        "slopes.c": "\n".join([*tables, *(routine(r, names) for r in routines)]),
    }


def _face(model: Reduced) -> Interface:
    """The model as that of an FMU, without numbers: they are given while it runs."""

    def variables(kind: Kind, names: Sequence[str], rate: bool = False) -> list[Variable]:
        return [
            Variable(n, kind, _bare(model.declared[n.removeprefix("der_") if rate else n]), None)
            for n in names
        ]

    groups = [
        variables("FIXED", model.parameters),
        variables("INPUT", model.inputs),
        variables("STATE", model.states),
        variables("DERIVATIVE", [f"der_{name}" for name in model.states], rate=True),
        [],
    ]
    equations = Symbolic(
        x=model.x,
        u=model.u,
        p=model.p,
        dx=model.dx,
        y=ca.SX(0, 1),
        start=model.x,
        calculated=(),
        require=model.require,
        statements=model.statements,
        corner=ca.SX.inf(),
    )
    return assembled("refined", "One model for output error", groups, equations, ca.SX(0, 1))


def _bare(q: Quantity) -> Quantity:
    """Unit, text and magnitude."""
    return Quantity(q.unit, q.text, q.nominal)


def _routines(model: Reduced) -> tuple[list[Routine], Mapping[str, int], list[str]]:
    x, u, p, q = model.x, model.u, model.p, column(*(model.q[i] for i in model.acting))
    jacobian = ca.jacobian(model.dx, x)
    system = eliminate(jacobian)
    k, h_du = ca.SX.sym("k", x.numel()), ca.SX.sym("hdu", u.numel())
    bent = ca.jacobian(ca.mtimes(jacobian, k) + ca.jtimes(model.dx, u, h_du), column(x, q))
    bent_x, bent_q = bent[:, : x.numel()], bent[:, x.numel() :]
    direct = ca.jacobian(model.dx, q)
    output_x, output_q = ca.jacobian(model.y, x), ca.jacobian(model.y, q)
    # what is linear in k and h_du: a constant matrix over a step times these
    g = column(*nonzeros(bent_x).values())
    gq = column(*nonzeros(bent_q).values())
    tensor = ca.jacobian(column(g, gq), column(k, h_du))
    t = ca.SX.sym("t", tensor.nnz())
    contracted = ca.mtimes(ca.SX(tensor.sparsity(), t), column(k, h_du))
    places, mixed = _sum(nonzeros(direct), list(nonzeros(bent_q)), contracted[g.numel() :])
    values = {
        "bends": column(*tensor.nonzeros()),
        "jac": system.entries,
        "direct": mixed,
        "y": model.y,
        "gx": column(*nonzeros(output_x).values()),
        "gq": column(*nonzeros(output_q).values()),
    }
    values, d, prepared = _hoist(values, p)
    known = {"x": x, "u": u, "p": p, "d": d}
    routines = [
        Routine("slopes_prepare", {"p": p}, {"d": prepared}),
        Routine("slopes_bends", known, {"bends": values["bends"]}),
        Routine(
            "slopes_stage",
            known | {"bends": t, "k": k, "hdu": h_du},
            {"jac": values["jac"], "bent": contracted[: g.numel()], "direct": values["direct"]},
        ),
        Routine("slopes_observe", known, {"y": values["y"]}),
        Routine("slopes_observed", known, {"gx": values["gx"], "gq": values["gq"]}),
        _stage_columns(model, system, nonzeros(jacobian), list(nonzeros(bent_x))),
        _output_columns(model, list(nonzeros(output_x))),
    ]
    tables = [
        '#include "slopes.h"',
        "#include <math.h>",
        "#pragma clang fp contract(fast)",
        _table("DIRECT", places),
        _table("OBSERVED", list(nonzeros(output_q))),
    ]
    sizes = {
        "WIDTH": WIDTH,
        "NQ": q.numel(),
        "NOUT": model.y.numel(),
        "ND": d.numel(),
        "NBENDS": t.numel(),
        "NBENT": g.numel(),
        "NDIRECT": len(places),
        "NGX": output_x.nnz(),
        "NGQ": output_q.nnz(),
    }
    return routines, sizes, tables


def _sum(
    first: Mapping[tuple[int, int], ca.SX], second: Sequence[tuple[int, int]], values: ca.SX
) -> tuple[list[tuple[int, int]], ca.SX]:
    """Places and values of the sum of two sparse matrices."""
    total = dict(first)
    for i, place in enumerate(second):
        total[place] = total.get(place, 0) + values[i]
    return list(total), column(*total.values())


def _hoist(values: Mapping[str, ca.SX], p: ca.SX) -> tuple[dict[str, ca.SX], ca.SX, ca.SX]:
    """Replaces what depends on the parameters alone by symbols d; also returns d and what it stands for."""
    reduced, symbols, meanings = ca.extract_parametric(ca.cse(ca.densify(column(*values.values()))), p)
    ends = [0]
    for value in values.values():
        ends.append(ends[-1] + value.numel())
    parts = ca.vertsplit(ca.densify(reduced), ends)
    return dict(zip(values, parts, strict=True)), column(*symbols), column(*meanings)


def _stage_columns(
    model: Reduced,
    system: Elimination,
    jacobian: Mapping[tuple[int, int], ca.SX],
    bent: list[tuple[int, int]],
) -> Routine:
    """k = M^-1 (J at + G from + r) by columns."""
    n = model.x.numel()
    at, start, r, g = (ca.SX.sym(s, m) for s, m in (("at", n), ("from", n), ("r", n), ("g", len(bent))))
    b = [r[i] for i in range(n)]
    moving = 0
    for (row, col), value in jacobian.items():
        if value.is_constant():
            b[row] += value * at[col]
        else:
            b[row] += system.jac[moving] * at[col]
            moving += 1
    for i, (row, col) in enumerate(bent):
        b[row] += g[i] * start[col]
    k = ca.substitute(system.k, system.b, column(*b))
    inputs = {"jac": system.jac, "bent": g, "lu": system.lu, "at": at, "from": start, "r": r}
    return Routine("columns_stage", inputs, {"k": k}, frozenset({"at", "from", "r", "k"}))


def _output_columns(model: Reduced, places: Sequence[tuple[int, int]]) -> Routine:
    """What the states add to the outputs, by columns."""
    s, gx = ca.SX.sym("s", model.x.numel()), ca.SX.sym("gx", len(places))
    rows = [ca.SX(0)] * model.y.numel()
    for i, (row, col) in enumerate(places):
        rows[row] += gx[i] * s[col]
    return Routine("columns_observe", {"gx": gx, "s": s}, {"out": column(*rows)}, frozenset({"s", "out"}))


def _table(name: str, places: Sequence[tuple[int, int]]) -> str:
    rows = "".join(f"    {{{row}, {col}}},\n" for row, col in places) or "    {0, 0},\n"
    return f"static const int {name}[][2] = {{ /* row and column */\n{rows}}};\n"


def _header(sizes: Mapping[str, int]) -> str:
    return "\n".join(
        [
            "/* Generated. */",
            "",
            "#ifndef SLOPES_H",
            "#define SLOPES_H",
            "",
            '#include "model.h"',
            "",
            "enum {",
            *(f"    {name} = {size}," for name, size in sizes.items()),
            "};",
            "",
            "typedef double Columns __attribute__((ext_vector_type(WIDTH)));",
            "",
            "#endif",
            "",
        ]
    )
