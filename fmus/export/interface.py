"""FMI interface of a subsystem: its variables with value references, and the dependencies between them.

Value references are consecutive: parameters, inputs, states, derivatives, outputs. native/model.h relies on
this order. An output that is a state is one variable, with the value reference of the state.
"""

import math
import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import count
from typing import Literal

import casadi as ca

from fmus.contract import Quantity, Subsystem, Symbolic, column, quantities, symbolic
from fmus.parameters import Number, Values, not_shipped
from orchestrator.base.errors import Problem
from orchestrator.base.units import per_second

_IDENTIFIER = r"[A-Za-z][A-Za-z0-9_]*"
_NOT_AN_IDENTIFIER = "is not an identifier, expected a letter, then letters, digits or _"
Kind = Literal["FIXED", "TUNABLE", "INPUT", "STATE", "CALCULATED_STATE", "DERIVATIVE", "OUTPUT"]


@dataclass(frozen=True)
class Variable:
    """One scalar variable; `start` is None if the model calculates its initial value."""

    name: str
    kind: Kind
    quantity: Quantity
    start: float | None
    reference: int = 0
    output: bool = False  # whether its causality is output

    @property
    def watched(self) -> bool:
        """Whether the FMU warns of values beyond a limit."""
        return self.quantity.watched and (self.output or self.kind == "INPUT")


@dataclass(frozen=True)
class Interface:
    """The variables by group, and the equations of the model."""

    name: str
    description: str
    parameters: Sequence[Variable]
    inputs: Sequence[Variable]
    states: Sequence[Variable]
    derivatives: Sequence[Variable]
    outputs: Sequence[Variable]  # except those that are states
    equations: Symbolic
    y: ca.SX  # expressions of `outputs`, shape (n, 1)
    stiff: bool = True  # see `Subsystem`
    sampling: float = 0.0  # see `Subsystem`
    in_python: bool = False  # whether the code is Python, without equations
    not_shipped: Mapping[str, Number] = field(default_factory=dict)  # see `parameters.not_shipped`

    @property
    def groups(self) -> tuple[Sequence[Variable], ...]:
        """Parameters, inputs, states, derivatives and outputs."""
        return self.parameters, self.inputs, self.states, self.derivatives, self.outputs

    @property
    def variables(self) -> list[Variable]:
        """All variables in the order of their value references."""
        return [v for group in self.groups for v in group]


def interface_of(sub: Subsystem, values: Values) -> Interface:
    """The interface of a subsystem with these values; raises Problem for a name or value not allowed."""
    sym, parameters = _sorted_by_heading(symbolic(sub), quantities(sub.parameters))
    states, outputs = quantities(sub.states), quantities(sub.outputs)
    for i, name in enumerate(outputs):
        if name in states and not ca.is_equal(sym.y[i], sym.x[list(states).index(name)]):
            raise Problem(
                f"{sub.name}: output {name} is also a state, expected observe() to return that state"
            )
    groups = variable_groups((parameters, quantities(sub.inputs), states, outputs), values, sym.calculated)
    rows = [i for i, name in enumerate(outputs) if name not in states]
    interface = make_interface(sub.name, sub.text, groups, sym, column(*(sym.y[i] for i in rows)))
    others = not_shipped(sub) if sub.numbers else {}
    return replace(interface, stiff=sub.stiff, sampling=sub.sampling, not_shipped=others)


def _sorted_by_heading(
    sym: Symbolic, declared: Mapping[str, Quantity]
) -> tuple[Symbolic, dict[str, Quantity]]:
    """Parameters sorted by `Quantity.group`, their heading in the documentation.

    Headings are in the order of their first use; parameters without a heading come first.
    """
    headings = ["", *dict.fromkeys(q.group for q in declared.values())]
    names = sorted(declared, key=lambda name: headings.index(declared[name].group))
    rows = [list(declared).index(name) for name in names]
    return replace(sym, p=column(*(sym.p[i] for i in rows))), {name: declared[name] for name in names}


