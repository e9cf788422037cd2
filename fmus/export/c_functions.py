"""C functions from CasADi functions: one operation per line, with the names of the inputs as comments.

The generator of CasADi would test every argument for null and omit the names of the variables.

A function that a CasADi expression calls (`never_inline`) becomes a C function of its own, and so do its
derivatives. A call takes its vectors by pointer if their entries are consecutive. The opening curve has its C
code in templates/opening_curve.h.j2, because only one of its pieces must be evaluated.
"""

import math
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import accumulate

import casadi as ca

from fmus.called_functions import (
    Instruction,
    called,
    callee,
    input_bounds,
    instructions,
    output_bounds,
    rebuilt,
)
from fmus.contract import column
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
    **{
        getattr(ca, f"OP_{name.upper()}"): f"{name}({{}}, {{}})"
        for name in ("fmin", "fmax", "fmod", "remainder", "copysign", "atan2", "hypot")
    },
    ca.OP_IF_ELSE_ZERO: "where({} != 0.0, {})",
}
_FUNCTIONS = (
    *("sqrt", "exp", "log", "sin", "cos", "tan", "asin", "acos", "atan", "sinh", "cosh", "tanh"),
    *("asinh", "acosh", "atanh", "floor", "ceil", "fabs", "erf", "log1p", "expm1"),
)
_UNARY = {
    ca.OP_ASSIGN: "{0}",
    ca.OP_NEG: "-{0}",
    ca.OP_SQ: "{0} * {0}",
    ca.OP_TWICE: "2.0 * {0}",
    ca.OP_INV: "1.0 / {0}",
    ca.OP_NOT: "{0} == 0.0",
    ca.OP_SIGN: "({0} > 0.0) - ({0} < 0.0)",
    **{getattr(ca, f"OP_{name.upper()}"): f"{name}({{0}})" for name in _FUNCTIONS},
}


_VALUE = re.compile(r"const double ([vr]\d+) =")
_NAME = re.compile(r"\b[vr]\d+\b")


@dataclass(frozen=True)
class Routine:
    """A C function from named input vectors to named output vectors.

    vectorised   inputs and outputs of type `Columns` instead of double; then intermediate values are too
    scope        LOCAL, or SHARED between parts that are compiled apart
    """

    name: str
    inputs: Mapping[str, ca.SX]
    outputs: Mapping[str, ca.SX]
    vectorised: frozenset[str] = frozenset()
    scope: str = "LOCAL"


def c_function(r: Routine, names: Mapping[str, Sequence[str]]) -> str:
    """The C code of a routine, after that of the functions that it calls.

    names   input vector -> names of its entries, for comments
    """
    function = ca.Function("f", list(r.inputs.values()), list(r.outputs.values()), {"cse": True})
    calls = called(function)
    if calls and r.vectorised:
        raise Problem(f"{r.name}: a call of {calls[0].name()} is not supported for vectors of columns")
    types = {name: "Columns" if name in r.vectorised else "double" for name in (*r.inputs, *r.outputs)}
    text = f"{r.scope} {_definition(r.name, function, list(r.inputs), list(r.outputs), names, types)}"
    if r.vectorised:
        text = text.replace("    const double v", "    const Columns v")
    return "".join(_called_definition(f) for f in calls if f" {f.name()}(" in text) + text


def _definition(
    name: str,
    function: ca.Function,
    inputs: Sequence[str],
    outputs: Sequence[str],
    names: Mapping[str, Sequence[str]],
    types: Mapping[str, str],
) -> str:
    """The C function of a CasADi function; types: of the arguments that it has."""
    arguments = [f"const {types[n]} *{n}" for n in inputs if n in types]
    arguments += [f"{types[n]} *{n}" for n in outputs if n in types]
    program = instructions(function)
    used = {i[0] for operation, _, i in program if operation == ca.OP_INPUT}
    body = [f"(void){n};" for i, n in enumerate(inputs) if n in types and i not in used]
    body += [f"(void){n};" for i, n in enumerate(outputs) if n in types and function.nnz_out(i) == 0]
    body += _used(list(_statements(function, program, inputs, outputs, names)))
    text = "".join(f"    {line}\n" for line in body)
    return f"void {name}({', '.join(arguments)}) {{\n{text}}}\n"


