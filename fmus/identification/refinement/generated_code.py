"""C functions that take many columns of derivatives through a stage of the solver at once.

The derivatives of a step of the solver, as C functions.

A step is (export/native/rosenbrock.c)

    M k_i = f(X_i) + sum_j c_ij / h k_j + g_i h f_u du,    M = I / (gamma h) - J(x),  X_i = x + sum_j a_ij k_j

so a derivative by a start value or a parameter q, with the size h of the step as it is, follows from

    M dk_i = J(X_i) dX_i + f_q(X_i) dq + sum_j c_ij / h dk_j + d/d(x, q) [J(x) k_i + g_i h f_u(x) du] (dx, dq)

M is factorised for the step itself, and these factors serve all columns. The last term needs second
derivatives of f: they do not change over a step, in which they are only multiplied by (k_i, g_i h du).

The generated C of one model for output error: that of an FMU, and the derivatives of its steps.

C to a shared library for this computer, compiled once and kept in the user's cache.
"""

from __future__ import annotations

import ctypes
import subprocess
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.resources import files

import casadi as ca

from fmus.contract import Quantity, Symbolic, column
from fmus.export.c_code import Routine, generated, hoist, native_sources, routine
from fmus.export.elimination import Elimination, Place, eliminate, nonzeros
from fmus.export.interface import Interface, Kind, Variable, assembled
from fmus.identification.refinement.reduced import Reduced
from orchestrator.base.compiler import SUFFIX, shared_library

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


def sources(model: Reduced) -> dict[str, str]:
    """Files by name: sizes.h and model.c as in an FMU, slopes.h and slopes.c."""
    found = derivatives(model)
    names = {"x": list(model.states), "u": list(model.inputs), "p": list(model.parameters)}
    slopes = [
        "/* Derivatives. Generated. */",
        "",
        "#include <math.h>",
        "",
        '#include "slopes.h"',
        "",
        "#pragma clang fp contract(fast)",
        "",
        *(_table(name, places) for name, places in found.places.items()),
        *(routine(r, names) for r in found.routines),
    ]
    return generated(_face(model), "", 2) | {
        "slopes.h": _header({**found.lengths, "WIDTH": WIDTH}),
        "slopes.c": "\n".join(slopes),
    }


def _face(model: Reduced) -> Interface:
    """The model as that of an FMU, without numbers: one code for all values."""
    rates = [f"der_{name}" for name in model.states]
    declared = model.declared | {f"der_{name}": model.declared[name] for name in model.states}

    def variables(kind: Kind, names: Sequence[str]) -> list[Variable]:
        return [Variable(name, kind, _bare(declared[name]), None) for name in names]

    groups = [
        variables("FIXED", model.parameters),
        variables("INPUT", model.inputs),
        variables("STATE", model.states),
        variables("DERIVATIVE", rates),
        [],  # outputs: of them slopes.c knows
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
    # stiff, as it is by default: the implicit method alone is differentiated
    return assembled("refined", "A model for output error", groups, equations, ca.SX(0, 1))


def _bare(q: Quantity) -> Quantity:
    return Quantity(q.unit, q.text, q.nominal)


def _table(name: str, places: Sequence[Place]) -> str:
    rows = [f"    {{{row}, {column}}}," for row, column in places] or ["    {0, 0},"]
    return "\n".join([f"static const int {name}[][2] = {{ /* row and column */", *rows, "};", ""])


def _header(lengths: Mapping[str, int]) -> str:
    return "\n".join(
        [
            "/* Lengths. Generated. */",
            "",
            "#ifndef SLOPES_H",
            "#define SLOPES_H",
            "",
            '#include "model.h"',
            "",
            "enum {",
            *(f"    {name} = {length}," for name, length in lengths.items()),
            "};",
            "",
            "typedef double Columns __attribute__((ext_vector_type(WIDTH)));",
            "",
            "#endif",
            "",
        ]
    )


FLAGS = (
    *("-std=gnu11", "-O2", "-g0", "-fPIC", "-shared", "-fvisibility=hidden"),
    # numbers as in the FMU, but for the derivatives: native/sensitivities.c
    *("-ffp-contract=off", "-fno-math-errno", "-fno-trapping-math"),
    "-mcpu=native",  # the widest registers; what is kept is kept by processor
)
ORDER = ("model.c", "motion.c", "rosenbrock.c", "kutta.c", "solver.c", "slopes.c", "sensitivities.c")


def library(generated: Mapping[str, str]) -> ctypes.CDLL:
    """The library of a model from its generated files and those by hand."""
    native = native_sources(2)
    code = {name: text for name, text in native.items() if name in ORDER or name.endswith(".h")}
    own = files("fmus.identification.refinement") / "native" / "sensitivities.c"
    code |= {"sensitivities.c": own.read_text(encoding="utf-8"), **generated}
    code["all.c"] = "".join(f'#include "{name}"\n' for name in ORDER)
    encoded = {name: text.encode() for name, text in code.items()}
    arguments = [*FLAGS, "all.c", "-lm"]
    return ctypes.CDLL(str(shared_library(f"refined{SUFFIX}", encoded, arguments, [_processor().encode()])))


@cache
def _processor() -> str:
    """What the compiler knows of this processor."""
    command = [sys.executable, "-m", "ziglang", "build-exe", "--show-builtin"]
    return subprocess.run(command, capture_output=True, text=True, check=False).stdout
