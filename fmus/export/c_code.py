"""The generated C of one model: sizes.h, model.c, adjoint.c for FMI 3, and one file that includes all.

The equations become the C functions of native/model.h: values, and derivatives both ways. CasADi's own
generator tests every argument for null and hides the names of the variables; here the operations of a CasADi
function are written one per line, inputs by name, results as they are used.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from importlib.resources import files
from itertools import accumulate

import casadi as ca

from fmus.contract import Symbolic
from fmus.export.elimination import eliminate
from fmus.export.interface import Interface, Variable
from orchestrator.base.errors import Problem

_BINARY = {
    ca.OP_ADD: "{} + {}",
    ca.OP_SUB: "{} - {}",
    ca.OP_MUL: "{} * {}",
    ca.OP_DIV: "{} / {}",
    ca.OP_POW: "pow({}, {})",
    ca.OP_CONSTPOW: "pow({}, {})",
    ca.OP_LT: "{} < {}",
    ca.OP_LE: "{} <= {}",
    ca.OP_EQ: "{} == {}",
    ca.OP_NE: "{} != {}",
    ca.OP_AND: "{} != 0.0 && {} != 0.0",
    ca.OP_OR: "{} != 0.0 || {} != 0.0",
    ca.OP_FMIN: "fmin({}, {})",
    ca.OP_FMAX: "fmax({}, {})",
    ca.OP_FMOD: "fmod({}, {})",
    ca.OP_REMAINDER: "remainder({}, {})",
    ca.OP_COPYSIGN: "copysign({}, {})",
    ca.OP_ATAN2: "atan2({}, {})",
    ca.OP_HYPOT: "hypot({}, {})",
    ca.OP_IF_ELSE_ZERO: "{} != 0.0 ? {} : 0.0",
}
_UNARY = {
    ca.OP_ASSIGN: "{0}",
    ca.OP_NEG: "-{0}",
    ca.OP_SQ: "{0} * {0}",
    ca.OP_TWICE: "2.0 * {0}",
    ca.OP_INV: "1.0 / {0}",
    ca.OP_NOT: "{0} == 0.0",
    ca.OP_SIGN: "({0} > 0.0) - ({0} < 0.0)",
} | {
    getattr(ca, f"OP_{name.upper()}"): f"{name}({{0}})"
    for name in (
        *("sqrt", "exp", "log", "sin", "cos", "tan", "asin", "acos", "atan", "sinh", "cosh", "tanh"),
        *("asinh", "acosh", "atanh", "floor", "ceil", "fabs", "erf", "log1p", "expm1"),
    )
}


@dataclass(frozen=True)
class Routine:
    """A C function: named input vectors to named output vectors.

    wide   inputs and outputs whose entries are not numbers but of the C type `Columns`, as are all between
    """

    name: str
    inputs: Mapping[str, ca.SX]
    outputs: Mapping[str, ca.SX]
    wide: frozenset[str] = frozenset()


def routine(r: Routine, names: Mapping[str, Sequence[str]]) -> str:
    """The C text of a routine; `names` gives what the entries of an input vector are called."""
    function = ca.Function("f", list(r.inputs.values()), list(r.outputs.values()), {"cse": True})
    kinds = {name: "Columns" if name in r.wide else "double" for name in (*r.inputs, *r.outputs)}
    arguments = [f"const {kinds[name]} *{name}" for name in r.inputs]
    arguments += [f"{kinds[name]} *{name}" for name in r.outputs]
    used = {function.instruction_input(k)[0] for k in _of(function, ca.OP_INPUT)}
    unused = [f"(void){name};" for i, name in enumerate(r.inputs) if i not in used]
    unused += [f"(void){name};" for name, value in r.outputs.items() if value.numel() == 0]
    body = [*unused, *_statements(function, list(r.inputs), list(r.outputs), names)]
    if r.wide:
        body = [line.replace("const double v", "const Columns v", 1) for line in body]
    text = "".join(f"    {line}\n" for line in body)
    return f"LOCAL void {r.name}({', '.join(arguments)}) {{\n{text}}}\n"


def _of(function: ca.Function, operation: int) -> list[int]:
    return [k for k in range(function.n_instructions()) if function.instruction_id(k) == operation]


def _statements(
    function: ca.Function, inputs: list[str], outputs: list[str], names: Mapping[str, Sequence[str]]
) -> Iterator[str]:
    place: dict[int, str] = {}  # work index of CasADi -> the C expression it holds now
    written: set[tuple[int, int]] = set()
    for k in range(function.n_instructions()):
        operation, o, i = (
            function.instruction_id(k),
            function.instruction_output(k),
            function.instruction_input(k),
        )
        if operation == ca.OP_OUTPUT:
            written.add((o[0], o[1]))
            yield f"{outputs[o[0]]}[{o[1]}] = {place[i[0]]};"
        elif operation == ca.OP_CONST:
            place[o[0]] = number(function.instruction_constant(k))
        else:
            named = operation == ca.OP_INPUT and inputs[i[0]] in names
            meaning = f" /* {names[inputs[i[0]]][i[1]]} */" if named else ""
            yield f"const double v{k} = {_expression(operation, i, inputs, place)};{meaning}"
            place[o[0]] = f"v{k}"
    for n, name in enumerate(outputs):
        for j in range(function.numel_out(n)):
            if (n, j) not in written:
                yield f"{name}[{j}] = 0.0;"


def _expression(operation: int, i: Sequence[int], inputs: list[str], place: Mapping[int, str]) -> str:
    if operation == ca.OP_INPUT:
        return f"{inputs[i[0]]}[{i[1]}]"
    if operation in _UNARY:
        return str(_UNARY[operation].format(place[i[0]]))
    if operation in _BINARY:
        return str(_BINARY[operation].format(place[i[0]], place[i[1]]))
    raise Problem(f"operation {operation} of CasADi has no C here, expected elementary functions")


def number(value: float) -> str:
    """A C literal that reads back as the same double; negative ones in parentheses."""
    if value != value or value in (float("inf"), float("-inf")):
        return {"nan": "NAN", "inf": "INFINITY", "-inf": "(-INFINITY)"}[str(float(value))]
    text = repr(float(value))
    return f"({text})" if text.startswith("-") else text


@dataclass(frozen=True)
class Equations:
    """C functions, those for adjoint derivatives apart, and the lengths of the vectors between them."""

    routines: Sequence[Routine]
    adjoint: Sequence[Routine]
    lengths: Mapping[str, int]


# name of a C function -> vectors it writes, and what it reads besides states, inputs and parameters
_ROUTINES: Mapping[str, tuple[Sequence[str], Sequence[str]]] = {
    "model_start": (["x0"], []),
    "model_dynamics": (["dx"], []),
    "model_jacobian": (["dx", "jac", "ft"], ["du"]),
    "model_observe": (["y", "require"], []),
    "model_time_event": (["delay"], []),
    "model_forward": (["vdx", "vy"], ["vx", "vu"]),
    "model_start_forward": (["vx0", "vdx0", "vy0"], ["vx", "vu", "vp"]),
}
_ADJOINT: Mapping[str, tuple[Sequence[str], Sequence[str]]] = {
    "model_reverse": (["wx", "wu"], ["wdx", "wy"]),
    "model_start_reverse": (["wx_start", "wu_start", "wp_start"], ["wx0", "wdx", "wy"]),
}


def write_out(interface: Interface) -> Equations:
    """All functions of native/model.h for a model."""
    sym = interface.equations
    system = eliminate(ca.jacobian(sym.dx, sym.x))
    # directions v of states, inputs and parameters, slopes of inputs, weights w of results
    sizes = {"vx": sym.x, "vu": sym.u, "vp": sym.p, "du": sym.u, "wx0": sym.x, "wdx": sym.x}
    given = {name: ca.SX.sym(name, v.numel()) for name, v in (sizes | {"wy": interface.y}).items()}
    values = {
        "x0": sym.start,
        "dx": sym.dx,
        "jac": system.entries,
        "ft": ca.jtimes(sym.dx, sym.u, given["du"]),
        "y": interface.y,
        "require": sym.require,
        "delay": sym.next_event,
        **_directional(sym, interface.y, given),
        **_adjoint(sym, interface.y, given),
    }
    values, c, prepared = hoist({name: ca.densify(value) for name, value in values.items()}, sym.p)
    model = {"x": sym.x, "u": sym.u, "p": sym.p, "c": c}
    written, adjoint = (
        [
            Routine(name, model | {i: given[i] for i in inputs}, {o: values[o] for o in outputs})
            for name, (outputs, inputs) in table.items()
        ]
        for table in (_ROUTINES, _ADJOINT)
    )
    matrix = {"diagonal": system.diagonal, "jac": system.jac}
    first = [
        Routine("model_prepare", {"p": sym.p}, {"c": prepared}),
        Routine("model_factorise", matrix, {"lu": system.factors, "accurate": system.accurate}),
        Routine("model_solve", {"lu": system.lu, "b": system.b}, {"k": system.k}),
    ]
    lengths = {"NC": c.numel(), "NJ": system.jac.numel(), "NLU": system.lu.numel()}
    return Equations([*first, *written], adjoint, lengths)


def _directional(sym: Symbolic, y: ca.SX, d: Mapping[str, ca.SX]) -> dict[str, ca.SX]:
    """Directional derivatives while the model runs, and at the start through the start equations."""

    def along(value: ca.SX, *direction: ca.SX) -> ca.SX:
        known = (sym.x, sym.u, sym.p)[: len(direction)]
        return ca.jtimes(value, ca.vertcat(*known), ca.vertcat(*direction))

    vx0 = along(sym.start, d["vx"], d["vu"], d["vp"])
    return {
        "vdx": along(sym.dx, d["vx"], d["vu"]),
        "vy": along(y, d["vx"], d["vu"]),
        "vx0": vx0,
        "vdx0": along(sym.dx, vx0, d["vu"], d["vp"]),
        "vy0": along(y, vx0, d["vu"], d["vp"]),
    }


def _adjoint(sym: Symbolic, y: ca.SX, d: Mapping[str, ca.SX]) -> dict[str, ca.SX]:
    """Adjoint derivatives, likewise."""

    def against(value: ca.SX, weights: ca.SX, *known: ca.SX) -> list[ca.SX]:
        return _split(ca.jtimes(value, ca.vertcat(*known), weights, True), known)

    results, weights = ca.vertcat(sym.dx, y), ca.vertcat(d["wdx"], d["wy"])
    wx, wu = against(results, weights, sym.x, sym.u)
    on_x, on_u, on_p = against(results, weights, sym.x, sym.u, sym.p)
    start_x, start_u, start_p = against(sym.start, d["wx0"] + on_x, sym.x, sym.u, sym.p)
    return {
        "wx": wx,
        "wu": wu,
        "wx_start": start_x,
        "wu_start": on_u + start_u,
        "wp_start": on_p + start_p,
    }


def _split(column: ca.SX, like: Iterable[ca.SX]) -> list[ca.SX]:
    """Parts of a column, as long as these."""
    return list(ca.vertsplit(ca.densify(column), [0, *accumulate(part.numel() for part in like)]))


def hoist(wanted: Mapping[str, ca.SX], p: ca.SX) -> tuple[dict[str, ca.SX], ca.SX, ca.SX]:
    """Replaces what depends on the parameters alone by symbols c; also returns c and what it stands for.

    wanted   dense columns
    """
    everything = ca.cse(ca.vertcat(*wanted.values()))
    reduced, symbols, meanings = ca.extract_parametric(everything, p)
    c = ca.vertcat(*symbols) if symbols else ca.SX(0, 1)
    prepared = ca.vertcat(*meanings) if meanings else ca.SX(0, 1)
    return dict(zip(wanted, _split(reduced, wanted.values()), strict=True)), c, prepared


# ---- files -----------------------------------------------------------------------------------------

DEFAULT_TOLERANCE = 1e-6


_ORDER = (  # the others follow
    *("model", "adjoint", "motion", "rosenbrock", "kutta", "solver"),
    *("core", "snapshot", "instance"),
)


def native_sources(fmi: int) -> dict[str, str]:
    """The hand-written C files by name: what both FMI versions share, and what is of this one."""
    folder = files("fmus.export") / "native"
    other = f"fmi{5 - fmi}"
    return {
        f.name: f.read_text(encoding="utf-8")
        for f in folder.iterdir()
        if f.name.endswith((".c", ".h")) and not f.name.startswith(other)
    }


def sources(interface: Interface, guid: str, fmi: int) -> dict[str, str]:
    """File name -> text of all C files of an FMU; only that of `main_source` is to be compiled."""
    code = native_sources(fmi) | generated(interface, guid, fmi)
    names = [name for stem in _ORDER if (name := f"{stem}.c") in code]
    names += sorted(name for name in code if name.endswith(".c") and name not in names)
    return code | {main_source(interface.name): _all(interface, names, fmi)}


def main_source(model: str) -> str:
    """The file to compile: named after the model, so that the objects of several FMUs differ by name."""
    return f"{model}_fmu.c"


def _all(interface: Interface, names: Sequence[str], fmi: int) -> str:
    return "\n".join(
        [
            f"/* {interface.name}: the one file to compile. Generated.",
            f"   To link it statically with other FMUs: -DFMI{fmi}_FUNCTION_PREFIX={interface.name}_ */",
            "",
            *(f'#include "{name}"' for name in names),
            "",
        ]
    )


def generated(interface: Interface, guid: str, fmi: int) -> dict[str, str]:
    """The generated files by name: sizes.h, model.c, and adjoint.c for FMI 3."""
    equations = write_out(interface)
    names = {
        "x": [v.name for v in interface.states],
        "u": [v.name for v in interface.inputs],
        "p": [v.name for v in interface.parameters],
    }
    model = "\n".join(routine(r, names) for r in equations.routines)
    code = {"sizes.h": _sizes(interface, equations.lengths, guid), "model.c": f"{_table(interface)}\n{model}"}
    if fmi == 3:
        head = f"/* {interface.name}: derivatives in reverse. Generated. */"
        includes = '#include <math.h>\n\n#include "model.h"\n'
        code["adjoint.c"] = "\n".join([head, "", includes, *(routine(r, names) for r in equations.adjoint)])
    return code


def _sizes(interface: Interface, lengths: Mapping[str, int], guid: str) -> str:
    sizes = {
        "NP": (len(interface.parameters), "parameters"),
        "NU": (len(interface.inputs), "inputs"),
        "NX": (len(interface.states), "states"),
        "NY": (len(interface.outputs), "outputs that are not states"),
        "NC": (lengths["NC"], "quantities that depend on parameters alone"),
        "NJ": (lengths["NJ"], "entries of df/dx that are not constant"),
        "NLU": (lengths["NLU"], "entries of the factors that are not constant"),
        "NREQUIRE": (len(interface.equations.statements), "requirements"),
        "EXPLICIT_FIRST": (int(not interface.stiff), "1: the explicit method is tried first"),
        "NWATCHED": (len(_watched(interface)), "inputs and outputs with a limit that is watched"),
    }
    lines = [
        f"/* {interface.name}: {_comment(interface.text)}. Generated. */",
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
        *(f"    VR_{v.name} = {v.reference}, /* {_meaning(v)} */" for v in interface.variables),
        "};" if interface.variables else "    NO_VARIABLES\n};",
        "",
        "#endif",
        "",
    ]
    return "\n".join(lines)


def _comment(text: str) -> str:
    return text.replace("*/", "* /").replace("/*", "/ *")


def _meaning(v: Variable) -> str:
    return f"[{v.quantity.unit}] {_comment(v.quantity.text)}"


def _table(interface: Interface) -> str:
    """The table of variables and the texts of the requirements."""
    inputs = [v.name for v in interface.inputs]
    rows = [_row(v, inputs) for v in interface.variables] or ["    {0},"]
    watched = [f"    {v.reference}, /* {v.name} */" for v in _watched(interface)] or ["    0,"]
    statements = [f"    {string(text)}," for text in interface.equations.statements] or ["    0,"]
    return "\n".join(
        [
            f"/* {interface.name}: {_comment(interface.text)}. Generated. */",
            "",
            "#include <math.h>",
            "",
            '#include "model.h"',
            "",
            "/* name, unit, kind, start, minimum, maximum, nominal, absolute_scale, warn_above, rate */",
            "static const Variable model_variables[ROOM(NUMBER_OF_VARIABLES)] = {",
            *rows,
            "};",
            "",
            "static const int model_watched[ROOM(NWATCHED)] = {",
            *watched,
            "};",
            "",
            "static const char *const model_statements[ROOM(NREQUIRE)] = {",
            *statements,
            "};",
            "",
        ]
    )


def _watched(interface: Interface) -> list[Variable]:
    return [v for v in interface.variables if _limit(v) < math.inf]


def _limit(v: Variable) -> float:
    """Magnitude above which an input or output is warned of."""
    above = v.quantity.warn_above
    return math.inf if above is None or not (v.output or v.kind == "INPUT") else above


def _row(v: Variable, inputs: Sequence[str]) -> str:
    q = v.quantity
    rate = inputs.index(q.rate) if v.kind == "INPUT" and q.rate is not None else -1
    low = -math.inf if q.minimum is None else q.minimum
    high = math.inf if q.maximum is None else q.maximum
    sizes = (v.start or 0.0, low, high, q.nominal, q.absolute_scale, _limit(v))
    numbers = ", ".join(number(n) for n in sizes)
    return f"    {{{string(v.name)}, {string(q.unit)}, {v.kind}, {numbers}, {rate}}},"


def string(text: str) -> str:
    """A C string literal; characters beyond ASCII as UTF-8 bytes in octal."""
    escaped = "".join(
        chr(b) if 32 <= b < 127 and chr(b) not in '"\\?' else f"\\{b:03o}" for b in text.encode("utf-8")
    )
    return f'"{escaped}"'