def variable_groups(
    declared: Sequence[Mapping[str, Quantity]],
    values: Values,
    calculated: Collection[str],
    derivatives: bool = True,
) -> list[list[Variable]]:
    """The groups of an `Interface`, without value references.

    declared     parameters, inputs, states and outputs; an output with the name of a state is that state,
                 not a variable of its own
    calculated   states whose initial value the model calculates
    derivatives  whether the states have derivatives
    """
    parameters, inputs, states, outputs = declared

    def state(name: str, q: Quantity) -> Variable:
        output = outputs.get(name)
        if output is not None and output.watched:
            limits = {n: getattr(output, n) for n in ("warn_above", "warn_below", "meaning", "below")}
            q = replace(q, **limits)
        if name in calculated:
            return Variable(name, "CALCULATED_STATE", q, None, output=output is not None)
        return Variable(name, "STATE", q, values.x[name], output=output is not None)

    def derivative(name: str, q: Quantity) -> Variable:
        rate = Quantity(per_second(q.unit), f"Time derivative of {name}", q.nominal)
        return Variable(f"der_{name}", "DERIVATIVE", rate, None)

    return [
        [Variable(n, "TUNABLE" if q.tunable else "FIXED", q, values.p[n]) for n, q in parameters.items()],
        [Variable(n, "INPUT", q, values.u[n]) for n, q in inputs.items()],
        [state(n, q) for n, q in states.items()],
        [derivative(n, q) for n, q in states.items() if derivatives],
        [Variable(n, "OUTPUT", q, None, output=True) for n, q in outputs.items() if n not in states],
    ]


def make_interface(
    name: str, description: str, groups: Sequence[Sequence[Variable]], equations: Symbolic, y: ca.SX
) -> Interface:
    """An interface with value references for the variables of `groups`, checked.

    groups   parameters, inputs, states, derivatives and outputs
    """
    references = count()
    p, u, x, dx, out = ([replace(v, reference=next(references)) for v in group] for group in groups)
    interface = Interface(name, description, p, u, x, dx, out, equations, y)
    _check_names(interface)
    _check_values(interface)
    return interface


def _check_names(interface: Interface) -> None:
    name, seen = interface.name, set[str]()
    if not re.fullmatch(_IDENTIFIER, name):
        raise Problem(f'model name "{name}" {_NOT_AN_IDENTIFIER}')
    for v in interface.variables:
        if not re.fullmatch(_IDENTIFIER, v.name):
            raise Problem(f'{name}: variable "{v.name}" {_NOT_AN_IDENTIFIER}')
        if v.name in seen:
            raise Problem(f"{name}: variable {v.name} is declared twice")
        seen.add(v.name)
    inputs = {v.name for v in interface.inputs}
    for v in interface.inputs:
        if v.quantity.rate is not None and v.quantity.rate not in inputs:
            raise Problem(f"{name}: rate of input {v.name} is {v.quantity.rate}, expected an input")


def _check_values(interface: Interface) -> None:
    for v in interface.variables:
        if not 0 < v.quantity.nominal < math.inf:
            raise Problem(
                f"{interface.name}: nominal of {v.name} is {v.quantity.nominal:g}, "
                "expected a finite number above 0"
            )
        if v.start is None:
            continue
        low, high = v.quantity.minimum, v.quantity.maximum
        low, high = -math.inf if low is None else low, math.inf if high is None else high
        if not math.isfinite(v.start) or not low <= v.start <= high:
            raise Problem(f"{interface.name}: {v.name} starts at {v.start:g}, expected {low:g} to {high:g}")


# ---- dependencies ----------------------------------------------------------------------------------

