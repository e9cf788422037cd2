"""Symbolic composition of connected subsystems: into one set of equations, or into one `Subsystem`.

No signal is held or extrapolated: every connection is substituted symbolically, so that

    dX/dt = F(X, U, P)        Y = G(X, U, P)        X(0) = S(X_start, U, P)

with X, P and Y stacked over the components and U the external inputs. The composed subsystem can be exported
as one FMU without coupling error. Names in it:

- External inputs have the names that `inputs` gives them.
- Parameters of the same name become one shared parameter if their declarations (except `group`) and values
  are equal in all components that have them.
- Outputs of the same name become one output, their sum, if `totals` lists the name.
- Every other parameter, state or output keeps its name, unless another variable has the same name; then it is
  `component_variable`.
"""

from collections import Counter
from collections.abc import Collection, Mapping, Sequence, Set
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import casadi as ca

from fmus.contract import (
    Quantity,
    Scalar,
    Subsystem,
    Symbolic,
    Terminal,
    column,
    make_group,
    nested,
    no_event,
    quantities,
    stack,
    symbolic,
    unstack,
)
from fmus.parameters import Number, Tables, numbers
from orchestrator.base.errors import Problem
from orchestrator.base.text import grouped

FlatNames = Mapping[str, str]  # `component.variable` -> name in the composed subsystem
Inputs = Mapping[str, Sequence[str]]  # external input -> `component.variable` of each input that it feeds
_EQUALITY_DEPTH = 9  # depth to which casadi.is_equal compares the expressions of requirements of equal text


@dataclass(frozen=True)
class CoupledEquations(Symbolic):
    """The equations of several components; names are `component.variable`.

    inputs   names of the external inputs
    owners   component of each requirement
    """

    states: tuple[str, ...]
    inputs: tuple[str, ...]
    parameters: tuple[str, ...]
    outputs: tuple[str, ...]
    owners: tuple[str, ...]

    def of(self, name: str, value: ca.SX) -> ca.Function:
        """The CasADi function (x, u, p) -> value."""
        function: ca.Function = ca.Function(name, [self.x, self.u, self.p], [value])
        return function


def couple(
    subsystems: Mapping[str, Subsystem],
    connections: Sequence[tuple[str, str]],
    inputs: Inputs,
    constant: Mapping[str, float],
    known: Mapping[str, Symbolic] | None = None,
) -> CoupledEquations:
    """Couple subsystems by (source output, target input) pairs. Raises Problem on an algebraic loop.

    inputs     external input -> component inputs that it feeds
    constant   `component.variable` -> value of an unconnected input, 0 if missing
    known      expressions of components that are known already
    """
    made = known or {}
    components = {name: made.get(name) or symbolic(sub) for name, sub in subsystems.items()}

    def variables_of(group: str) -> tuple[str, ...]:
        return tuple(f"{n}.{v}" for n, s in subsystems.items() for v in quantities(getattr(s, group)))

    def stacked(field: str) -> Any:
        return column(*(getattr(s, field) for s in components.values()))

    external = {name: ca.SX.sym(name) for name in inputs}
    sources = {t: external[name] for name, targets in inputs.items() for t in targets}
    outputs = variables_of("outputs")
    y = dict(zip(outputs, ca.vertsplit(stacked("y")), strict=True))
    _check(connections, sources, set(outputs), set(variables_of("inputs")))
    sources |= {target: y[source] for source, target in connections}
    u = stacked("u")
    values = column(*(sources.get(name, ca.SX(constant.get(name, 0.0))) for name in variables_of("inputs")))
    dx, y_all, require = _substitute(
        [stacked("dx"), stacked("y"), stacked("require")], u, values, variables_of("inputs")
    )
    calculated = tuple(f"{n}.{v}" for n, s in components.items() for v in s.calculated)
    states = variables_of("states")
    rows = [states.index(name) for name in calculated]
    x, start = stacked("x"), stacked("start")
    (start,) = _substitute(
        [start],
        column(u, *(x[i] for i in rows)),
        column(values, *(start[i] for i in rows)),
        variables_of("inputs") + calculated,
    )
    return CoupledEquations(
        states=states,
        inputs=tuple(external),
        parameters=variables_of("parameters"),
        outputs=outputs,
        calculated=calculated,
        statements=tuple(text for s in components.values() for text in s.statements),
        owners=tuple(n for n, s in components.items() for _ in s.statements),
        x=x,
        u=column(*external.values()),
        p=stacked("p"),
        dx=ca.cse(dx),
        y=ca.cse(y_all),
        start=start,
        require=require,
        next_event=ca.SX(no_event()),
    )


