"""Subsystems and their connections as one set of equations.

No signal is held or extrapolated: every connection is substituted symbolically, so that

    dX/dt = F(X, U, P)        Y = G(X, U, P)        X(0) = S(X_start, U, P)

with X, P and Y stacked over the subsystems and U the inputs of the whole.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence, Set
from dataclasses import dataclass
from typing import Any

import casadi as ca

from fmus.contract import ModelError, Subsystem, column, quantities, symbolic


@dataclass(frozen=True)
class Coupled:
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
) -> Coupled:
    """Couple subsystems by (source output, target input) pairs; `inputs` feeds the inputs of the whole.

    Inputs that nobody feeds are `constant`. Raises ModelError on an algebraic loop.
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
    return Coupled(
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
            raise ModelError(f"{source} -> {target}: {source} is no output of the components")
    fed = [*feed, *(target for _, target in connections)]
    for target in fed:
        if target not in inputs:
            raise ModelError(f"{target} is fed, expected an input of the components")
        if fed.count(target) > 1:
            raise ModelError(f"{target} is fed twice, expected one source")


def _rows(values: ca.SX, rows: Sequence[int]) -> list[ca.SX]:
    return [values[i] for i in rows]


def _resolve(terms: list[ca.SX], symbols: ca.SX, meanings: ca.SX) -> list[ca.SX]:
    """Replaces the symbols by what they stand for until none is left."""
    for _ in range(symbols.numel() + 1):
        if not any(ca.depends_on(t, symbols) for t in terms):
            return terms
        terms = list(ca.substitute(terms, [symbols], [meanings]))
    raise ModelError("the connections form an algebraic loop")
