"""Base parameters of the arm: the combinations of inertial parameters that its motion can tell at all.

Momenta and forces are linear in the standard parameters of the links (first row column, then boom and stick)

    J_0      m, m x, m z, S_xx, S_xz, S_zz         S_ab = int a b dm about the link's pivot

with slender links, all mass in the plane of the arm, and the head as part of the stick. Their columns are
derivatives of the manipulator's equations: m from the mass, m x from mass and centre, S_xx from the inertia,
S_xz and S_zz from the mass and the centre twice. Columns of which the others make a combination are found by
QR (Gautier 1991, J. Robotic Systems 8, 485) and their parameters added to the others.

Values and intervals of the base parameters (`base_parameters`), by the same balance of momenta.

Torque that the free parameters have to explain, measured and by the parameters found, for each joint.

Inertial parameters from joint motion and torque; the paper took them from CAD.

The balance of momenta (`balance`) is linear in masses and moments of inertia about the centres of mass, the
geometry and the centres being known. All joints count; the dampings of swing and pistons are found along with
them, so that an error of theirs cannot go into the inertia. Parameters that the motion does not tell stay as
they are known, and the remarks name them. What data can tell at best are the base parameters (`others`).

Validity: rigid links, viscous friction; what is known is right.

Inertial parameters from motion and torque: `procedure`, and the `base_parameters`.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import casadi as ca
import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from fmus.contract import quantities, symbols
from fmus.identification.known import Curve, Estimate, Finding, Panel
from fmus.identification.procedures import momentum_balance, momentum_fit
from fmus.identification.procedures.known_values import training
from fmus.identification.procedures.momentum_balance import (
    JOINTS,
    PARAMETERS,
    Equation,
    Samples,
    numbers,
    samples,
)
from fmus.identification.procedures.momentum_fit import Fit, Solution, doubt, normal_step, solve
from fmus.identification.procedures.regression import symmetrical
from fmus.manipulator import MANIPULATOR, arm
from fmus.manipulator.design import POINT_MASS
from fmus.parameters import Number
from orchestrator.base.errors import Problem
from orchestrator.data.recording import Recording

Array = NDArray[np.float64]
MOMENTS = {"m": "kg", "m x": "kg.m", "m z": "kg.m", "S_xx": "kg.m2", "S_xz": "kg.m2", "S_zz": "kg.m2"}
STANDARD = ("column J_0", *(f"{link} {moment}" for link in ("boom", "stick") for moment in MOMENTS))
UNITS = ("kg.m2", *(unit for _ in ("boom", "stick") for unit in MOMENTS.values()))
# the first of these that are independent are kept: moments about the pivots before masses
PREFERRED = [0, 2, 3, 4, 5, 6, 8, 9, 10, 11, 12, 1, 7]
RANK = 1e-9  # of the largest diagonal of R, below which a column is a combination of others


@lru_cache(maxsize=1)
def regressor() -> ca.Function:
    """(q, q', q'', p) -> dh/dpi, df/dpi and torques by pi, each (3, 13) beside each other."""
    x, p = symbols(MANIPULATOR.states), symbols(MANIPULATOR.parameters)
    motion = arm.mechanics(x, p, POINT_MASS)
    q, w = (ca.vertcat(*(getattr(x, f"{j}_{k}") for j in JOINTS)) for k in ("angle", "speed"))
    momentum = motion.mass @ w
    force = ca.jtimes(momentum, q, w) - motion.coriolis - motion.gravity
    by_momentum, by_force = _columns(momentum, p), _columns(force, p)
    a = ca.SX.sym("a", 3)
    rate = ca.horzcat(*(ca.jtimes(h, q, w) + ca.jtimes(h, w, a) for h in ca.horzsplit(by_momentum)))
    machine = ca.SX.sym("p", len(PARAMETERS))
    own = ca.vertcat(*(machine[PARAMETERS.index(f"manipulator.{n}")] for n in vars(p)))
    terms = ca.substitute([by_momentum, by_force, rate - by_force], [ca.vertcat(*vars(p).values())], [own])
    return ca.Function("regressor", [q, w, a, machine], [ca.densify(t) for t in terms])


def _columns(term: ca.SX, p: object) -> ca.SX:
    """Derivatives of momenta or forces by the standard parameters, shape (3, 13)."""
    columns = [ca.jacobian(term, p.column_inertia)]  # type: ignore[attr-defined]
    for link in ("boom", "stick"):
        mass, inertia, cx, cz = (
            getattr(p, f"{link}_{n}") for n in ("mass", "inertia", "centre_x", "centre_z")
        )
        by_mass = ca.jacobian(term, mass)
        by_x, by_z = ca.jacobian(by_mass, cx), ca.jacobian(by_mass, cz)
        at_pivot = [by_mass, by_x, by_z, ca.jacobian(by_x, cz), ca.jacobian(by_z, cz) / 2]
        m, mx, mz, xz, zz = ca.substitute(at_pivot, [ca.vertcat(cx, cz)], [ca.DM.zeros(2)])
        columns += [m, mx, mz, ca.jacobian(term, inertia), xz, zz]
    return ca.horzcat(*columns)


def standard(p: Array) -> Array:
    """The standard parameters of the machine's, shape (13,)."""
    v = {n.partition(".")[2]: x for n, x in zip(PARAMETERS, p, strict=True) if n.startswith("manipulator.")}
    found = [v["column_inertia"]]
    for link in ("boom", "stick"):
        m, x, z = v[f"{link}_mass"], v[f"{link}_centre_x"], v[f"{link}_centre_z"]
        found += [m, m * x, m * z, v[f"{link}_inertia"] + m * x**2, m * x * z, m * z**2]
    head, length = v["head_mass"], v["stick_length"]
    found[7] += head
    found[8] += head * length
    found[10] += head * length**2
    return np.array(found)


@dataclass(frozen=True)
class Grouping:
    """Base parameters beta = pi[kept] + share pi[others]; `share` has shape (kept, others)."""

    kept: tuple[int, ...]
    others: tuple[int, ...]
    share: Array

    def values(self, pi: Array) -> Array:
        """beta."""
        found: Array = pi[list(self.kept)] + self.share @ pi[list(self.others)]
        return found

    def names(self) -> list[str]:
        """What each is made of."""
        found = []
        for k, row in zip(self.kept, self.share, strict=True):
            parts = [f"{c:+.4g} {STANDARD[o]}" for c, o in zip(row, self.others, strict=True) if c]
            found.append(" ".join([STANDARD[k], *parts]))
        return found


def grouping(p: Array, states: int = 200) -> Grouping:
    """Which standard parameters any motion can tell, from the regressor at random states."""
    random = np.random.default_rng(0)  # any states do: rank and combinations do not depend on them
    q, w, a = (random.uniform(-2.0, 2.0, (3, states)) for _ in range(3))
    full = np.array(regressor()(q, w, a, p)[2].full())
    y = full.reshape(3, states, len(STANDARD)).reshape(-1, len(STANDARD))
    scale = np.linalg.norm(y, axis=0)
    diagonal = np.abs(np.diag(scipy.linalg.qr((y / scale)[:, PREFERRED], mode="r")[0]))
    told = diagonal > RANK * diagonal.max()
    kept, others = np.array(PREFERRED)[told], np.array(PREFERRED)[~told]
    share = np.linalg.lstsq(y[:, kept] / scale[kept], y[:, others] / scale[others], rcond=None)[0]
    share = share * scale[others] / scale[kept][:, None]
    return Grouping(
        tuple(map(int, kept)), tuple(map(int, others)), np.where(np.abs(share) < 1e-9, 0.0, share)
    )


def base_estimates(records: Sequence[Samples], found: Solution, p: Array) -> list[Estimate]:
    """All base parameters, with the dampings among those found free beside them."""
    at = p.copy()
    at[[PARAMETERS.index(n) for n in found.theta]] = found.values + found.mean_effect
    group = grouping(at)
    free = [k for k, n in enumerate(found.theta) if n.endswith("damping")]
    equations = [_equation(s, e, free, group, at) for s, e in zip(records, found.equations, strict=True)]
    names = tuple(group.names())
    normal, step = normal_step(equations, found.weights, (*names, *(found.theta[k] for k in free)))
    fit = Fit(names, [0, 1, 2], found.weights, np.array(np.linalg.inv(normal), float), at)
    moved = [e.moved(step) for e in equations]
    noise, residual = (
        momentum_fit.by_noise(fit, records, moved)[0],
        momentum_fit.by_residuals(fit, records, moved),
    )
    sd = np.sqrt(np.diag(residual if found.lacks else noise))
    values = group.values(standard(at)) + step[: len(names)]
    units = [UNITS[k] for k in group.kept]
    return [
        symmetrical(name, float(value), unit, float(one), "base parameter: what any motion can tell at most")
        for name, value, unit, one in zip(names, values, units, sd, strict=False)
    ]


def _equation(s: Samples, e: Equation, free: Sequence[int], group: Grouping, p: Array) -> Equation:
    """The residual with its slopes over the base parameters and some of those found."""
    n = s.q.shape[1]
    by_momentum, by_force = (
        np.moveaxis(np.array(x.full()).reshape(3, n, len(STANDARD)), 2, 0)[list(group.kept)]
        for x in regressor()(s.q, s.w, np.zeros_like(s.q), p)[:2]
    )
    slopes = [
        (momentum_balance.apply(s.filters.bump, f) - momentum_balance.apply(s.filters.slope, h)) * s.good
        for f, h in zip(by_force, by_momentum, strict=True)
    ]
    return Equation(e.error, np.concatenate([slopes, e.slope[list(free)]]))


TORQUE = ("kN.m", 1e3)
STEP = 3  # samples from one drawn point to the next


def panels(records: Sequence[Samples], solution: Solution) -> tuple[Panel, ...]:
    """Two for each joint, over the time of the first recording."""
    s, e = records[0], solution.equations[0]
    asked = -np.einsum("mrt,m->rt", e.slope, solution.values + solution.mean_effect)
    found = []
    for row, joint in enumerate(JOINTS):
        t, model, left = (x[s.good][::STEP] for x in (s.time[s.middle], asked[row], e.error[row]))
        torque = Panel(
            x_label=f"time, {joint}",
            y_label="torque",
            curves=(
                Curve("measured, filtered, less what is known", t, model + left, line=True),
                Curve("by the parameters found", t, model, "fit", line=True),
            ),
            title=joint,
            x_unit=("s", 1.0),
            y_unit=TORQUE,
        )
        rest = (Curve("measured - model", t, left, line=True),)
        found += [torque, replace(torque, y_label="residual", curves=rest, title="", y_unit=("N.m", 1.0))]
    return tuple(found)


SIGNALS: Mapping[str, str] = momentum_balance.SIGNALS
FREE = ("head_mass", "stick_inertia", "boom_inertia", "column_inertia")
DAMPINGS = ("swing_damping", "boom_piston_damping", "stick_piston_damping")
WINDOW = 0.4  # s: longer than usual, so that the small inertias, which show in fast motion only, are not bent
EVERY = 3  # smoothed samples thinned out: 67 per second of 200
TELLS = 0.25  # standard deviation over value above which data do not tell a parameter


def identify(
    recordings: Sequence[Recording], known: Mapping[str, Number], free: Sequence[str] = FREE
) -> Finding:
    """Masses and inertias `free` of the manipulator, from recordings of the machine, else of its joints."""
    own = _usable(recordings)
    p = numbers(known)
    records = [samples(r, JOINTS, p, window=WINDOW, every=EVERY) for r in own]
    names, dropped = list(free), list[str]()
    solution = _solve(records, names, p)
    while names and (worst := _worst(solution, len(names))) is not None:
        dropped.append(names.pop(worst))
        solution = _solve(records, names, p)
    return Finding(
        procedure="inertia",
        title="Inertial parameters: what the joints' torques ask for",
        figure=0,
        estimates=tuple(_estimate(solution, k, known) for k in range(len(names))),
        panels=panels(records, solution),
        remarks=tuple(_remarks(own, solution, names, dropped, known)),
        others=(*_dampings(solution, len(names)), *base_estimates(records, solution, p)),
    )


def _usable(recordings: Sequence[Recording]) -> list[Recording]:
    """Recordings to train with in which the machine moves: of the whole machine if there are any."""
    for procedure in ("machine", "damping"):
        if any(r.procedure == procedure and r.use == "train" for r in recordings):
            return list(training(recordings, procedure, SIGNALS))
    there = ", ".join(sorted({r.procedure for r in recordings})) or "no recording"
    raise Problem(f"inertia: expected a recording of the machine or of a joint to train with, found {there}")


def _solve(records: Sequence[Samples], names: Sequence[str], p: Array) -> Solution:
    theta = tuple(f"manipulator.{n}" for n in (*names, *DAMPINGS))
    return solve(records, JOINTS, theta, p)


def _worst(solution: Solution, count: int) -> int | None:
    """The parameter that the data tell least, if one is not told at all."""
    ratios = [sd / abs(value) for sd, value in zip(solution.sd, solution.values, strict=True)][:count]
    ratios = [math.inf if value <= 0 else r for r, value in zip(ratios, solution.values, strict=False)]
    return ratios.index(max(ratios)) if max(ratios) > TELLS else None


def _unit(name: str) -> str:
    return quantities(MANIPULATOR.parameters)[name].unit


def _estimate(solution: Solution, k: int, known: Mapping[str, Number]) -> Estimate:
    name = solution.theta[k].partition(".")[2]
    by_known = doubt(solution, k, known)
    note = "balance of the joints' momenta" + by_known.note()
    return symmetrical(name, float(solution.values[k]), _unit(name), by_known.total, note)


def _dampings(solution: Solution, first: int) -> list[Estimate]:
    found = zip(DAMPINGS, solution.values[first:], solution.sd[first:], strict=True)
    return [
        symmetrical(f"{n}, found along", float(v), _unit(n), float(sd), "unknown of the same balance")
        for n, v, sd in found
    ]


def _remarks(
    own: Sequence[Recording],
    solution: Solution,
    names: Sequence[str],
    dropped: Sequence[str],
    known: Mapping[str, Number],
) -> Iterator[str]:
    seconds = sum(float(r.time[-1] - r.time[0]) for r in own)
    yield f"{seconds:.3g} s of {len(own)} recordings are used: {', '.join(r.title for r in own)}."
    for name in dropped:
        yield f"{name}: this motion does not tell it; it stays as it is known."
    if solution.lacks:
        yield (
            "Noise does not explain the residuals: the model lacks something, such as dry friction or a head "
            "that swings. The intervals are those of the residuals."
        )
    for k, name in enumerate(names):
        for text in doubt(solution, k, known).remarks(float(solution.values[k]), _unit(name)):
            yield f"{name}: {text}"


__all__ = ["SIGNALS", "identify"]