def _used(lines: Sequence[str]) -> list[str]:
    """The lines without values that no later line uses: entries of vectors that a call takes by pointer."""
    kept: list[str] = []
    known = set[str]()
    for line in reversed(lines):
        value = _VALUE.match(line)
        if value is None or value[1] in known:
            kept.append(line)
            known.update(_NAME.findall(line))
    return kept[::-1]


def _statements(
    function: ca.Function,
    program: Sequence[Instruction],
    inputs: Sequence[str],
    outputs: Sequence[str],
    names: Mapping[str, Sequence[str]],
) -> Iterator[str]:
    inverse: dict[str, str] = {}  # C expression of a value -> that of its inverse
    constants: dict[str, float] = {}  # C literal -> its value
    least: dict[str, float] = {}  # C expression of a value -> a constant that it is never below
    work: dict[int, str] = {}  # index in the work vector of CasADi -> C expression of its current value
    origin: dict[int, tuple[int, int]] = {}  # index in the work vector -> input vector and entry
    written: set[tuple[int, int]] = set()
    calls = called(function)
    divisors = _common_divisors(program)
    rows = [
        function.sparsity_out(n).row() for n in range(len(outputs))
    ]  # of a sparse column some are missing
    for k, (operation, o, i) in enumerate(program):
        if operation == ca.OP_OUTPUT:
            written.add((o[0], o[1]))
            yield f"{outputs[o[0]]}[{rows[o[0]][o[1]]}] = {work[i[0]]};"
            continue
        if operation == ca.OP_CALL:
            addresses = (origin.get(j) for j in i)
            pointers = [address and (inputs[address[0]], address[1]) for address in addresses]
            call = _Call(k, callee(calls, i, o), [work[j] for j in i], pointers, o)
            yield from call.statements()
            results = call.results()
        elif operation == ca.OP_CONST:
            constant = function.instruction_constant(k)
            results = {o[0]: number(constant)}
            constants[number(constant)] = constant
        else:
            has_name = operation == ca.OP_INPUT and inputs[i[0]] in names
            comment = f" /* {names[inputs[i[0]]][i[1]]} */" if has_name else ""
            yield f"const double v{k} = {_expression(operation, i, inputs, work, inverse, least)};{comment}"
            results = {o[0]: f"v{k}"}
            if operation == ca.OP_FMAX:
                least |= {f"v{k}": constants[work[j]] for j in i if work[j] in constants}
            if k in divisors:
                inverse[f"v{k}"] = f"r{k}"
                yield f"const double r{k} = 1.0 / v{k};"
        for j, value in results.items():
            work[j] = value
            origin.pop(j, None)
        if operation == ca.OP_INPUT:
            origin[o[0]] = (i[0], i[1])
    for n, name in enumerate(outputs):
        for j in range(function.nnz_out(n)):
            if (n, j) not in written:
                yield f"{name}[{rows[n][j]}] = 0.0;"


def _common_divisors(program: Sequence[Instruction]) -> set[int]:
    """The instructions whose results several others divide by."""
    made: dict[int, int] = {}  # index in the work vector of CasADi -> the instruction that made its value
    count = Counter[int]()
    for k, (operation, o, i) in enumerate(program):
        if operation in (ca.OP_DIV, ca.OP_INV):
            count[made[i[-1]]] += 1
        if operation != ca.OP_OUTPUT:
            made.update(dict.fromkeys(o, k))
    return {k for k, uses in count.items() if uses > 1}


def _expression(
    operation: int,
    i: Sequence[int],
    inputs: Sequence[str],
    work: Mapping[int, str],
    inverse: Mapping[str, str],
    least: Mapping[str, float],
) -> str:
    if operation == ca.OP_INPUT:
        return f"{inputs[i[0]]}[{i[1]}]"
    if operation == ca.OP_INV and work[i[0]] in inverse:
        return inverse[work[i[0]]]
    if operation == ca.OP_DIV and work[i[1]] in inverse:
        return f"{work[i[0]]} * {inverse[work[i[1]]]}"
    if operation == ca.OP_EXP and work[i[0]] in least:
        bound = least[work[i[0]]]
        return f"exp_above({work[i[0]]}, {number(bound)}, {number(math.exp(bound))})"
    if operation in _UNARY:
        return str(_UNARY[operation].format(work[i[0]]))
    if operation in _BINARY:
        return str(_BINARY[operation].format(work[i[0]], work[i[1]]))
    raise Problem(
        f"operation {operation} of CasADi is not supported in C code, expected elementary functions"
    )


