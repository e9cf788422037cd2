"""Subsystems and their connections as one `Subsystem`: a whole machine in one FMU, without coupling error.

The equations are those of `fmus.coupled`, the names those of `fmus.flat`.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import make_dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import casadi as ca

from fmus.contract import (
    ModelError,
    Quantity,
    Scalar,
    Subsystem,
    Terminal,
    column,
    never,
    quantities,
    stack,
    unstack,
)
from fmus.coupled import Coupled, couple
from fmus.flat import Names, declared, flat_names
from fmus.parameters import Number, Tables, numbers

Inputs = Mapping[str, Sequence[str]]  # input of the whole -> `component.variable` that it feeds


def joined(
    name: str,
    text: str,
    subsystems: Mapping[str, Subsystem],
    connections: Sequence[tuple[str, str]],
    inputs: Inputs,
    tables: Mapping[str, Tables] | None = None,
    *,
    folder: Path,
    hidden: Collection[str] = (),
    totals: Collection[str] = (),
    texts: Mapping[str, str] | None = None,
    terminals: tuple[Terminal, ...] = (),
) -> Subsystem:
    """Join subsystems by (source output, target input) pairs; inputs fed by nobody keep their start value.

    Components that have a `corner` are refused: the whole would not tell it.

    tables   numbers by component; by default those of its parameters.toml
    folder   where README.md and icon.png are
    hidden   outputs, `component.variable`, that nobody outside needs
    totals   names that several components give to an output, of which the sum is shown
    texts    output of the whole -> what it is, where the words of the component do not fit
    """
    told = [n for n, sub in subsystems.items() if sub.corner is not never]
    if told:
        raise ModelError(f"{name}: {told[0]} has corners, expected components without")
    tables = tables or {n: numbers(sub) for n, sub in subsystems.items()}
    start = {f"{c}.{v}": number for c, t in tables.items() for v, number in t["start"].items()}
    whole = couple(subsystems, connections, inputs, {v: number.value for v, number in start.items()})
    names = flat_names(subsystems, tables, inputs, totals, hidden)
    parameters, states, outputs = (declared(subsystems, g) for g in ("parameters", "states", "outputs"))
    visible = _shown({v: q for v, q in outputs.items() if v not in hidden}, names)
    visible |= {v: replace(visible[v], text=words) for v, words in (texts or {}).items()}
    groups = {
        "parameters": _shown(parameters, names),
        "states": _shown(states, names),
        "inputs": _fed(name, declared(subsystems, "inputs"), inputs, start),
        "outputs": visible,
    }
    types: dict[str, Any] = {group: _type(f"{name}_{group}", members) for group, members in groups.items()}
    return Subsystem(
        name=name,
        text=text,
        **types,
        **_equations(whole, names, types["states"], types["outputs"]),
        values=folder / "parameters.toml",
        numbers=_numbers(tables, names, inputs),
        terminals=terminals,
    )


def _shown(members: Mapping[str, Quantity], names: Names) -> dict[str, Quantity]:
    """By their names in the whole; of several with one name the first counts."""
    found: dict[str, Quantity] = {}
    for variable, quantity in members.items():
        found.setdefault(names[variable], quantity)
    return found


def _fed(
    name: str, members: Mapping[str, Quantity], inputs: Inputs, start: Mapping[str, Number]
) -> dict[str, Quantity]:
    """The inputs of the whole, as the first target declares them; rates by their names in the whole."""
    found: dict[str, Quantity] = {}
    for own, targets in inputs.items():
        first = members[targets[0]]
        for t in targets:
            if (members[t].unit, _value(start, t)) != (first.unit, _value(start, targets[0])):
                raise ModelError(
                    f"{name}: {own} feeds {targets[0]} and {t}, expected one unit and start value"
                )
        rate = targets[0].partition(".")[0] + f".{first.rate}"
        found[own] = replace(first, rate=next((n for n, ends in inputs.items() if rate in ends), None))
    return found


def _value(start: Mapping[str, Number], variable: str) -> float:
    return start[variable].value if variable in start else 0.0


def _type(name: str, members: Mapping[str, Quantity]) -> type[Any]:
    """A variable group with these fields."""
    return make_dataclass(name, [(n, Annotated[Scalar, q]) for n, q in members.items()], frozen=True)


def _numbers(tables: Mapping[str, Tables], names: Names, inputs: Inputs) -> Tables:
    """The numbers of the whole; of several with one name the first counts, the value is the same."""
    ends = {**names} | {targets[0]: own for own, targets in inputs.items()}
    found: dict[str, dict[str, Number]] = {"parameters": {}, "start": {}}
    for component, sections in tables.items():
        for section, entries in sections.items():
            for variable, number in entries.items():
                if f"{component}.{variable}" in ends:
                    found[section].setdefault(ends[f"{component}.{variable}"], number)
    return found


_DEEP = 9  # levels down to which two requirements with the same text are compared


def _equations(whole: Coupled, names: Names, states: type[Any], outputs: type[Any]) -> dict[str, Any]:
    """The functions of the contract by name, over the groups of the whole."""
    rows = {n: [i for i, v in enumerate(whole.outputs) if names.get(v) == n] for n in quantities(outputs)}
    shown = column(*(sum(whole.y[i] for i in found) for found in rows.values()))
    f, g = whole.function("f", whole.dx), whole.function("g", shown)
    s, r = whole.function("s", whole.start), whole.function("r", whole.require)

    def known(x: Any, u: Any, p: Any) -> tuple[Any, Any, Any]:
        return stack(x), stack(u), column(*(getattr(p, names[v]) for v in whole.parameters))

    def initial(x: Any, u: Any, p: Any) -> dict[str, Scalar]:
        found = s(*known(x, u, p))
        return {names[v]: found[whole.states.index(v)] for v in whole.calculated}

    def require(x: Any, u: Any, p: Any) -> dict[str, Scalar]:
        found = r(*known(x, u, p))
        statements: dict[str, Scalar] = {}
        for i, (component, statement) in enumerate(whole.statements):
            same = statement in statements and ca.is_equal(statements[statement], found[i], _DEEP)
            told = statement if same or statement not in statements else f"{component}: {statement}"
            statements[told] = found[i]
        return statements

    return {
        "dynamics": lambda x, u, p: unstack(states, f(*known(x, u, p))),
        "observe": lambda x, u, p: unstack(outputs, g(*known(x, u, p))),
        "initial": initial,
        "require": require,
    }
