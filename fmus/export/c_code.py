"""Generated C code of a model, and one file that includes all C files.

sizes.h, model.c and initial.c hold the equations, start.h and start.c the GUID and the start values.

The equations become the C functions of native/model.h: values and directional derivatives.
`fmus.export.c_functions` prints them.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache, partial
from importlib.resources import files
from pathlib import Path
from typing import Any

import casadi as ca

from fmus import called_functions
from fmus.called_functions import without_zero_calls
from fmus.components import opening_curve
from fmus.contract import Symbolic, column
from fmus.export import c_functions, elimination
from fmus.export.c_functions import Routine, c_function, hoist, number, split
from fmus.export.elimination import Entry, eliminate
from fmus.export.interface import Interface, Variable
from orchestrator.base import compiler
from orchestrator.base.text import rendered, sized_unit
from orchestrator.base.units import factor_and_offset

# name of a C function -> its outputs, and its inputs except states, inputs and parameters of the model
_ROUTINES: Mapping[str, tuple[Sequence[str], Sequence[str]]] = {
    "model_start": (["x0"], []),
    "model_dynamics": (["dx"], []),
    "model_jacobian": (["dx", "jac", "ft"], ["du"]),
    "model_observe": (["y_inputs"], ["z"]),
    "model_require": (["require"], ["z"]),
    "model_derivatives": (["dx_inputs"], ["z"]),
    "model_time_event": (["delay"], []),
    "model_forward": (["vdx", "vy"], ["vx", "vu"]),
    "model_start_forward": (["vx0", "vdx0", "vy0"], ["vx", "vu", "vp"]),
}


# what is called a few times before a run; it is compiled apart, and not optimised, see `compile`
_INITIAL = ("model_start", "model_start_forward")


def model_equations(interface: Interface) -> tuple[list[Routine], dict[str, int], Sequence[Entry]]:
    """The C functions of native/model.h, the lengths of vectors, and the places of jac that C code computes.

    A model that is not stiff seldom needs df/dx, the largest of the functions (in 20000 steps of a crane at 1
    ms never, or ten times at its end stops), so its C code computes it by directional derivatives.
    """
    sym, explicit = interface.equations, not interface.stiff
    system = eliminate(without_zero_calls(ca.jacobian(sym.dx, sym.x)))
    # directions v of states, inputs, parameters; time derivatives du of inputs
    like = {"vx": sym.x, "vu": sym.u, "vp": sym.p, "du": sym.u}
    arguments = {name: ca.SX.sym(name, v.numel()) for name, v in like.items()}
    is_held = [v.quantity.held for v in interface.inputs]
    held = column(*(u for u, h in zip(ca.vertsplit(sym.u), is_held, strict=True) if h))
    moving = column(*(0 if h else d for d, h in zip(ca.vertsplit(arguments["du"]), is_held, strict=True)))
    values = {
        "x0": sym.start,
        "dx": sym.dx,
        **({} if explicit else {"jac": system.entries, "ft": ca.jtimes(sym.dx, sym.u, moving)}),
        "y": interface.y,
        "require": sym.require,
        "delay": sym.next_event,
        **directional(sym, interface.y, arguments),
    }
    values, c, prepared = hoist(
        {name: ca.densify(value) for name, value in values.items()}, ca.vertcat(sym.p, held)
    )
    model = {"x": sym.x, "u": sym.u, "p": sym.p, "c": c}
    values, arguments["z"], observed = _split_by_inputs(values, model)
    main = [
        Routine(
            name,
            model | {i: arguments[i] for i in inputs},
            {o.partition("_inputs")[0]: values[o] for o in outputs},
            scope="SHARED" if name in _INITIAL else "LOCAL",
        )
        for name, (outputs, inputs) in _ROUTINES.items()
        if values.keys() >= {*outputs}
    ]
    matrix = {"diagonal": system.diagonal, "jac": system.jac}
    states = {"x": sym.x, "p": sym.p, "c": c}
    others = [
        Routine("model_prepare", {"u": sym.u, "p": sym.p}, {"c": prepared}),
        Routine("model_observe_states", states, {"y": values["y_states"], "z": observed}),
        Routine("model_factorise", matrix, {"lu": system.factors, "accurate": system.accurate}),
        Routine("model_solve", {"lu": system.lu, "b": system.b}, {"k": system.k}),
    ]
    lengths = {"NC": c.numel(), "NZ": observed.numel(), "NJ": system.jac.numel(), "NLU": system.lu.numel()}
    return [*others, *main], lengths, system.places if explicit else ()


def _split_by_inputs(
    values: Mapping[str, ca.SX], model: Mapping[str, ca.SX]
) -> tuple[dict[str, ca.SX], ca.SX, ca.SX]:
    """Derivatives, outputs, requirements, with symbols z for subexpressions that do not depend on the inputs.

    Returns the values, z, and these subexpressions. Two columns take the place of y, sparse and as long as y:
    `y_states`, the outputs that do not depend on the inputs, and `y_inputs`, the others. `dx_inputs` are the
    derivatives in terms of z.
    """
    y = values["y"]
    rows = [i for i in range(y.numel()) if ca.depends_on(y[i], model["u"])]
    others = [i for i in range(y.numel()) if i not in rows]
    parts = [column(*(y[i] for i in rows)), values["require"], values["dx"]]
    known = column(*(model[name] for name in ("x", "p", "c")))
    reduced, symbols, subexpressions = ca.extract_parametric(ca.cse(column(*parts)), known)
    z, observed = column(*symbols), column(*subexpressions)
    while ca.depends_on(observed, z):  # subexpressions of subexpressions
        observed = ca.substitute(observed, z, observed)
    on_inputs, require, dx = split(reduced, parts)
    columns = {"require": require, "dx_inputs": dx, "y_inputs": _sparse_column(on_inputs, rows, y.numel())}
    columns["y_states"] = _sparse_column(column(*(y[i] for i in others)), others, y.numel())
    return dict(values) | columns, z, observed


def _sparse_column(entries: ca.SX, rows: Sequence[int], length: int) -> ca.SX:
    """A column with these entries; the others are structural zeros."""
    return ca.SX(ca.Sparsity(length, 1, [0, len(rows)], list(rows)), entries)


def directional(sym: Symbolic, y: ca.SX, d: Mapping[str, ca.SX]) -> dict[str, ca.SX]:
    """Directional derivatives; those at the start (vx0, vdx0, vy0) go through the initial states."""

    def along(value: ca.SX, *direction: ca.SX) -> ca.SX:
        variables = (sym.x, sym.u, sym.p)[: len(direction)]
        return ca.jtimes(value, ca.vertcat(*variables), ca.vertcat(*direction))

    vx0 = along(sym.start, d["vx"], d["vu"], d["vp"])
    return {
        "vdx": along(sym.dx, d["vx"], d["vu"]),
        "vy": along(y, d["vx"], d["vu"]),
        "vx0": vx0,
        "vdx0": along(sym.dx, vx0, d["vu"], d["vp"]),
        "vy0": along(y, vx0, d["vu"], d["vp"]),
    }


# ---- files -----------------------------------------------------------------------------------------

TEMPLATES = Path(__file__).with_name("templates")
DEFAULT_TOLERANCE = 1e-6  # relative, of the solver
INCLUDED = ".inc"  # model.c is model.c.inc in an FMU, so that only one .c file is left to compile


# order in which the C files are included; all others follow in alphabetical order
_ORDER = (
    *("start", "initial", "model", "inputs", "rosenbrock"),
    *("runge_kutta", "solver", "equations", "core", "snapshot", "instance"),
)
# the hand-written files that evaluate and solve equations
_EQUATIONS = ("rosenbrock.c", "runge_kutta.c", "solver.c", "equations.c")


def native_sources(fmi: int) -> dict[str, str]:
    """The hand-written C files by name: those that both FMI versions share, and those of this version."""
    folder = files("fmus.export") / "native"
    other_version = f"fmi{5 - fmi}"
    points, last = opening_curve.POINTS, opening_curve.COEFFICIENTS - 1
    # of the first piece only three coefficients are not zero
    curve = rendered(TEMPLATES / "opening_curve.h.j2", points=points, rows=points + 3, last=last)
    return {"opening_curve.h": f"{curve}\n"} | {
        f.name: f.read_text(encoding="utf-8")
        for f in folder.iterdir()
        if f.name.endswith((".c", ".h")) and not f.name.startswith(other_version)
    }


def sources(
    interface: Interface,
    guid: str,
    fmi: int,
    printed: PrintedEquations | None = None,
    model: Mapping[str, str] | None = None,
) -> dict[str, str]:
    """All C files of an FMU, name -> content; only `main_source` ends in .c, and includes the others.

    printed   the equations in C, if they are known
    model     C files of a model without equations
    """
    code = native_sources(fmi)
    if model is not None:
        code = {name: text for name, text in code.items() if name not in _EQUATIONS} | dict(model)
        printed = PrintedEquations("", "", dict.fromkeys(("NC", "NZ", "NJ", "NLU"), 0))
    code |= generated(interface, guid, printed)
    names = [name for stem in _ORDER if (name := f"{stem}.c") in code]
    names += sorted(name for name in code if name.endswith(".c") and name not in names)
    packed = {f"{name}{INCLUDED}" if name in names else name: text for name, text in code.items()}
    included = [f"{name}{INCLUDED}" for name in names]
    main = rendered(TEMPLATES / "main.c.j2", name=interface.name, fmi=fmi, included=included)
    return packed | {main_source(interface.name): main}


def main_source(model: str) -> str:
    """The file to compile, named after the model, so that object files of several FMUs differ in name."""
    return f"{model}_fmu.c"


@dataclass(frozen=True)
class PrintedEquations:
    """The equations in C, the same for all values: those of model.c and initial.c, and lengths of vectors.

    places   of the entries of jac that C code computes, see `model_equations`
    """

    model: str
    initial: str
    lengths: Mapping[str, int]
    places: Sequence[Entry] = ()


def printed_equations(interface: Interface) -> PrintedEquations:
    """The equations in C, from the cache of the user if they were printed before, see `compiler.kept`."""
    sym = interface.equations
    results = [sym.dx, interface.y, sym.start, sym.require, sym.next_event]
    function = ca.Function("model", [sym.x, sym.u, sym.p], results)
    names = {
        "x": [v.name for v in interface.states],
        "u": [v.name for v in interface.inputs],
        "p": [v.name for v in interface.parameters],
    }
    described = json.dumps([names, interface.stiff]).encode()
    parts = [ca.CasadiMeta.version().encode(), function.serialize().encode(), described]
    kept = compiler.kept(
        f"{interface.name}.json", lambda: _print(interface, names), [*parts, *generator_sources()]
    )
    return PrintedEquations(**json.loads(kept))


def _print(interface: Interface, names: Mapping[str, Sequence[str]]) -> bytes:
    """The fields of `PrintedEquations` as JSON."""
    routines, lengths, places = model_equations(interface)
    initial, model = (
        "\n".join(c_function(r, names) for r in routines if (r.name in _INITIAL) == is_initial)
        for is_initial in (True, False)
    )
    content = {"model": model, "initial": initial, "lengths": lengths, "places": places}
    return json.dumps(content).encode()


@cache
def generator_sources() -> list[bytes]:
    """The Python code that prints equations: another version of it may print them in another way."""
    modules = (called_functions, c_functions, elimination)
    return [Path(file).read_bytes() for file in (__file__, *(str(module.__file__) for module in modules))]


def generated(interface: Interface, guid: str, printed: PrintedEquations | None = None) -> dict[str, str]:
    """The generated files by name: sizes.h, model.c, initial.c, start.h, start.c."""
    printed = printed or printed_equations(interface)
    content: dict[str, Any] = {
        "name": interface.name,
        "description": interface.description,
        "variables": interface.variables,
        "watched": _watched(interface),
        "statements": interface.equations.statements,
        "sizes": _sizes(interface, printed.lengths),
        "tolerance": repr(DEFAULT_TOLERANCE),
        "sampling": interface.sampling,
        "guid": json.dumps(guid),
        "equations": printed.model.removesuffix("\n"),
        "stiff": interface.stiff,
        "places": printed.places,
        "initial": printed.initial.removesuffix("\n"),
        "row": partial(_row, [v.name for v in interface.inputs]),
        "watched_row": _watched_row,
        "comment": _comment,
        "number": number,
        "string": string,
    }
    names = ("sizes.h", "model.c", "initial.c", "start.h", "start.c")
    return {name: rendered(TEMPLATES / f"{name}.j2", **content) for name in names}


def _sizes(interface: Interface, lengths: Mapping[str, int]) -> dict[str, tuple[int, str]]:
    """Name of each size -> its value and meaning."""
    return {
        "NP": (len(interface.parameters), "parameters"),
        "NU": (len(interface.inputs), "inputs"),
        "NX": (len(interface.states), "states"),
        "NDX": (len(interface.derivatives), "derivatives of states: NX, or 0 if the model has no equations"),
        "NY": (len(interface.outputs), "outputs that are not states"),
        "NC": (lengths["NC"], "quantities that depend on parameters alone"),
        "NZ": (lengths["NZ"], "quantities that depend on states and parameters alone"),
        "NJ": (lengths["NJ"], "entries of df/dx that are not constant"),
        "NLU": (lengths["NLU"], "entries of the factors that are not constant"),
        "NREQUIRE": (len(interface.equations.statements), "requirements"),
        "EXPLICIT_FIRST": (int(not interface.stiff), "1 if the explicit method is tried first"),
        "NWATCHED": (len(_watched(interface)), "inputs and outputs with a warning limit"),
    }


def _comment(text: str) -> str:
    """The text without the start and end of a C comment."""
    return text.replace("*/", "* /").replace("/*", "/ *")


def _watched(interface: Interface) -> list[Variable]:
    """The variables with a warning limit."""
    return [v for v in interface.variables if v.watched]


def _row(inputs: Sequence[str], v: Variable) -> str:
    """The description of a variable in C; limits that it does not have are infinite."""
    q = v.quantity
    is_input = v.kind == "INPUT"
    rate = inputs.index(q.rate) if is_input and q.rate is not None else -1
    low = -math.inf if q.minimum is None else q.minimum
    high = math.inf if q.maximum is None else q.maximum
    literals = ", ".join(number(value) for value in (low, high, q.nominal, q.absolute_scale))
    held = int(q.held and is_input)
    return f"{{{string(v.name)}, {string(q.unit)}, {v.kind}, {literals}, {rate}, {held}}}"


def _watched_row(v: Variable) -> str:
    """The limits of a variable in C, and the texts of their warnings in the unit of readers."""
    q, meanings, ends = v.quantity, list[str](), list[str]()
    shown = sized_unit(q.unit, q.warn_above or q.warn_below or q.nominal)
    factor, offset = factor_and_offset(q.unit, shown, v.name)
    above = math.inf if q.warn_above is None else q.warn_above
    below = -math.inf if q.warn_below is None else q.warn_below
    unit = "" if shown == "1" else f" {shown}"
    for name, limit, text in (("limit", above, q.meaning), ("lower limit", below, q.below or q.meaning)):
        meaning, colon, end = (text or f"{v.name} is beyond its limit").partition(": ")
        meanings.append(string(meaning))
        ends.append(string(f"{unit} ({name} {factor * limit + offset:.4g}{unit}){colon}{end}"))
    numbers = ", ".join(number(value) for value in (above, below, factor, offset))
    return f"{{{v.reference}, {numbers}, {{{', '.join(meanings)}}}, {{{', '.join(ends)}}}}}"


def string(text: str) -> str:
    """A C string literal; characters beyond ASCII as UTF-8 bytes in octal."""
    escaped = "".join(
        chr(b) if 32 <= b < 127 and chr(b) not in '"\\?' else f"\\{b:03o}" for b in text.encode("utf-8")
    )
    return f'"{escaped}"'
