"""The part of a subsystem that some of its outputs depend on."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import casadi as ca

from fmus.contract import Quantity, Subsystem, column, quantities, symbolic
from orchestrator.base.errors import Problem


@dataclass(frozen=True)
class Reduced:
    """Symbols x, u, p, q (columns) and the expressions of them.

    states, inputs   names of those that the outputs depend on, in the order of the declaration
    parameters       all names: what p holds
    free             names of those in q, which are some of p
    acting           which of q the motion and the outputs depend on; the others act through the start alone
    all_x            the symbols of all start values: what `start` depends on, with u and p
    """

    states: tuple[str, ...]
    inputs: tuple[str, ...]
    parameters: tuple[str, ...]
    outputs: tuple[str, ...]
    free: tuple[str, ...]
    acting: tuple[int, ...]
    declared: dict[str, Quantity]
    x: ca.SX
    u: ca.SX
    p: ca.SX
    q: ca.SX
    all_x: ca.SX
    dx: ca.SX
    y: ca.SX
    start: ca.SX
    require: ca.SX
    statements: tuple[str, ...]


def reduce(sub: Subsystem, outputs: Sequence[str], free: Sequence[str]) -> Reduced:
    """The subsystem without the states and inputs that do not act on these outputs."""
    sym = symbolic(sub)
    groups = {g: quantities(getattr(sub, g)) for g in ("states", "inputs", "parameters", "outputs")}
    _check(sub.name, "output", outputs, groups["outputs"])
    _check(sub.name, "parameter", free, groups["parameters"])
    rows = [list(groups["outputs"]).index(name) for name in outputs]
    y = column(*(sym.y[i] for i in rows))
    states = _needed(sym.dx, y, sym.x)
    if not states:
        raise Problem(f"{sub.name}: {', '.join(outputs)} depend on no state, expected outputs that do")
    x, dx, start = (column(*(v[i] for i in states)) for v in (sym.x, sym.dx, sym.start))
    inputs = sorted(_arguments(column(dx, y, start), sym.u))
    u = column(*(sym.u[i] for i in inputs))
    known = column(x, u, sym.p)
    held = [i for i in range(len(sym.statements)) if not _foreign(sym.require[i], known)]
    q = column(*(sym.p[list(groups["parameters"]).index(name)] for name in free))
    return Reduced(
        states=_some(groups["states"], states),
        inputs=_some(groups["inputs"], inputs),
        parameters=tuple(groups["parameters"]),
        outputs=tuple(outputs),
        free=tuple(free),
        acting=tuple(sorted(_arguments(column(dx, y), q))),
        declared={name: quantity for group in groups.values() for name, quantity in group.items()},
        x=x,
        u=u,
        p=sym.p,
        q=q,
        all_x=sym.x,
        dx=dx,
        y=y,
        start=start,
        require=column(*(sym.require[i] for i in held)),
        statements=tuple(sym.statements[i] for i in held),
    )


def _check(model: str, kind: str, names: Sequence[str], declared: Collection[str]) -> None:
    for name in names:
        if name not in declared:
            raise Problem(f"{model}: {name} is no {kind}, expected one of {', '.join(declared)}")
        if list(names).count(name) > 1:
            raise Problem(f"{model}: {kind} {name} is asked for twice, expected once")


def _needed(dx: ca.SX, y: ca.SX, x: ca.SX) -> list[int]:
    """The states that y depends on, those that their derivatives depend on, and so on."""
    found: set[int] = set()
    new = _arguments(y, x)
    while new:
        found |= new
        new = _arguments(column(*(dx[i] for i in sorted(new))), x) - found
    return sorted(found)


def _arguments(value: ca.SX, symbols: ca.SX) -> set[int]:
    """Indices of the symbols that a value depends on."""
    return set(ca.jacobian_sparsity(value, symbols).get_triplet()[1])


def _foreign(value: ca.SX, known: ca.SX) -> bool:
    """Does it depend on other symbols?"""
    return bool(ca.depends_on(value, column(*(s for s in ca.symvar(value) if not ca.depends_on(known, s)))))


def _some(names: Collection[str], rows: Sequence[int]) -> tuple[str, ...]:
    every = list(names)
    return tuple(every[i] for i in rows)
