"""What an FMU shows of a subsystem: its variables, and which of them depend on which.

Value references are consecutive: parameters, inputs, states, derivatives, outputs; native/model.h
relies on that order. An output that is a state is one variable, with the state's reference.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import casadi as ca

from fmus.contract import Quantity, Subsystem, Symbolic, quantities, symbolic
from fmus.parameters import Values
from orchestrator.base.errors import Problem
from orchestrator.base.units import per_second

_IDENTIFIER = r"[A-Za-z][A-Za-z0-9_]*"
Kind = Literal["FIXED", "TUNABLE", "INPUT", "STATE", "CALCULATED_STATE", "DERIVATIVE", "OUTPUT"]


@dataclass(frozen=True)
class Variable:
    """One scalar variable; `start` is None where the model calculates it."""

    name: str
    kind: Kind
    quantity: Quantity
    start: float | None
    reference: int = 0
    output: bool = False  # shown with causality output


@dataclass(frozen=True)
class Interface:
    """The variables by group, and the equations they belong to."""

    name: str
    text: str
    parameters: Sequence[Variable]
    inputs: Sequence[Variable]
    states: Sequence[Variable]
    derivatives: Sequence[Variable]
    outputs: Sequence[Variable]  # without those that are states
    equations: Symbolic
    y: ca.SX  # of `outputs`, shape (n, 1)
    stiff: bool = True  # as in the subsystem

    @property
    def variables(self) -> list[Variable]:
        """All variables in the order of their value references."""
        return [*self.parameters, *self.inputs, *self.states, *self.derivatives, *self.outputs]


def interface(sub: Subsystem, values: Values) -> Interface:
    """The variables of a subsystem with start values; refuses names and numbers that cannot be in an FMU."""
    sym, parameters = _by_heading(symbolic(sub), quantities(sub.parameters))
    states, outputs = quantities(sub.states), quantities(sub.outputs)
    merged = [name for name in outputs if name in states]
    _check_states_as_outputs(sub, sym, merged)
    groups = [
        [
            Variable(name, "TUNABLE" if q.tunable else "FIXED", q, values.p[name])
            for name, q in parameters.items()
        ],
        [Variable(name, "INPUT", q, values.u[name]) for name, q in quantities(sub.inputs).items()],
        [_state(name, q, outputs.get(name), sym, values) for name, q in states.items()],
        [Variable(f"der_{name}", "DERIVATIVE", _derivative(name, q), None) for name, q in states.items()],
        [Variable(name, "OUTPUT", q, None, output=True) for name, q in outputs.items() if name not in states],
    ]
    keep = [i for i, name in enumerate(outputs) if name not in states]
    return replace(assembled(sub.name, sub.text, groups, sym, _pick(sym.y, keep)), stiff=sub.stiff)


def _by_heading(sym: Symbolic, declared: Mapping[str, Quantity]) -> tuple[Symbolic, dict[str, Quantity]]:
    """Parameters of one heading together, headings as they come first; without one before all others."""
    headings = ["", *dict.fromkeys(q.group for q in declared.values())]
    names = sorted(declared, key=lambda name: headings.index(declared[name].group))
    rows = [list(declared).index(name) for name in names]
    return replace(sym, p=_pick(sym.p, rows)), {name: declared[name] for name in names}


def assembled(
    name: str, text: str, groups: Sequence[Sequence[Variable]], equations: Symbolic, y: ca.SX
) -> Interface:
    """An interface of parameters, inputs, states, derivatives and outputs, numbered and checked."""
    parameters, inputs, x, dx, outputs = _numbered(groups)
    result = Interface(name, text, parameters, inputs, x, dx, outputs, equations, y)
    _check_names(result)
    _check_numbers(result)
    return result


def _pick(column: ca.SX, rows: Sequence[int]) -> ca.SX:
    """Some entries of a column, shape (n, 1); CasADi's own indexing gives (1, 0) for none of one."""
    return ca.vertcat(*[column[i] for i in rows]) if rows else ca.SX(0, 1)


def _state(name: str, q: Quantity, shown: Quantity | None, sym: Symbolic, values: Values) -> Variable:
    calculated = name in sym.calculated
    start = None if calculated else values.x[name]
    kind: Kind = "CALCULATED_STATE" if calculated else "STATE"
    if shown is not None and shown.warn_above is not None:
        q = replace(q, warn_above=shown.warn_above)
    return Variable(name, kind, q, start, output=shown is not None)


def _derivative(name: str, q: Quantity) -> Quantity:
    return Quantity(per_second(q.unit), f"Time derivative of {name}", q.nominal)


def _numbered(groups: Sequence[Sequence[Variable]]) -> list[list[Variable]]:
    result, reference = [], 0
    for group in groups:
        result.append([replace(v, reference=reference + i) for i, v in enumerate(group)])
        reference += len(group)
    return result


def _check_states_as_outputs(sub: Subsystem, sym: Symbolic, merged: Sequence[str]) -> None:
    states, outputs = list(quantities(sub.states)), list(quantities(sub.outputs))
    for name in merged:
        if not ca.is_equal(sym.y[outputs.index(name)], sym.x[states.index(name)]):
            raise Problem(
                f"{sub.name}: output {name} is also a state, expected observe() to return that state"
            )


