"""The generated C of one model: sizes.h and model.c, to be compiled with the files in native/."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence

import casadi as ca

from fmus.export.emit import Routine, routine
from fmus.export.interface import Interface, Variable

DEFAULT_TOLERANCE = 1e-6


def sources(face: Interface, guid: str) -> dict[str, str]:
    """File name -> text of the generated C files."""
    routines, common = _routines(face)
    names = {
        "x": [v.name for v in face.states],
        "u": [v.name for v in face.inputs],
        "p": [v.name for v in face.parameters],
    }
    equations = "\n".join(routine(r, names) for r in routines)
    return {"sizes.h": _sizes(face, common, guid), "model.c": f"{_table(face)}\n{equations}"}


def _sizes(face: Interface, common: int, guid: str) -> str:
    sizes = {
        "NP": (len(face.parameters), "parameters"),
        "NU": (len(face.inputs), "inputs"),
        "NX": (len(face.states), "states"),
        "NY": (len(face.outputs), "outputs that are not states"),
        "NC": (common, "quantities that depend on parameters alone"),
        "NREQUIRE": (len(face.equations.statements), "requirements"),
    }
    lines = [
        f"/* {face.name}: {_comment(face.text)}. Generated. */",
        "",
        "#ifndef SIZES_H",
        "#define SIZES_H",
        "",
        f"#define MODEL_GUID {json.dumps(guid)}",
        f"#define DEFAULT_TOLERANCE {DEFAULT_TOLERANCE!r}",
        "",
        "enum {",
        *(f"    {name} = {n}, /* {text} */" for name, (n, text) in sizes.items()),
        "};",
        "",
        "/* Value references. */",
        "enum {",
        *(f"    VR_{v.name} = {v.reference}, /* {_meaning(v)} */" for v in face.variables),
        "};" if face.variables else "    NO_VARIABLES\n};",
        "",
        "#endif",
        "",
    ]
    return "\n".join(lines)


def _comment(text: str) -> str:
    return text.replace("*/", "* /").replace("/*", "/ *")


def _meaning(v: Variable) -> str:
    return f"[{v.quantity.unit}] {_comment(v.quantity.text)}"


def _table(face: Interface) -> str:
    """The table of variables and the texts of the requirements."""
    inputs = [v.name for v in face.inputs]
    rows = [_row(v, inputs) for v in face.variables] or ["    {0},"]
    statements = [f"    {_string(text)}," for text in face.equations.statements] or ["    0,"]
    return "\n".join(
        [
            f"/* {face.name}: {_comment(face.text)}. Generated. */",
            "",
            "#include <math.h>",
            "",
            '#include "model.h"',
            "",
            "/* name, unit, kind, start, minimum, maximum, nominal, warn_above, rate */",
            "const Variable model_variables[ROOM(NUMBER_OF_VARIABLES)] = {",
            *rows,
            "};",
            "",
            "const char *const model_statements[ROOM(NREQUIRE)] = {",
            *statements,
            "};",
            "",
        ]
    )


def _row(v: Variable, inputs: Sequence[str]) -> str:
    q = v.quantity
    rate = inputs.index(q.rate) if v.kind == "INPUT" and q.rate is not None else -1
    low = -math.inf if q.minimum is None else q.minimum
    high = math.inf if q.maximum is None else q.maximum
    watch = math.inf if q.warn_above is None or not v.output else q.warn_above
    numbers = ", ".join(_number(n) for n in (v.start or 0.0, low, high, q.nominal, watch))
    return f"    {{{_string(v.name)}, {_string(q.unit)}, {v.kind}, {numbers}, {rate}}},"


def _string(text: str) -> str:
    """A C string literal; characters beyond ASCII as UTF-8 bytes in octal."""
    escaped = "".join(
        chr(b) if 32 <= b < 127 and chr(b) not in '"\\?' else f"\\{b:03o}" for b in text.encode("utf-8")
    )
    return f'"{escaped}"'


def _number(value: float) -> str:
    return {math.inf: "INFINITY", -math.inf: "-INFINITY"}.get(value, repr(float(value)))


# ---- equations -------------------------------------------------------------------------------------


def _routines(face: Interface) -> tuple[list[Routine], int]:
    """All functions of native/model.h, and how many quantities depend on parameters alone."""
    sym = face.equations
    x, u, p = sym.x, sym.u, sym.p
    du, vx, vu, vp = (ca.SX.sym(n, v.numel()) for n, v in (("du", u), ("vx", x), ("vu", u), ("vp", p)))
    known, at_start = (x, u), (x, u, p)
    vx0 = _along(sym.start, at_start, (vx, vu, vp))
    wanted = {
        "x0": sym.start,
        "dx": sym.dx,
        "jac": ca.vec(ca.jacobian(sym.dx, x).T),
        "ft": ca.jtimes(sym.dx, u, du),
        "y": face.y,
        "require": sym.require,
        "vdx": _along(sym.dx, known, (vx, vu)),
        "vy": _along(face.y, known, (vx, vu)),
        "vx0": vx0,
        "vdx0": _along(sym.dx, at_start, (vx0, vu, vp)),
        "vy0": _along(face.y, at_start, (vx0, vu, vp)),
    }
    wanted, c, prepared = _hoist({name: ca.densify(value) for name, value in wanted.items()}, p)
    model = {"x": x, "u": u, "p": p, "c": c}
    direction = {"vx": vx, "vu": vu}

    def give(name: str, inputs: Mapping[str, ca.SX], *outputs: str) -> Routine:
        return Routine(name, inputs, {o: wanted[o] for o in outputs})

    return [
        Routine("model_prepare", {"p": p}, {"c": prepared}),
        give("model_start", model, "x0"),
        give("model_dynamics", model, "dx"),
        give("model_jacobian", model | {"du": du}, "dx", "jac", "ft"),
        give("model_observe", model, "y", "require"),
        give("model_forward", model | direction, "vdx", "vy"),
        give("model_start_forward", model | direction | {"vp": vp}, "vx0", "vdx0", "vy0"),
    ], c.numel()


def _along(value: ca.SX, known: Sequence[ca.SX], direction: Sequence[ca.SX]) -> ca.SX:
    """Directional derivative of `value` with respect to `known`."""
    return ca.jtimes(value, ca.vertcat(*known), ca.vertcat(*direction))


def _hoist(wanted: Mapping[str, ca.SX], p: ca.SX) -> tuple[dict[str, ca.SX], ca.SX, ca.SX]:
    """Replaces what depends on the parameters alone by symbols c; also returns c and what it stands for."""
    everything = ca.cse(ca.vertcat(*wanted.values()))
    reduced, symbols, meanings = ca.extract_parametric(everything, p)
    c = ca.vertcat(*symbols) if symbols else ca.SX(0, 1)
    prepared = ca.vertcat(*meanings) if meanings else ca.SX(0, 1)
    ends = [0]
    for value in wanted.values():
        ends.append(ends[-1] + value.numel())
    parts = ca.vertsplit(ca.densify(reduced), ends)
    return dict(zip(wanted, parts, strict=True)), c, prepared