_DISCONTINUOUS = {
    *(ca.OP_LT, ca.OP_LE, ca.OP_EQ, ca.OP_NE, ca.OP_NOT, ca.OP_AND, ca.OP_OR, ca.OP_IF_ELSE_ZERO),
    *(ca.OP_FLOOR, ca.OP_CEIL, ca.OP_FMOD, ca.OP_REMAINDER, ca.OP_SIGN, ca.OP_COPYSIGN),
}
Dependencies = Mapping[str, list[tuple[Variable, str]]]


def dependencies(interface: Interface) -> Dependencies:
    """Derivatives, outputs, states -> inputs and states that they depend on, each with its dependenciesKind.

    A state depends on itself; ModelStructure contains those that are outputs.
    """
    sym, rows = interface.equations, [*interface.derivatives, *interface.outputs]
    unknown, known = ca.vertcat(sym.dx, interface.y), ca.vertcat(sym.x, sym.u)
    table = _dependency_table(rows, unknown, known, [*interface.states, *interface.inputs], interface)
    for v in interface.states:
        table[v.name] = [(v, "constant")]
    return table


def initial_dependencies(interface: Interface) -> Dependencies:
    """Initial states, derivatives and outputs -> parameters, inputs and start values that they depend on.

    Every dependenciesKind is "dependent": of the other kinds, FMI allows only "constant" in InitialUnknowns.
    """
    sym, rows = interface.equations, [*interface.states, *interface.derivatives, *interface.outputs]
    variables = [*interface.parameters, *interface.inputs, *interface.states]
    at_start = ca.substitute(ca.vertcat(sym.x, sym.dx, interface.y), sym.x, sym.start)
    return _dependency_table(rows, at_start, ca.vertcat(sym.p, sym.u, sym.x), variables, None)


def _dependency_table(
    rows: Sequence[Variable],
    unknown: ca.SX,
    known: ca.SX,
    columns: Sequence[Variable],
    interface: Interface | None,
) -> dict[str, list[tuple[Variable, str]]]:
    """Row -> columns that it depends on, each with its dependenciesKind; without `interface`: "dependent"."""
    sparsity = ca.jacobian_sparsity(unknown, known)
    kinds = ["dependent"] * sparsity.nnz()
    if interface:
        jacobian = ca.jacobian(unknown, known)
        sparsity, kinds = jacobian.sparsity(), _dependency_kinds(jacobian, interface)
    discontinuous = [_is_discontinuous(unknown[i], known) for i in range(unknown.numel())]
    table: dict[str, list[tuple[Variable, str]]] = {v.name: [] for v in rows}
    for row, known_column, kind in zip(*sparsity.get_triplet(), kinds, strict=True):
        table[rows[row].name].append((columns[known_column], "dependent" if discontinuous[row] else kind))
    return table


def _is_discontinuous(value: ca.SX, known: ca.SX) -> bool:
    """Whether an operation in the expression may be discontinuous, which its derivative does not show."""
    function = ca.Function("f", [known], [value], {"allow_free": True})
    return any(function.instruction_id(k) in _DISCONTINUOUS for k in range(function.n_instructions()))


def _dependency_kinds(jacobian: ca.SX, interface: Interface) -> list[str]:
    """The dependenciesKind of each nonzero: constant, fixed, tunable or dependent, by what it depends on."""
    sym = interface.equations
    entries = ca.SX(jacobian.nz[:])
    tunable = [i for i, v in enumerate(interface.parameters) if v.kind == "TUNABLE"]
    fixed = [i for i, v in enumerate(interface.parameters) if v.kind == "FIXED"]
    kinds = ["constant"] * jacobian.nnz()
    for kind, symbols in (
        ("fixed", column(*(sym.p[i] for i in fixed))),
        ("tunable", column(*(sym.p[i] for i in tunable))),
        ("dependent", ca.vertcat(sym.x, sym.u)),
    ):
        for row in set(ca.jacobian_sparsity(entries, symbols).get_triplet()[0]):
            kinds[row] = kind
    return kinds