def _check_names(face: Interface) -> None:
    seen: set[str] = set()
    if not re.fullmatch(_IDENTIFIER, face.name):
        raise Problem(f'"{face.name}" is not an identifier of letters, digits and _, expected of a model')
    for v in face.variables:
        if not re.fullmatch(_IDENTIFIER, v.name):
            raise Problem(f'{face.name}: variable "{v.name}" is not an identifier of letters, digits and _')
        if v.name in seen:
            raise Problem(f"{face.name}: variable {v.name} is declared twice")
        seen.add(v.name)
    inputs = {v.name for v in face.inputs}
    for v in face.inputs:
        if v.quantity.rate is not None and v.quantity.rate not in inputs:
            raise Problem(f"{face.name}: rate of input {v.name} is {v.quantity.rate}, expected an input")


def _check_numbers(face: Interface) -> None:
    for v in face.variables:
        low, high = v.quantity.minimum, v.quantity.maximum
        if not 0 < v.quantity.nominal < math.inf:
            raise Problem(f"{face.name}: nominal of {v.name} is {v.quantity.nominal:g}, expected > 0")
        if v.start is None:
            continue
        low, high = -math.inf if low is None else low, math.inf if high is None else high
        if not math.isfinite(v.start) or not low <= v.start <= high:
            raise Problem(f"{face.name}: {v.name} starts at {v.start:g}, expected {low:g} to {high:g}")


# ---- dependencies ----------------------------------------------------------------------------------

_STEPS = {
    *(ca.OP_LT, ca.OP_LE, ca.OP_EQ, ca.OP_NE, ca.OP_NOT, ca.OP_AND, ca.OP_OR, ca.OP_IF_ELSE_ZERO),
    *(ca.OP_FLOOR, ca.OP_CEIL, ca.OP_FMOD, ca.OP_REMAINDER, ca.OP_SIGN, ca.OP_COPYSIGN),
}
Dependencies = Mapping[str, list[tuple[Variable, str]]]


def dependencies(face: Interface) -> Dependencies:
    """Inputs and states on which derivatives and outputs depend, with FMI's kind of each dependency."""
    sym = face.equations
    known = ca.vertcat(sym.x, sym.u)
    variables = [*face.states, *face.inputs]
    unknown = ca.vertcat(sym.dx, face.y)
    table = _table([*face.derivatives, *face.outputs], unknown, known, variables, face)
    for v in face.states:
        table[v.name] = [(v, "constant")]
    return table


def initial_dependencies(face: Interface) -> Dependencies:
    """Parameters, inputs and start values on which states, derivatives and outputs depend at the start."""
    sym = face.equations
    known = ca.vertcat(sym.p, sym.u, sym.x)
    variables = [*face.parameters, *face.inputs, *face.states]
    at_start = ca.substitute(ca.vertcat(sym.x, sym.dx, face.y), sym.x, sym.start)
    return _table([*face.states, *face.derivatives, *face.outputs], at_start, known, variables, None)


def _table(
    rows: Sequence[Variable],
    unknown: ca.SX,
    known: ca.SX,
    columns: Sequence[Variable],
    face: Interface | None,
) -> dict[str, list[tuple[Variable, str]]]:
    jacobian = ca.jacobian(unknown, known)
    kinds = _kinds(jacobian, face) if face else ["dependent"] * jacobian.nnz()
    stepwise = [_has_steps(unknown[i], known) for i in range(unknown.numel())]
    table: dict[str, list[tuple[Variable, str]]] = {v.name: [] for v in rows}
    for (row, column), kind in zip(_places(jacobian), kinds, strict=True):
        table[rows[row].name].append((columns[column], "dependent" if stepwise[row] else kind))
    return table


def _has_steps(value: ca.SX, known: ca.SX) -> bool:
    """Is there a comparison or the like, whose derivative tells nothing of the dependency on it?"""
    function = ca.Function("f", [known], [value], {"allow_free": True})
    return any(function.instruction_id(k) in _STEPS for k in range(function.n_instructions()))


def _places(matrix: ca.SX) -> list[tuple[int, int]]:
    """Row and column of each structural nonzero, in CasADi's order."""
    rows, columns = matrix.sparsity().get_triplet()
    return list(zip(rows, columns, strict=True))


def _kinds(jacobian: ca.SX, face: Interface) -> list[str]:
    """constant, fixed, tunable or dependent: what the factor of each dependency itself depends on."""
    sym = face.equations
    entries = ca.SX(jacobian.nz[:])
    tunable = [i for i, v in enumerate(face.parameters) if v.kind == "TUNABLE"]
    fixed = [i for i, v in enumerate(face.parameters) if v.kind == "FIXED"]
    kinds = ["constant"] * jacobian.nnz()
    for kind, symbols in (
        ("fixed", _pick(sym.p, fixed)),
        ("tunable", _pick(sym.p, tunable)),
        ("dependent", ca.vertcat(sym.x, sym.u)),
    ):
        for row in set(ca.jacobian_sparsity(entries, symbols).get_triplet()[0]):
            kinds[row] = kind
    return kinds
