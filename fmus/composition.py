"""Several subsystems and their connections as one set of equations, and as one `Subsystem`.

No signal is held or extrapolated: every connection is substituted symbolically, so that

    dX/dt = F(X, U, P)        Y = G(X, U, P)        X(0) = S(X_start, U, P)

with X, P and Y stacked over the subsystems and U the inputs of the whole. As one subsystem it makes one FMU,
without coupling error. There

- a variable keeps its name where no other component shows the same, else it gets its component in front;
- parameters that several components declare alike, down to the text (but for the heading), and to which they
  give the same value, are one thing and have one name; so have the outputs of which the sum is shown.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Mapping, Sequence, Set
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import casadi as ca

from fmus.contract import (
    Quantity,
    Scalar,
    Subsystem,
    Terminal,
    column,
    make_group,
    never,
    quantities,
    stack,
    symbolic,
    unstack,
)
from fmus.parameters import Number, Tables, numbers
from orchestrator.base.errors import Problem


@dataclass(frozen=True)
class CoupledEquations:
    """Symbols x, u, p (columns) and the expressions of them.

    states, parameters, outputs, calculated   names, `component.variable`
    inputs                                    names of the inputs of the whole
    statements                                (component, what must hold) for each row of `require`
    """

    states: tuple[str, ...]
    inputs: tuple[str, ...]
    parameters: tuple[str, ...]
    outputs: tuple[str, ...]
    calculated: tuple[str, ...]
    statements: tuple[tuple[str, str], ...]
    x: ca.SX
    u: ca.SX
    p: ca.SX
    dx: ca.SX
    y: ca.SX
    start: ca.SX
    require: ca.SX

    def function(self, name: str, value: ca.SX) -> ca.Function:
        """(x, u, p) -> value."""
        function: ca.Function = ca.Function(name, [self.x, self.u, self.p], [value])
        return function


def couple(
    subsystems: Mapping[str, Subsystem],
    connections: Sequence[tuple[str, str]],
    inputs: Mapping[str, Sequence[str]],
    constant: Mapping[str, float],
) -> CoupledEquations:
    """Couple subsystems by (source output, target input) pairs; `inputs` feeds the inputs of the whole.

    Inputs that nobody feeds are `constant`. Raises Problem on an algebraic loop.
    """
    parts = {name: symbolic(sub) for name, sub in subsystems.items()}

    def named(group: str) -> tuple[str, ...]:
        return tuple(f"{n}.{v}" for n, s in subsystems.items() for v in quantities(getattr(s, group)))

    def stacked(field: str) -> Any:
        return column(*(getattr(s, field) for s in parts.values()))

    external = {name: ca.SX.sym(name) for name in inputs}
    feed = {t: external[name] for name, targets in inputs.items() for t in targets}
    outputs = named("outputs")
    y = dict(zip(outputs, ca.vertsplit(stacked("y")), strict=True))
    _check(connections, feed, set(outputs), set(named("inputs")))
    feed |= {target: y[source] for source, target in connections}
    symbols = stacked("u")
    fed = column(*(feed.get(name, ca.SX(constant.get(name, 0.0))) for name in named("inputs")))
    dx, shown, require = _resolve([stacked("dx"), stacked("y"), stacked("require")], symbols, fed)
    calculated = tuple(f"{n}.{v}" for n, s in parts.items() for v in s.calculated)
    states = named("states")
    rows = [states.index(name) for name in calculated]
    x, start = stacked("x"), stacked("start")
    (start,) = _resolve([start], column(symbols, *_rows(x, rows)), column(fed, *_rows(start, rows)))
    return CoupledEquations(
        states=states,
        inputs=tuple(external),
        parameters=named("parameters"),
        outputs=outputs,
        calculated=calculated,
        statements=tuple((n, text) for n, s in parts.items() for text in s.statements),
        x=x,
        u=column(*external.values()),
        p=stacked("p"),
        dx=ca.cse(dx),
        y=ca.cse(shown),
        start=start,
        require=require,
    )


def _check(
    connections: Sequence[tuple[str, str]], feed: Collection[str], outputs: Set[str], inputs: Set[str]
) -> None:
    for source, target in connections:
        if source not in outputs:
            raise Problem(f"{source} -> {target}: {source} is no output of the components")
    fed = [*feed, *(target for _, target in connections)]
    for target in fed:
        if target not in inputs:
            raise Problem(f"{target} is fed, expected an input of the components")
        if fed.count(target) > 1:
            raise Problem(f"{target} is fed twice, expected one source")


def _rows(values: ca.SX, rows: Sequence[int]) -> list[ca.SX]:
    return [values[i] for i in rows]


def _resolve(terms: list[ca.SX], symbols: ca.SX, meanings: ca.SX) -> list[ca.SX]:
    """Replaces the symbols by what they stand for until none is left."""
    for _ in range(symbols.numel() + 1):
        if not any(ca.depends_on(t, symbols) for t in terms):
            return terms
        terms = list(ca.substitute(terms, [symbols], [meanings]))
    raise Problem("the connections form an algebraic loop")


Names = Mapping[str, str]  # `component.variable` -> name


def declared(subsystems: Mapping[str, Subsystem], group: str) -> dict[str, Quantity]:
    """All variables of one group, by `component.variable`."""
    return {
        f"{component}.{name}": quantity
        for component, sub in subsystems.items()
        for name, quantity in quantities(getattr(sub, group)).items()
    }


def flat_names(
    subsystems: Mapping[str, Subsystem],
    tables: Mapping[str, Tables],
    taken: Collection[str],
    totals: Collection[str],
    hidden: Collection[str],
) -> Names:
    """Names of parameters, states and outputs, but `hidden` ones; those in `taken` belong to others."""
    parameters, states, outputs = (declared(subsystems, g) for g in ("parameters", "states", "outputs"))
    unknown = set(hidden) - set(outputs)
    if unknown:
        raise Problem(f"{min(unknown)} is hidden, expected an output of {', '.join(subsystems)}")
    visible = [v for v in outputs if v not in hidden]
    own = {v: v.partition(".")[2] for v in [*parameters, *states, *visible]}
    merged = _common(parameters, tables) | {v for v in visible if own[v] in totals}
    single = [v for v in own if v not in merged]
    others = [*taken, *{own[v] for v in merged}]
    seen = Counter([*others, *(own[v] for v in single)])
    names = own | {v: v.replace(".", "_") for v in single if seen[own[v]] > 1}
    seen = Counter([*others, *(names[v] for v in single)])
    twice = sorted(name for name, count in seen.items() if count > 1)
    if twice:
        raise Problem(f"{', '.join(subsystems)}: {twice[0]} would name two variables of the whole")
    return names


def _common(parameters: Mapping[str, Quantity], tables: Mapping[str, Tables]) -> set[str]:
    """Parameters that stand for the same thing in several components."""
    alike: dict[str, list[str]] = {}
    for v in parameters:
        alike.setdefault(v.partition(".")[2], []).append(v)

    def meaning(v: str) -> tuple[Quantity, float]:
        component, _, name = v.partition(".")
        return replace(parameters[v], group=""), tables[component]["parameters"][name].value

    return {
        v for group in alike.values() if len(group) > 1 and len({*map(meaning, group)}) == 1 for v in group
    }


Inputs = Mapping[str, Sequence[str]]  # input of the whole -> `component.variable` that it feeds


def compose(
    name: str,
    text: str,
    subsystems: Mapping[str, Subsystem],
    connections: Sequence[tuple[str, str]],
    inputs: Inputs,
    tables: Mapping[str, Tables] | None = None,
    *,
    folder: Path | None = None,
    hidden: Collection[str] = (),
    totals: Collection[str] = (),
    texts: Mapping[str, str] | None = None,
    terminals: tuple[Terminal, ...] = (),
) -> Subsystem:
    """One subsystem of several, connected by (source output, target input) pairs.

    Inputs that nothing feeds keep their start value.
    Components that have a `corner` are refused: the whole would not tell it.

    tables   numbers by component; by default those of its parameters.toml
    folder   where README.md and icon.png are, if there are any
    hidden   outputs, `component.variable`, that nobody outside needs
    totals   names that several components give to an output, of which the sum is shown
    texts    output of the whole -> what it is, where the words of the component do not fit
    """
    told = [n for n, sub in subsystems.items() if sub.corner is not never]
    if told:
        raise Problem(f"{name}: {told[0]} has corners, expected components without")
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
    types: dict[str, Any] = {
        which: make_group(f"{name}_{which}", members) for which, members in groups.items()
    }
    return Subsystem(
        name=name,
        text=text,
        **types,
        **_equations(whole, names, types["states"], types["outputs"]),
        values=folder and folder / "parameters.toml",
        numbers=_numbers(tables, names, inputs),
        derive=lambda p: _derived(subsystems, names, p),
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
                raise Problem(f"{name}: {own} feeds {targets[0]} and {t}, expected one unit and start value")
        rate = targets[0].partition(".")[0] + f".{first.rate}"
        found[own] = replace(first, rate=next((n for n, ends in inputs.items() if rate in ends), None))
    return found


def _value(start: Mapping[str, Number], variable: str) -> float:
    return start[variable].value if variable in start else 0.0


def _derived(subsystems: Mapping[str, Subsystem], names: Names, p: Any) -> dict[str, Scalar]:
    """What the components derive of their parameters, by its name in the whole."""
    found: dict[str, Scalar] = {}
    for component, sub in subsystems.items():
        of_whole = {n: names[f"{component}.{n}"] for n in quantities(sub.parameters)}
        own = SimpleNamespace(**{n: getattr(p, name) for n, name in of_whole.items()})
        found |= {of_whole[n]: value for n, value in sub.derive(own).items()}
    return found


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


def _equations(
    whole: CoupledEquations, names: Names, states: type[Any], outputs: type[Any]
) -> dict[str, Any]:
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