def _check(
    connections: Sequence[tuple[str, str]], fed: Collection[str], outputs: Set[str], inputs: Set[str]
) -> None:
    """Refuse unknown outputs and inputs, and inputs with two sources; fed: targets of external inputs."""
    for source, target in connections:
        if source not in outputs:
            raise Problem(f"{source} -> {target}: {source} is not an output of any component")
    targets = [*fed, *(target for _, target in connections)]
    for target in targets:
        if target not in inputs:
            raise Problem(f"{target} is not an input of any component")
        if targets.count(target) > 1:
            raise Problem(f"{target}: expected one source, got {targets.count(target)}")


def _substitute(terms: list[ca.SX], symbols: ca.SX, values: ca.SX, names: Sequence[str]) -> list[ca.SX]:
    """Replace symbols by their values, which may contain other symbols, until none is left."""
    for _ in range(symbols.numel() + 1):
        if not any(ca.depends_on(t, symbols) for t in terms):
            return terms
        terms = list(ca.substitute(terms, [symbols], [values]))
    loop = [n for n, s in zip(names, ca.vertsplit(symbols), strict=True) if ca.depends_on(column(*terms), s)]
    raise Problem(f"the connections form an algebraic loop through {', '.join(loop)}")


# ---- names in the composed subsystem


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
    reserved: Collection[str],
    totals: Collection[str],
    hidden: Collection[str],
) -> FlatNames:
    """Names of parameters, states and outputs, except `hidden` outputs, in the composed subsystem.

    reserved   names that are taken, those of the external inputs
    """
    parameters, states, outputs = (declared(subsystems, g) for g in ("parameters", "states", "outputs"))
    unknown = set(hidden) - set(outputs)
    if unknown:
        raise Problem(f"hidden: {min(unknown)} is not an output of {', '.join(subsystems)}")
    visible = [v for v in outputs if v not in hidden]
    local = {v: v.partition(".")[2] for v in [*parameters, *states, *visible]}
    shared = _shared(parameters, tables) | {v for v in visible if local[v] in totals}
    unshared = [v for v in local if v not in shared]
    used = [*reserved, *{local[v] for v in shared}]
    counts = Counter([*used, *(local[v] for v in unshared)])
    flat = local | {v: v.replace(".", "_") for v in unshared if counts[local[v]] > 1}
    counts = Counter([*used, *(flat[v] for v in unshared)])
    ambiguous = sorted(name for name, count in counts.items() if count > 1)
    if ambiguous:
        raise Problem(f"{', '.join(subsystems)}: the name {ambiguous[0]} is ambiguous when composed")
    return flat


def _shared(parameters: Mapping[str, Quantity], tables: Mapping[str, Tables]) -> set[str]:
    """Parameters that several components have, all of them with the same declaration and value."""

    def signature(v: str) -> tuple[Quantity, float]:
        component, _, name = v.partition(".")
        return replace(parameters[v], group=""), tables[component]["parameters"][name].value

    return {
        v
        for same_name in grouped(parameters, lambda v: v.partition(".")[2]).values()
        if len(same_name) > 1 and len({*map(signature, same_name)}) == 1
        for v in same_name
    }


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
    """One subsystem composed of several, which are connected by (source output, target input) pairs.

    Unconnected inputs keep their start value. Components with time events (`next_event`) are not supported.

    inputs   external input -> component inputs that it feeds
    tables   parameter and start values by component; default: those of each component
    folder   folder of README.md, icon.png, view.toml and the reference experiment, as far as they exist
    hidden   outputs, `component.variable`, that the composed subsystem does not have
    totals   names of outputs that are replaced by their sum over the components
    texts    descriptions of outputs that replace those of the components
    """
    with_events = [n for n, sub in subsystems.items() if sub.next_event is not no_event]
    if with_events:
        raise Problem(
            f"{name}: {with_events[0]} has time events, which a composed subsystem does not support"
        )
    tables = tables or {n: numbers(sub) for n, sub in subsystems.items()}
    start = {f"{c}.{v}": number for c, t in tables.items() for v, number in t["start"].items()}
    coupled = couple(subsystems, connections, inputs, {v: number.value for v, number in start.items()})
    flat = flat_names(subsystems, tables, inputs, totals, hidden)
    parameters, states, outputs = (declared(subsystems, g) for g in ("parameters", "states", "outputs"))
    visible = _by_flat_name({v: q for v, q in outputs.items() if v not in hidden}, flat)
    visible |= {v: replace(visible[v], text=description) for v, description in (texts or {}).items()}
    groups = {
        "parameters": _by_flat_name(parameters, flat),
        "states": _by_flat_name(states, flat),
        "inputs": _external_inputs(name, declared(subsystems, "inputs"), inputs, start),
        "outputs": visible,
    }
    types: dict[str, Any] = {
        which: make_group(f"{name}_{which}", members) for which, members in groups.items()
    }
    return Subsystem(
        name=name,
        text=text,
        **types,
        **_functions(coupled, flat, types["states"], types["outputs"]),
        values=folder and folder / "parameters.toml",  # only for its folder: the file need not exist
        numbers=_composed_tables(tables, flat, inputs),
        derive=lambda p: _derived(subsystems, flat, p),
        terminals=terminals,
    )


