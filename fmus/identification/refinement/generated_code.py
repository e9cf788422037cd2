"""The C code of one model for output error: that of an FMU, and the derivatives of its steps.

A step of the solver is (export/native/rosenbrock.c)

    M k_i = f(X_i) + sum_j c_ij / h k_j + g_i h f_u du,    M = I / (gamma h) - J(x),  X_i = x + sum_j a_ij k_j

so a derivative by a start value or a parameter q, with the size h of the step as it is, follows from

    M dk_i = J(X_i) dX_i + f_q(X_i) dq + sum_j c_ij / h dk_j + d/d(x, q) [J(x) k_i + g_i h f_u(x) du] (dx, dq)

M is factorised for the step itself, and these factors serve all columns of derivatives at once. The last term
needs second derivatives of f: they do not change over a step, in which they are only multiplied by
(k_i, g_i h du).
"""

from __future__ import annotations

import ctypes
import subprocess
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from importlib.resources import files

import casadi as ca

from fmus.contract import Quantity, Subsystem, Symbolic, column, quantities, symbolic
from fmus.export.c_code import Routine, generated, hoist, native_sources, routine
from fmus.export.elimination import Elimination, Place, eliminate, nonzeros
from fmus.export.interface import Interface, Kind, Variable, assembled
from orchestrator.base.compiler import SUFFIX, shared_library
from orchestrator.base.errors import Problem

WIDTH = 8  # columns at once: a cache line, one to four registers of the processors of today


@dataclass(frozen=True)
class Reduced:
    """The part of a subsystem that some of its outputs depend on.

    states, inputs   names of those that the outputs depend on, in the order of the declaration
    parameters       all names: what p holds
    free             names of those in q, which are some of p
    acting           which of q the motion and the outputs depend on; the others act through the start alone
    equations        of these states, inputs, outputs; it starts from its own states
    q                symbols of the free parameters
    start, all_x     start values, and the symbols of all states that they depend on, with u and p
    """

    states: tuple[str, ...]
    inputs: tuple[str, ...]
    parameters: tuple[str, ...]
    outputs: tuple[str, ...]
    free: tuple[str, ...]
    acting: tuple[int, ...]
    declared: dict[str, Quantity]
    equations: Symbolic
    q: ca.SX
    start: ca.SX
    all_x: ca.SX


def reduce(sub: Subsystem, outputs: Sequence[str], free: Sequence[str]) -> Reduced:
    """The subsystem without the states and inputs that do not act on these outputs."""
    sym = symbolic(sub)
    groups = {g: quantities(getattr(sub, g)) for g in ("states", "inputs", "parameters", "outputs")}
    for kind, names in (("output", outputs), ("parameter", free)):
        for name in names:
            if name not in groups[kind + "s"]:
                expected = ", ".join(groups[kind + "s"])
                raise Problem(f"{sub.name}: {name} is no {kind}, expected one of {expected}")
            if list(names).count(name) > 1:
                raise Problem(f"{sub.name}: {kind} {name} is asked for twice, expected once")
    order = {group: list(declared) for group, declared in groups.items()}
    y = column(*(sym.y[order["outputs"].index(name)] for name in outputs))
    states = _needed_states(sym.dx, y, sym.x)
    if not states:
        raise Problem(f"{sub.name}: {', '.join(outputs)} depend on no state, expected outputs that do")
    x, dx, start = (column(*(v[i] for i in states)) for v in (sym.x, sym.dx, sym.start))
    inputs = sorted(_arguments(column(dx, y, start), sym.u))
    u = column(*(sym.u[i] for i in inputs))
    own = column(x, u, sym.p)
    checked = [
        i
        for i in range(len(sym.statements))
        if all(ca.depends_on(own, s) for s in ca.symvar(sym.require[i]) if ca.depends_on(sym.require[i], s))
    ]
    q = column(*(sym.p[order["parameters"].index(name)] for name in free))
    return Reduced(
        states=tuple(order["states"][i] for i in states),
        inputs=tuple(order["inputs"][i] for i in inputs),
        parameters=tuple(groups["parameters"]),
        outputs=tuple(outputs),
        free=tuple(free),
        acting=tuple(sorted(_arguments(column(dx, y), q))),
        declared={name: quantity for group in groups.values() for name, quantity in group.items()},
        equations=replace(
            sym,
            x=x,
            u=u,
            dx=dx,
            y=y,
            start=x,
            calculated=(),
            require=column(*(sym.require[i] for i in checked)),
            statements=tuple(sym.statements[i] for i in checked),
            corner=ca.SX.inf(),
        ),
        q=q,
        start=start,
        all_x=sym.x,
    )