def number(value: float) -> str:
    """A C literal of exactly this double; negative ones are in parentheses."""
    if value != value or value in (float("inf"), float("-inf")):
        return {"nan": "NAN", "inf": "INFINITY", "-inf": "(-INFINITY)"}[str(float(value))]
    text = repr(float(value))
    return f"({text})" if text.startswith("-") else text


# ---- called functions ------------------------------------------------------------------------------

_CURVE = "opening_curve"
_BY_HAND = {_CURVE: _CURVE, f"fwd1_{_CURVE}": f"{_CURVE}_slope"}


@dataclass(frozen=True)
class _Call:
    """A call in a C function.

    index       of the instruction
    arguments   C expressions of the entries of all inputs, one after the other
    pointers    for each of these entries its address as (vector, offset), or None
    outputs     indices in the work vector of the results; -1 for one that is not used
    """

    index: int
    function: ca.Function
    arguments: Sequence[str]
    pointers: Sequence[tuple[str, int] | None]
    outputs: Sequence[int]

    def _zero(self, bounds: tuple[int, int]) -> bool:
        return all(value == number(0.0) for value in self.arguments[slice(*bounds)])

    def _by_hand(self) -> str:
        """The expression with a function of opening_curve.h; empty if there is none for this call."""
        name, bounds = self.function.name(), input_bounds(self.function)
        if name not in _BY_HAND:
            return ""
        command = self.arguments[bounds[0][0]]
        value = f"{_BY_HAND[name]}({command}, {self._vector(1, bounds[1])})"
        if name == _CURVE:
            return value
        if not self._zero(bounds[4]):
            given = (command, self._vector(1, bounds[1]), self.arguments[bounds[3][0]])
            return f"{_CURVE}_along({', '.join(given)}, {self._vector(4, bounds[4])})"
        return f"{value} * {self.arguments[bounds[3][0]]}"

    def _vector(self, n: int, bounds: tuple[int, int]) -> str:
        """The C expression of an input vector: the address of its first entry if all are consecutive."""
        pointers = self.pointers[slice(*bounds)]
        first = pointers[0]
        if first and list(pointers) == [(first[0], first[1] + j) for j in range(len(pointers))]:
            return f"{first[0]} + {first[1]}"
        return f"a{self.index}_{n}"

    def statements(self) -> Iterator[str]:
        """The lines of the call."""
        expression = self._by_hand()
        inputs = [(n, b) for n, b in enumerate(input_bounds(self.function)) if b[0] < b[1]]
        for n, bounds in inputs:
            vector = self._vector(n, bounds)
            if vector == f"a{self.index}_{n}" and not (expression and vector not in expression):
                yield f"const double {vector}[] = {{{', '.join(self.arguments[slice(*bounds)])}}};"
        if expression:
            yield f"const double v{self.index} = {expression};"
            return
        outputs = [(n, b[1] - b[0]) for n, b in enumerate(output_bounds(self.function)) if b[0] < b[1]]
        for n, length in outputs:
            yield f"double r{self.index}_{n}[{length}];"
        vectors = [self._vector(n, bounds) for n, bounds in inputs]
        vectors += [f"r{self.index}_{n}" for n, _ in outputs]
        yield f"{self.function.name()}({', '.join(vectors)});"

    def results(self) -> dict[int, str]:
        """Index in the work vector -> C expression of the result."""
        if self._by_hand():
            return {o: f"v{self.index}" for o in self.outputs if o >= 0}
        names = [
            f"r{self.index}_{n}[{j}]"
            for n, (first, end) in enumerate(output_bounds(self.function))
            for j in range(end - first)
        ]
        return {o: name for o, name in zip(self.outputs, names, strict=True) if o >= 0}