def _by_flat_name(members: Mapping[str, Quantity], flat: FlatNames) -> dict[str, Quantity]:
    """Quantities by their name in the composed subsystem; of several with one name the first is used."""
    renamed: dict[str, Quantity] = {}
    for variable, quantity in members.items():
        renamed.setdefault(flat[variable], quantity)
    return renamed


def _external_inputs(
    name: str, members: Mapping[str, Quantity], inputs: Inputs, start: Mapping[str, Number]
) -> dict[str, Quantity]:
    """External inputs as their first targets declare them, with the external name of their rate."""

    def signature(target: str) -> tuple[str, float]:
        return members[target].unit, start[target].value if target in start else 0.0

    external: dict[str, Quantity] = {}
    for external_name, targets in inputs.items():
        first = targets[0]
        for t in targets:
            if signature(t) != signature(first):
                raise Problem(
                    f"{name}: {external_name} feeds {first} and {t}, "
                    "which have different units or start values"
                )
        rate = first.partition(".")[0] + f".{members[first].rate}"
        rate_name = next((n for n, fed in inputs.items() if rate in fed), None)
        external[external_name] = replace(members[first], rate=rate_name)
    return external


def _derived(subsystems: Mapping[str, Subsystem], flat: FlatNames, p: Any) -> dict[str, Scalar]:
    """Derived parameters of the components, by their name in the composed subsystem."""
    derived: dict[str, Scalar] = {}
    for component, sub in subsystems.items():
        parameters = quantities(sub.parameters)
        local = nested(sub.parameters, {n: getattr(p, flat[f"{component}.{n}"]) for n in parameters})
        derived |= {flat[f"{component}.{n}"]: value for n, value in sub.derive(local).items()}
    return derived


def _composed_tables(tables: Mapping[str, Tables], flat: FlatNames, inputs: Inputs) -> Tables:
    """Parameter and start values by their name in the composed subsystem; of shared ones the first."""
    all_names = {**flat} | {targets[0]: name for name, targets in inputs.items()}
    composed: dict[str, dict[str, Number]] = {"parameters": {}, "start": {}}
    for component, sections in tables.items():
        for section, entries in sections.items():
            for variable, number in entries.items():
                if f"{component}.{variable}" in all_names:
                    composed[section].setdefault(all_names[f"{component}.{variable}"], number)
    return composed


def _functions(
    coupled: CoupledEquations, flat: FlatNames, states: type[Any], outputs: type[Any]
) -> dict[str, Any]:
    """The functions that a Subsystem needs, by name: dynamics, observe, initial, require."""
    rows = {n: [i for i, v in enumerate(coupled.outputs) if flat.get(v) == n] for n in quantities(outputs)}
    summed = column(*(sum(coupled.y[i] for i in indices) for indices in rows.values()))
    f, g = coupled.of("f", coupled.dx), coupled.of("g", summed)
    s, r = coupled.of("s", coupled.start), coupled.of("r", coupled.require)

    def arguments(x: Any, u: Any, p: Any) -> tuple[Any, Any, Any]:
        return stack(x), stack(u), column(*(getattr(p, flat[v]) for v in coupled.parameters))

    def initial(x: Any, u: Any, p: Any) -> dict[str, Scalar]:
        start = s(*arguments(x, u, p))
        return {flat[v]: start[coupled.states.index(v)] for v in coupled.calculated}

    def require(x: Any, u: Any, p: Any) -> dict[str, Scalar]:
        """Requirements by text; equal ones once.

        Of different ones with the same text the first keeps its text, later ones get the component name.
        """
        margins = r(*arguments(x, u, p))
        by_text: dict[str, Scalar] = {}
        for i, (component, statement) in enumerate(zip(coupled.owners, coupled.statements, strict=True)):
            same = statement in by_text and ca.is_equal(by_text[statement], margins[i], _EQUALITY_DEPTH)
            key = statement if same or statement not in by_text else f"{component}: {statement}"
            by_text[key] = margins[i]
        return by_text

    return {
        "dynamics": lambda x, u, p: unstack(states, f(*arguments(x, u, p))),
        "observe": lambda x, u, p: unstack(outputs, g(*arguments(x, u, p))),
        "initial": initial,
        "require": require,
    }
