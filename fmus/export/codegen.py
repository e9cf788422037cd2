"""The generated C of one model: sizes.h, model.c, adjoint.c for FMI 3, and one that includes all."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from importlib.resources import files

import casadi as ca

from fmus.export.elimination import eliminate
from fmus.export.emit import Routine, routine
from fmus.export.interface import Interface, Variable

DEFAULT_TOLERANCE = 1e-6


_ORDER = ("model", "adjoint", "rosenbrock", "core", "snapshot", "instance")  # the others follow


def native_sources(fmi: int) -> dict[str, str]:
    """The hand-written C files by name: what both FMI versions share, and what is of this one."""
    folder = files("fmus.export") / "native"
    other = f"fmi{5 - fmi}"
    return {
        f.name: f.read_text(encoding="utf-8")
        for f in folder.iterdir()
        if f.name.endswith((".c", ".h")) and not f.name.startswith(other)
    }


def sources(face: Interface, guid: str, fmi: int) -> dict[str, str]:
    """File name -> text of all C files of an FMU; only that of `main_source` is to be compiled."""
    code = native_sources(fmi) | _generated(face, guid, fmi)
    names = [name for stem in _ORDER if (name := f"{stem}.c") in code]
    names += sorted(name for name in code if name.endswith(".c") and name not in names)
    return code | {main_source(face.name): _all(face, names, fmi)}


def main_source(model: str) -> str:
    """The file to compile: named after the model, so that the objects of several FMUs differ by name."""
    return f"{model}_fmu.c"


def _all(face: Interface, names: Sequence[str], fmi: int) -> str:
    return "\n".join(
        [
            f"/* {face.name}: the one file to compile. Generated.",
            f"   To link it statically with other FMUs: -DFMI{fmi}_FUNCTION_PREFIX={face.name}_ */",
            "",
            *(f'#include "{name}"' for name in names),
            "",
        ]
    )


def _generated(face: Interface, guid: str, fmi: int) -> dict[str, str]:
    routines, adjoint, inner = _routines(face)
    names = {
        "x": [v.name for v in face.states],
        "u": [v.name for v in face.inputs],
        "p": [v.name for v in face.parameters],
    }
    equations = "\n".join(routine(r, names) for r in routines)
    code = {"sizes.h": _sizes(face, inner, guid), "model.c": f"{_table(face)}\n{equations}"}
    if fmi == 3:
        head = f"/* {face.name}: derivatives in reverse. Generated. */"
        includes = '#include <math.h>\n\n#include "model.h"\n'
        code["adjoint.c"] = "\n".join([head, "", includes, *(routine(r, names) for r in adjoint)])
    return code


def _sizes(face: Interface, inner: Mapping[str, int], guid: str) -> str:
    sizes = {
        "NP": (len(face.parameters), "parameters"),
        "NU": (len(face.inputs), "inputs"),
        "NX": (len(face.states), "states"),
        "NY": (len(face.outputs), "outputs that are not states"),
        "NC": (inner["NC"], "quantities that depend on parameters alone"),
        "NJ": (inner["NJ"], "entries of df/dx that are not constant"),
        "NLU": (inner["NLU"], "entries of the factors that are not constant"),
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
            "static const Variable model_variables[ROOM(NUMBER_OF_VARIABLES)] = {",
            *rows,
            "};",
            "",
            "static const char *const model_statements[ROOM(NREQUIRE)] = {",
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


def _routines(face: Interface) -> tuple[list[Routine], list[Routine], dict[str, int]]:
    """The functions of native/model.h, the adjoint ones, and the lengths of the vectors between them."""
    sym = face.equations
    x, u, p = sym.x, sym.u, sym.p
    system = eliminate(ca.jacobian(sym.dx, x))
    du, vx, vu, vp = (ca.SX.sym(n, v.numel()) for n, v in (("du", u), ("vx", x), ("vu", u), ("vp", p)))
    known, at_start = (x, u), (x, u, p)
    wx0, wdx, wy = (ca.SX.sym(n, v.numel()) for n, v in (("wx0", x), ("wdx", x), ("wy", face.y)))
    reverse = _against((sym.dx, face.y), known, (wdx, wy))
    reverse_dx = _against((sym.dx, face.y), at_start, (wdx, wy))
    reverse_start = _against((sym.start,), at_start, (wx0 + reverse_dx[0],))
    vx0 = _along(sym.start, at_start, (vx, vu, vp))
    wanted = {
        "x0": sym.start,
        "dx": sym.dx,
        "jac": system.entries,
        "ft": ca.jtimes(sym.dx, u, du),
        "y": face.y,
        "require": sym.require,
        "wait": sym.corner,
        "vdx": _along(sym.dx, known, (vx, vu)),
        "vy": _along(face.y, known, (vx, vu)),
        "vx0": vx0,
        "vdx0": _along(sym.dx, at_start, (vx0, vu, vp)),
        "vy0": _along(face.y, at_start, (vx0, vu, vp)),
        "wx": reverse[0],
        "wu": reverse[1],
        "wx_start": reverse_start[0],
        "wu_start": reverse_dx[1] + reverse_start[1],
        "wp_start": reverse_dx[2] + reverse_start[2],
    }
    wanted, c, prepared = _hoist({name: ca.densify(value) for name, value in wanted.items()}, p)
    model = {"x": x, "u": u, "p": p, "c": c}
    direction = {"vx": vx, "vu": vu}

    weights = {"wdx": wdx, "wy": wy}

    def give(name: str, inputs: Mapping[str, ca.SX], *outputs: str) -> Routine:
        return Routine(name, inputs, {o: wanted[o] for o in outputs})

    return (
        [
            Routine("model_prepare", {"p": p}, {"c": prepared}),
            give("model_start", model, "x0"),
            give("model_dynamics", model, "dx"),
            give("model_jacobian", model | {"du": du}, "dx", "jac", "ft"),
            Routine(
                "model_factorise",
                {"diagonal": system.diagonal, "jac": system.jac},
                {"lu": system.factors, "trust": system.trust},
            ),
            Routine("model_solve", {"lu": system.lu, "b": system.b}, {"k": system.k}),
            give("model_observe", model, "y", "require"),
            give("model_corner", model, "wait"),
            give("model_forward", model | direction, "vdx", "vy"),
            give("model_start_forward", model | direction | {"vp": vp}, "vx0", "vdx0", "vy0"),
        ],
        [
            give("model_reverse", model | weights, "wx", "wu"),
            give("model_start_reverse", model | {"wx0": wx0} | weights, "wx_start", "wu_start", "wp_start"),
        ],
        {"NC": c.numel(), "NJ": system.jac.numel(), "NLU": system.lu.numel()},
    )


def _against(values: Sequence[ca.SX], known: Sequence[ca.SX], weights: Sequence[ca.SX]) -> list[ca.SX]:
    """The weighted sum of `values`, differentiated by each of `known`."""
    total = ca.jtimes(ca.vertcat(*values), ca.vertcat(*known), ca.vertcat(*weights), True)
    ends = [0]
    for group in known:
        ends.append(ends[-1] + group.numel())
    return list(ca.vertsplit(ca.densify(total), ends))


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
