"""The equations of a model as the C functions of native/model.h: values, and derivatives both ways."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import casadi as ca

from fmus.contract import Symbolic
from fmus.export.elimination import Elimination, eliminate
from fmus.export.emit import Routine
from fmus.export.interface import Interface


@dataclass(frozen=True)
class Equations:
    """C functions, those for adjoint derivatives apart, and the lengths of the vectors between them."""

    routines: Sequence[Routine]
    adjoint: Sequence[Routine]
    lengths: Mapping[str, int]


@dataclass(frozen=True)
class _Directions:
    """Symbols: directions v of states, inputs and parameters, slopes of inputs, weights w of results."""

    vx: ca.SX
    vu: ca.SX
    vp: ca.SX
    du: ca.SX
    wx0: ca.SX
    wdx: ca.SX
    wy: ca.SX


def write_out(face: Interface) -> Equations:
    """All functions of native/model.h for a model."""
    sym = face.equations
    system = eliminate(ca.jacobian(sym.dx, sym.x))
    along = _directions(sym, face.y)
    values = _values(sym, face.y, system, along) | _forward(sym, face.y, along) | _reverse(sym, face.y, along)
    values, c, prepared = hoist({name: ca.densify(value) for name, value in values.items()}, sym.p)
    model = {"x": sym.x, "u": sym.u, "p": sym.p, "c": c}
    lengths = {"NC": c.numel(), "NJ": system.jac.numel(), "NLU": system.lu.numel()}

    def give(name: str, *outputs: str, **more: ca.SX) -> Routine:
        return Routine(name, {**model, **more}, {o: values[o] for o in outputs})

    prepare = Routine("model_prepare", {"p": sym.p}, {"c": prepared})
    routines = [prepare, *_elimination(system), *_routines(give, along)]
    return Equations(routines, _adjoint(give, along), lengths)


# ---- expressions -----------------------------------------------------------------------------------


def _directions(sym: Symbolic, y: ca.SX) -> _Directions:
    sizes = {"vx": sym.x, "vu": sym.u, "vp": sym.p, "du": sym.u, "wx0": sym.x, "wdx": sym.x, "wy": y}
    return _Directions(**{name: ca.SX.sym(name, like.numel()) for name, like in sizes.items()})


def _values(sym: Symbolic, y: ca.SX, system: Elimination, d: _Directions) -> dict[str, ca.SX]:
    return {
        "x0": sym.start,
        "dx": sym.dx,
        "jac": system.entries,
        "ft": ca.jtimes(sym.dx, sym.u, d.du),
        "y": y,
        "require": sym.require,
        "wait": sym.corner,
    }


def _forward(sym: Symbolic, y: ca.SX, d: _Directions) -> dict[str, ca.SX]:
    """Directional derivatives while the model runs, and at the start through the start equations."""
    running, starting = (sym.x, sym.u), (sym.x, sym.u, sym.p)
    vx0 = _along(sym.start, starting, (d.vx, d.vu, d.vp))
    return {
        "vdx": _along(sym.dx, running, (d.vx, d.vu)),
        "vy": _along(y, running, (d.vx, d.vu)),
        "vx0": vx0,
        "vdx0": _along(sym.dx, starting, (vx0, d.vu, d.vp)),
        "vy0": _along(y, starting, (vx0, d.vu, d.vp)),
    }


def _reverse(sym: Symbolic, y: ca.SX, d: _Directions) -> dict[str, ca.SX]:
    """Adjoint derivatives, likewise."""
    starting = (sym.x, sym.u, sym.p)
    wx, wu = _against((sym.dx, y), (sym.x, sym.u), (d.wdx, d.wy))
    on_x, on_u, on_p = _against((sym.dx, y), starting, (d.wdx, d.wy))
    start_x, start_u, start_p = _against((sym.start,), starting, (d.wx0 + on_x,))
    return {
        "wx": wx,
        "wu": wu,
        "wx_start": start_x,
        "wu_start": on_u + start_u,
        "wp_start": on_p + start_p,
    }


def _against(values: Sequence[ca.SX], known: Sequence[ca.SX], weights: Sequence[ca.SX]) -> list[ca.SX]:
    """The weighted sum of `values`, differentiated by each of `known`."""
    total = ca.jtimes(ca.vertcat(*values), ca.vertcat(*known), ca.vertcat(*weights), True)
    ends = [0]
    for group in known:
        ends.append(ends[-1] + group.numel())
    return list(ca.vertsplit(ca.densify(total), ends))


def _along(value: ca.SX, known: Sequence[ca.SX], direction: Sequence[ca.SX]) -> ca.SX:
    """Directional derivative of `value` with respect to `known`."""
    return ca.jtimes(value, ca.vertcat(*known), ca.vertcat(*direction))


def hoist(wanted: Mapping[str, ca.SX], p: ca.SX) -> tuple[dict[str, ca.SX], ca.SX, ca.SX]:
    """Replaces what depends on the parameters alone by symbols c; also returns c and what it stands for.

    wanted   dense columns
    """
    everything = ca.cse(ca.vertcat(*wanted.values()))
    reduced, symbols, meanings = ca.extract_parametric(everything, p)
    c = ca.vertcat(*symbols) if symbols else ca.SX(0, 1)
    prepared = ca.vertcat(*meanings) if meanings else ca.SX(0, 1)
    ends = [0]
    for value in wanted.values():
        ends.append(ends[-1] + value.numel())
    parts = ca.vertsplit(ca.densify(reduced), ends)
    return dict(zip(wanted, parts, strict=True)), c, prepared


# ---- functions -------------------------------------------------------------------------------------


def _elimination(system: Elimination) -> list[Routine]:
    matrix = {"diagonal": system.diagonal, "jac": system.jac}
    return [
        Routine("model_factorise", matrix, {"lu": system.factors, "trust": system.trust}),
        Routine("model_solve", {"lu": system.lu, "b": system.b}, {"k": system.k}),
    ]


def _routines(give: Callable[..., Routine], d: _Directions) -> list[Routine]:
    return [
        give("model_start", "x0"),
        give("model_dynamics", "dx"),
        give("model_jacobian", "dx", "jac", "ft", du=d.du),
        give("model_observe", "y", "require"),
        give("model_corner", "wait"),
        give("model_forward", "vdx", "vy", vx=d.vx, vu=d.vu),
        give("model_start_forward", "vx0", "vdx0", "vy0", vx=d.vx, vu=d.vu, vp=d.vp),
    ]


def _adjoint(give: Callable[..., Routine], d: _Directions) -> list[Routine]:
    return [
        give("model_reverse", "wx", "wu", wdx=d.wdx, wy=d.wy),
        give("model_start_reverse", "wx_start", "wu_start", "wp_start", wx0=d.wx0, wdx=d.wdx, wy=d.wy),
    ]