def _needed_states(dx: ca.SX, y: ca.SX, x: ca.SX) -> list[int]:
    """The states that y depends on, those that their derivatives depend on, and so on."""
    needed: set[int] = set()
    new = _arguments(y, x)
    while new:
        needed |= new
        new = _arguments(column(*(dx[i] for i in sorted(new))), x) - needed
    return sorted(needed)


def _arguments(value: ca.SX, symbols: ca.SX) -> set[int]:
    """Indices of the symbols that a value depends on."""
    return set(ca.jacobian_sparsity(value, symbols).get_triplet()[1])


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
    b = r + _times(n, factors, at) + _times(n, dict(zip(bent_places, ca.vertsplit(bent), strict=True)), start)
    k = ca.substitute(system.k, system.b, b)
    inputs = {"jac": system.jac, "bent": bent, "lu": system.lu, "at": at, "from": start, "r": r}
    return Routine("columns_stage", inputs, {"k": k}, frozenset({"at", "from", "r", "k"}))


def observe_columns(outputs: int, states: int, places: Sequence[Place]) -> Routine:
    """out = y_x s: what the states add to the derivatives of the outputs."""
    s, y_x = ca.SX.sym("s", states), ca.SX.sym("y_x", len(places))
    out = _times(outputs, dict(zip(places, ca.vertsplit(y_x), strict=True)), s)
    return Routine("columns_observe", {"y_x": y_x, "s": s}, {"out": out}, frozenset({"s", "out"}))


def _times(rows: int, matrix: Mapping[Place, ca.SX], x: ca.SX) -> ca.SX:
    """Sparse matrix times column, shape (rows, 1)."""
    result = [ca.SX(0)] * rows
    for (i, j), value in matrix.items():
        result[i] += value * x[j]
    product: ca.SX = column(*result)
    return product


@dataclass(frozen=True)
class SensitivityCode:
    """C functions, the lengths of the vectors between them, and where sparse values belong (row, column)."""

    routines: Sequence[Routine]
    lengths: Mapping[str, int]
    places: Mapping[str, Sequence[Place]]


