"""The generated C of one model for output error: that of an FMU, and the derivatives of its steps."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import casadi as ca

from fmus.contract import Quantity, Symbolic
from fmus.export.codegen import generated
from fmus.export.elimination import Place
from fmus.export.emit import routine
from fmus.export.interface import Interface, Kind, Variable, assembled
from fmus.identification.refinement.columns import WIDTH
from fmus.identification.refinement.derivatives import derivatives
from fmus.identification.refinement.reduced import Reduced


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