def _called_definition(function: ca.Function) -> str:
    """The C function of a called function, once in all files; none for what is written by hand."""
    name = function.name()
    if name == _CURVE:
        return ""
    inputs = [f"i{n}" for n in range(function.n_in())]
    outputs = [f"o{n}" for n in range(function.n_out())]
    kept = [n for k, n in enumerate(inputs) if function.nnz_in(k)]
    kept += [n for k, n in enumerate(outputs) if function.nnz_out(k)]
    types = dict.fromkeys(kept, "double")
    text = "".join(map(_called_definition, called(function)))
    text += f"LOCAL {_definition(name, function, inputs, outputs, {}, types)}"
    return f"#ifndef CALLED_{name}\n#define CALLED_{name}\n{text}#endif\n"


# ---- subexpressions of the parameters --------------------------------------------------------------


def split(values: ca.SX, like: Iterable[ca.SX]) -> list[ca.SX]:
    """The column split into parts with the lengths of `like`."""
    return list(ca.vertsplit(ca.densify(values), [0, *accumulate(part.numel() for part in like)]))


def hoist(expressions: Mapping[str, ca.SX], p: ca.SX) -> tuple[dict[str, ca.SX], ca.SX, ca.SX]:
    """Replaces subexpressions that depend on the parameters p alone by symbols c.

    Returns the new expressions, c, and the subexpressions. Those that a call takes as one vector are
    consecutive.

    expressions   dense columns
    """
    all_rows, inverses, divisors = _by_multiplication(ca.cse(ca.vertcat(*expressions.values())), p)
    reduced, symbols, subexpressions = ca.extract_parametric(all_rows, ca.vertcat(p, inverses))
    symbols = [*symbols, *ca.vertsplit(inverses)]
    subexpressions = [*subexpressions, *ca.vertsplit(1 / divisors)]
    order = _call_order(reduced, symbols)
    c, prepared = (column(*(values[i] for i in order)) for values in (symbols, subexpressions))
    while ca.depends_on(prepared, c):  # subexpressions of subexpressions
        prepared = ca.substitute(prepared, c, prepared)
    return dict(zip(expressions, split(reduced, expressions.values()), strict=True)), c, prepared


def _by_multiplication(values: ca.SX, p: ca.SX) -> tuple[ca.SX, ca.SX, ca.SX]:
    """Replaces divisions by subexpressions of the parameters alone by multiplications with new symbols.

    Calls that give zero are gone afterwards, too. Returns the new values, the symbols, and the divisors,
    whose inverses the symbols are.
    """
    symbols: list[ca.SX] = []
    divisors: list[ca.SX] = []
    known: dict[int, ca.SX] = {}  # hash of a divisor -> its symbol

    def quotient(a: ca.SX, b: ca.SX) -> ca.SX:
        if b.is_constant():
            return a / b
        if b.element_hash() not in known:
            known[b.element_hash()] = ca.SX.sym("inverse")
            symbols.append(known[b.element_hash()])
            divisors.append(b)
        return a * known[b.element_hash()]

    new = rebuilt(values, p, quotient)
    return new, column(*symbols), column(*divisors)


def _call_order(expression: ca.SX, symbols: Sequence[ca.SX]) -> list[int]:
    """Indices of all symbols, those that a call takes as one vector one after the other."""
    others = [s for s in ca.symvar(expression)]
    c, known = column(*symbols), {s.element_hash() for s in symbols}
    rest = column(*(s for s in others if s.element_hash() not in known))
    function = ca.Function("f", [c, rest], [expression])
    calls, order, entry = called(function), list[int](), dict[int, int]()
    for operation, o, i in instructions(function) if calls else ():
        if operation == ca.OP_CALL:
            for first, end in input_bounds(callee(calls, i, o)):
                vector = [entry[j] for j in i[first:end] if j in entry]
                if len(vector) == end - first > 1 and not set(vector) & set(order):
                    order += vector
        if operation != ca.OP_OUTPUT:
            for j in o:
                entry.pop(j, None)
        if operation == ca.OP_INPUT and i[0] == 0:
            entry[o[0]] = i[1]
    return order + [n for n in range(len(symbols)) if n not in set(order)]
