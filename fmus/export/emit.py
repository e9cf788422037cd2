"""CasADi expressions as C99 statements.

CasADi's own generator tests every argument for null and hides the names of the variables; here the
operations of a CasADi function are written one per line, inputs by name, results as they are used.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import casadi as ca

from fmus.contract import ModelError

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
    raise ModelError(f"operation {operation} of CasADi has no C here, expected elementary functions")


def number(value: float) -> str:
    """A C literal that reads back as the same double; negative ones in parentheses."""
    if value != value or value in (float("inf"), float("-inf")):
        return {"nan": "NAN", "inf": "INFINITY", "-inf": "(-INFINITY)"}[str(float(value))]
    text = repr(float(value))
    return f"({text})" if text.startswith("-") else text
