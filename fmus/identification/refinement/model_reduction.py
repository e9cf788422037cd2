"""Model reduction: the states, inputs and equations of a subsystem that some of its outputs depend on."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import casadi as ca

from fmus.contract import Quantity, Subsystem, Symbolic, column, quantities, symbolic
from orchestrator.base.errors import Problem


@dataclass(frozen=True)
class ReducedModel:
    """The part of a subsystem that the chosen outputs depend on.

    states, inputs   names of those that the outputs depend on, in the order of the declaration
    parameters       names of all parameters (p)
    estimated        names of the parameters to be estimated (q), a subset of p
    dynamic          indices in q that f or the outputs depend on; the others affect only the initial state
    quantities       declaration of each variable by name
    equations        equations of the reduced model; its initial state is x itself
    q                symbols of the parameters to be estimated
    start, all_x     initial states as expressions of all_x (all states of the full model), u and p
    """

    states: tuple[str, ...]
    inputs: tuple[str, ...]
    parameters: tuple[str, ...]
    outputs: tuple[str, ...]
    estimated: tuple[str, ...]
    dynamic: tuple[int, ...]
    quantities: dict[str, Quantity]
    equations: Symbolic
    q: ca.SX
    start: ca.SX
    all_x: ca.SX


def reduce_model(sub: Subsystem, outputs: Sequence[str], estimated: Sequence[str]) -> ReducedModel:
    """The subsystem without the states and inputs that have no effect on these outputs."""
    sym = symbolic(sub)
    groups = {g: quantities(getattr(sub, g)) for g in ("states", "inputs", "parameters", "outputs")}
    for article, causality, names in (("an", "output", outputs), ("a", "parameter", estimated)):
        for name in names:
            if name not in groups[causality + "s"]:
                expected = ", ".join(groups[causality + "s"])
                raise Problem(f"{sub.name}: {name} is not {article} {causality}; expected one of {expected}")
            if (count := list(names).count(name)) > 1:
                raise Problem(f"{sub.name}: {causality} {name}: expected once, got {count} times")
    order = {group: list(declared) for group, declared in groups.items()}
    y = column(*(sym.y[order["outputs"].index(name)] for name in outputs))
    states = _required_states(sym.dx, y, sym.x)
    if not states:
        listed = ", ".join(outputs)
        raise Problem(f"{sub.name}: {listed} depend on no state, so that there is nothing to identify")
    x, dx, start = (column(*(v[i] for i in states)) for v in (sym.x, sym.dx, sym.start))
    inputs = sorted(_dependencies(column(dx, y, start), sym.u))
    u = column(*(sym.u[i] for i in inputs))
    requirements = [i for i in range(len(sym.statements)) if _depends_only_on(sym.require[i], x, u, sym.p)]
    q = column(*(sym.p[order["parameters"].index(name)] for name in estimated))
    return ReducedModel(
        states=tuple(order["states"][i] for i in states),
        inputs=tuple(order["inputs"][i] for i in inputs),
        parameters=tuple(groups["parameters"]),
        outputs=tuple(outputs),
        estimated=tuple(estimated),
        dynamic=tuple(sorted(_dependencies(column(dx, y), q))),
        quantities={name: quantity for group in groups.values() for name, quantity in group.items()},
        equations=replace(
            sym,
            x=x,
            u=u,
            dx=dx,
            y=y,
            start=x,
            calculated=(),
            require=column(*(sym.require[i] for i in requirements)),
            statements=tuple(sym.statements[i] for i in requirements),
            next_event=ca.SX.inf(),  # no time events: the step-size control alone resolves jumps of a rate
        ),
        q=q,
        start=start,
        all_x=sym.x,
    )


def _required_states(dx: ca.SX, y: ca.SX, x: ca.SX) -> list[int]:
    """Indices of the states that y depends on, of those that their derivatives depend on, and so on."""
    required: set[int] = set()
    new = _dependencies(y, x)
    while new:
        required |= new
        new = _dependencies(column(*(dx[i] for i in sorted(new))), x) - required
    return sorted(required)


def _dependencies(value: ca.SX, symbols: ca.SX) -> set[int]:
    """Indices of the symbols that a value depends on."""
    return set(ca.jacobian_sparsity(value, symbols).get_triplet()[1])


def _depends_only_on(value: ca.SX, *symbols: ca.SX) -> bool:
    """Is each symbol that a value depends on one of these?"""
    allowed = column(*symbols)
    return all(ca.depends_on(allowed, s) for s in ca.symvar(value) if ca.depends_on(value, s))
