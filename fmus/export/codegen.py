"""The generated C of one model: sizes.h, model.c, adjoint.c for FMI 3, and one that includes all."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from importlib.resources import files

from fmus.export.emit import number, routine
from fmus.export.equations import write_out
from fmus.export.interface import Interface, Variable

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


def sources(face: Interface, guid: str, fmi: int) -> dict[str, str]:
    """File name -> text of all C files of an FMU; only that of `main_source` is to be compiled."""
    code = native_sources(fmi) | generated(face, guid, fmi)
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


def generated(face: Interface, guid: str, fmi: int) -> dict[str, str]:
    """The generated files by name: sizes.h, model.c, and adjoint.c for FMI 3."""
    equations = write_out(face)
    names = {
        "x": [v.name for v in face.states],
        "u": [v.name for v in face.inputs],
        "p": [v.name for v in face.parameters],
    }
    model = "\n".join(routine(r, names) for r in equations.routines)
    code = {"sizes.h": _sizes(face, equations.lengths, guid), "model.c": f"{_table(face)}\n{model}"}
    if fmi == 3:
        head = f"/* {face.name}: derivatives in reverse. Generated. */"
        includes = '#include <math.h>\n\n#include "model.h"\n'
        code["adjoint.c"] = "\n".join([head, "", includes, *(routine(r, names) for r in equations.adjoint)])
    return code


def _sizes(face: Interface, lengths: Mapping[str, int], guid: str) -> str:
    sizes = {
        "NP": (len(face.parameters), "parameters"),
        "NU": (len(face.inputs), "inputs"),
        "NX": (len(face.states), "states"),
        "NY": (len(face.outputs), "outputs that are not states"),
        "NC": (lengths["NC"], "quantities that depend on parameters alone"),
        "NJ": (lengths["NJ"], "entries of df/dx that are not constant"),
        "NLU": (lengths["NLU"], "entries of the factors that are not constant"),
        "NREQUIRE": (len(face.equations.statements), "requirements"),
        "EXPLICIT_FIRST": (int(not face.stiff), "1: the explicit method is tried first"),
        "NWATCHED": (len(_watched(face)), "inputs and outputs with a limit that is watched"),
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
    watched = [f"    {v.reference}, /* {v.name} */" for v in _watched(face)] or ["    0,"]
    statements = [f"    {string(text)}," for text in face.equations.statements] or ["    0,"]
    return "\n".join(
        [
            f"/* {face.name}: {_comment(face.text)}. Generated. */",
            "",
            "#include <math.h>",
            "",
            '#include "model.h"',
            "",
            "/* name, unit, kind, start, minimum, maximum, nominal, absolute, warn_above, rate */",
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


def _watched(face: Interface) -> list[Variable]:
    return [v for v in face.variables if _limit(v) < math.inf]


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