def sensitivity_code(model: Reduced) -> SensitivityCode:
    """All functions that native/sensitivities.c calls in addition to those of an FMU."""
    eqs, q = model.equations, column(*(model.q[i] for i in model.acting))
    x, u, p, y = eqs.x, eqs.u, eqs.p, eqs.y
    jacobian = ca.jacobian(eqs.dx, x)
    system, entries = eliminate(jacobian), nonzeros(jacobian)
    k, h_du = ca.SX.sym("k", x.numel()), ca.SX.sym("h_du", u.numel())
    second, bends, bent_x, bent_q = _second(eqs, jacobian, q, column(k, h_du))
    direct = dict(nonzeros(ca.jacobian(eqs.dx, q)))
    for place, value in bent_q.items():
        direct[place] = direct[place] + value if place in direct else value
    y_x, y_q = nonzeros(ca.jacobian(y, x)), nonzeros(ca.jacobian(y, q))
    wanted = {
        "bends": second,
        "jac": system.entries,
        "direct": column(*direct.values()),
        "y": y,
        "y_x": column(*y_x.values()),
        "y_q": column(*y_q.values()),
    }
    values, d, prepared = hoist({name: ca.densify(value) for name, value in wanted.items()}, p)
    known = {"x": x, "u": u, "p": p, "d": d}
    stage = {"jac": values["jac"], "bent": column(*bent_x.values()), "direct": values["direct"]}
    return SensitivityCode(
        routines=[
            Routine("slopes_prepare", {"p": p}, {"d": prepared}),
            Routine("slopes_bends", known, {"bends": values["bends"]}),
            Routine("slopes_stage", known | {"bends": bends, "k": k, "h_du": h_du}, stage),
            Routine("slopes_observe", known, {"y": values["y"]}),
            Routine("slopes_observed", known, {"y_x": values["y_x"], "y_q": values["y_q"]}),
            stage_columns(system, entries, list(bent_x)),
            observe_columns(y.numel(), x.numel(), list(y_x)),
        ],
        lengths={
            "NQ": q.numel(),
            "NOUT": y.numel(),
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
    eqs: Symbolic, jacobian: ca.SX, q: ca.SX, directions: ca.SX
) -> tuple[ca.SX, ca.SX, dict[Place, ca.SX], dict[Place, ca.SX]]:
    """The second derivatives that count, symbols for them, and their products with the directions (k, h du).

    The products belong to x and to q, row and column as in the first derivatives.
    """
    first = ca.mtimes(ca.horzcat(jacobian, ca.jacobian(eqs.dx, eqs.u)), directions)
    by_x, by_q = nonzeros(ca.jacobian(first, eqs.x)), nonzeros(ca.jacobian(first, q))
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


HEADER = """/* Lengths. Generated. */

#ifndef SLOPES_H
#define SLOPES_H

#include "model.h"

enum {{
{lengths}
}};

typedef double Columns __attribute__((ext_vector_type(WIDTH)));

#endif
"""
PREAMBLE = """/* Derivatives. Generated. */

#include <math.h>

#include "slopes.h"

#pragma clang fp contract(fast)
"""


def sources(model: Reduced) -> dict[str, str]:
    """Files by name: sizes.h and model.c as in an FMU, slopes.h and slopes.c."""
    code = sensitivity_code(model)
    names = {"x": list(model.states), "u": list(model.inputs), "p": list(model.parameters)}
    tables = []
    for name, places in code.places.items():
        rows = [f"    {{{i}, {j}}}," for i, j in places] or ["    {0, 0},"]
        tables += [f"static const int {name}[][2] = {{ /* row and column */", *rows, "};", ""]
    lengths = {**code.lengths, "WIDTH": WIDTH}
    return generated(_interface(model), "", 2) | {
        "slopes.h": HEADER.format(lengths="\n".join(f"    {name} = {n}," for name, n in lengths.items())),
        "slopes.c": "\n".join([PREAMBLE, *tables, *(routine(r, names) for r in code.routines)]),
    }


def _interface(model: Reduced) -> Interface:
    """The model as that of an FMU, without numbers: one code for all values."""
    rates = [f"der_{name}" for name in model.states]
    declared = model.declared | {f"der_{name}": model.declared[name] for name in model.states}

    def variables(kind: Kind, names: Sequence[str]) -> list[Variable]:
        bare = {n: Quantity(declared[n].unit, declared[n].text, declared[n].nominal) for n in names}
        return [Variable(name, kind, quantity, None) for name, quantity in bare.items()]

    groups = [
        variables("FIXED", model.parameters),
        variables("INPUT", model.inputs),
        variables("STATE", model.states),
        variables("DERIVATIVE", rates),
        [],  # outputs are in slopes.c alone
    ]
    equations = replace(model.equations, y=ca.SX(0, 1))
    # stiff, as it is by default: the implicit method alone is differentiated
    return assembled("refined", "A model for output error", groups, equations, ca.SX(0, 1))


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
