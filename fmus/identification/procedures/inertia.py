"""Inertial parameters from joint motion and torque; the paper took them from CAD.

The balance of momenta (`momentum_balance`) is linear in masses and moments of inertia about the centres of
mass, the geometry and the centres being known. All joints count; the dampings of swing and pistons are
estimated along with them, so that an error of theirs cannot go into the inertia. Parameters that the motion
does not determine stay as they are known, and the remarks name them.

What data can determine at best are the base parameters (`others`), combinations of the standard parameters of
the links (first row column, then boom and stick), in which momenta and forces are linear:

    J_0      m, m x, m z, S_xx, S_xz, S_zz         S_ab = int a b dm about the link's pivot

with slender links, all mass in the plane of the arm, and the head as part of the stick. Their columns are
derivatives of the manipulator's equations: m from the mass, m x from mass and centre, S_xx from the inertia,
S_xz and S_zz from the mass and the centre twice. Columns that the others make up are found by QR (Gautier
1991, J. Robotic Systems 8, 485) and their parameters added to the others.

Validity: rigid links, viscous friction; what is known is right.
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
from fmus.identification.estimate import Estimate
from fmus.identification.procedure_result import Curve, Panel, ProcedureResult
from fmus.identification.procedures import momentum_balance
from fmus.identification.procedures.experiment_data import training_recordings
from fmus.identification.procedures.momentum_balance import (
    JOINTS,
    PARAMETERS,
    MomentumEquation,
    SmoothedRecording,
    numbers,
    samples,
)
from fmus.identification.procedures.momentum_fit import (
    MomentumSolution,
    WeightedBalance,
    known_parameter_effect,
    normal_step,
    solve,
)
from fmus.manipulator import MANIPULATOR, arm
from fmus.manipulator.design import POINT_MASS
from fmus.parameters import Number
from orchestrator.base.errors import Problem
from orchestrator.data.recording import Recording

Array = NDArray[np.float64]
SIGNALS: Mapping[str, str] = momentum_balance.SIGNALS
FREE = ("head_mass", "stick_inertia", "boom_inertia", "column_inertia")
DAMPINGS = ("swing_damping", "boom_piston_damping", "stick_piston_damping")
WINDOW = 0.4  # s: longer than usual, so that the small inertias, which show in fast motion only, are not bent
EVERY = 3  # smoothed samples thinned out: 67 per second of 200
DETERMINED = 0.25  # standard deviation over value above which data do not determine a parameter
STEP = 3  # samples from one drawn point to the next
MOMENTS = {"m": "kg", "m x": "kg.m", "m z": "kg.m", "S_xx": "kg.m2", "S_xz": "kg.m2", "S_zz": "kg.m2"}
STANDARD = ("column J_0", *(f"{link} {moment}" for link in ("boom", "stick") for moment in MOMENTS))
UNITS = ("kg.m2", *(unit for _ in ("boom", "stick") for unit in MOMENTS.values()))
# the first of these that are independent are kept: moments about the pivots before masses
PREFERRED = [0, 2, 3, 4, 5, 6, 8, 9, 10, 11, 12, 1, 7]
RANK = 1e-9  # of the largest diagonal of R, below which a column is a combination of others


def identify(
    recordings: Sequence[Recording], known: Mapping[str, Number], free: Sequence[str] = FREE
) -> ProcedureResult:
    """Masses and inertias `free` of the manipulator, from recordings of the machine, else of its joints.

    The parameter that the data determine least is dropped until all that are left are determined.
    """
    procedures = [r.procedure for r in recordings if r.use == "train"]
    source = next((p for p in ("machine", "damping") if p in procedures), None)
    if source is None:
        there = ", ".join(sorted({r.procedure for r in recordings})) or "no recording"
        raise Problem(
            f"inertia: expected a recording of the machine or of a joint to train with, found {there}"
        )
    own, p = training_recordings(recordings, source, SIGNALS), numbers(known)
    records = [samples(r, JOINTS, p, window=WINDOW, every=EVERY) for r in own]
    names, dropped = list(free), list[str]()
    while True:
        theta = tuple(f"manipulator.{n}" for n in (*names, *DAMPINGS))
        solution = solve(records, JOINTS, theta, p)
        pairs = list(zip(solution.sd, solution.values, strict=True))
        ratios = [math.inf if x <= 0 else sd / abs(x) for sd, x in pairs[: len(names)]]
        if max(ratios, default=0.0) <= DETERMINED:
            break
        dropped.append(names.pop(ratios.index(max(ratios))))
    effects = {n: known_parameter_effect(solution, k, known) for k, n in enumerate(names)}
    values = dict(zip((*names, *DAMPINGS), map(float, solution.values), strict=True))
    units = {n: quantities(MANIPULATOR.parameters)[n].unit for n in values}
    note = "balance of the joints' momenta"
    dampings = [
        Estimate.normal(
            f"{n}, estimated along", values[n], units[n], float(sd), "unknown of the same balance"
        )
        for n, sd in zip(DAMPINGS, solution.sd[len(names) :], strict=True)
    ]
    return ProcedureResult(
        procedure="inertia",
        title="Inertial parameters: what the joints' torques ask for",
        figure=0,
        estimates=tuple(
            Estimate.normal(n, values[n], units[n], e.total, note + e.note()) for n, e in effects.items()
        ),
        panels=panels(records, solution),
        remarks=(
            *_remarks(own, solution, dropped),
            *(f"{n}: {text}" for n, e in effects.items() for text in e.remarks(values[n], units[n])),
        ),
        others=(*dampings, *base_estimates(records, solution, p)),
    )


def _remarks(own: Sequence[Recording], solution: MomentumSolution, dropped: Sequence[str]) -> Iterator[str]:
    seconds = sum(float(r.time[-1] - r.time[0]) for r in own)
    yield f"{seconds:.3g} s of {len(own)} recordings are used: {', '.join(r.title for r in own)}."
    for name in dropped:
        yield f"{name}: this motion does not tell it; it stays as it is known."
    if solution.lacks:
        yield (
            "Noise does not explain the residuals: the model lacks something, such as dry friction or a head "
            "that swings. The intervals are those of the residuals."
        )


@lru_cache(maxsize=1)
def regressor() -> ca.Function:
    """(q, q', q'', p) -> dh/dpi, df/dpi and torques by pi, each (3, 13) next to each other."""
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
    pi = [v["column_inertia"]]
    for link in ("boom", "stick"):
        m, x, z = v[f"{link}_mass"], v[f"{link}_centre_x"], v[f"{link}_centre_z"]
        pi += [m, m * x, m * z, v[f"{link}_inertia"] + m * x**2, m * x * z, m * z**2]
    head, length = v["head_mass"], v["stick_length"]
    pi[7] += head
    pi[8] += head * length
    pi[10] += head * length**2
    return np.array(pi)


@dataclass(frozen=True)
class Grouping:
    """Base parameters beta = pi[kept] + share pi[others]; `share` has shape (kept, others)."""

    kept: tuple[int, ...]
    others: tuple[int, ...]
    share: Array

    def values(self, pi: Array) -> Array:
        """beta."""
        beta: Array = pi[list(self.kept)] + self.share @ pi[list(self.others)]
        return beta

    def names(self) -> list[str]:
        """What each is made of."""
        names = []
        for k, row in zip(self.kept, self.share, strict=True):
            parts = [f"{c:+.4g} {STANDARD[o]}" for c, o in zip(row, self.others, strict=True) if c]
            names.append(" ".join([STANDARD[k], *parts]))
        return names


def grouping(p: Array, states: int = 200) -> Grouping:
    """Which standard parameters any motion can tell, from the regressor at random states."""
    random = np.random.default_rng(0)  # any states do: rank and combinations do not depend on them
    q, w, a = (random.uniform(-2.0, 2.0, (3, states)) for _ in range(3))
    full = np.array(regressor()(q, w, a, p)[2].full())
    y = full.reshape(3, states, len(STANDARD)).reshape(-1, len(STANDARD))
    scale = np.linalg.norm(y, axis=0)
    diagonal = np.abs(np.diag(scipy.linalg.qr((y / scale)[:, PREFERRED], mode="r")[0]))
    independent = diagonal > RANK * diagonal.max()
    kept, others = np.array(PREFERRED)[independent], np.array(PREFERRED)[~independent]
    share = np.linalg.lstsq(y[:, kept] / scale[kept], y[:, others] / scale[others], rcond=None)[0]
    share = share * scale[others] / scale[kept][:, None]
    return Grouping(
        tuple(map(int, kept)), tuple(map(int, others)), np.where(np.abs(share) < 1e-9, 0.0, share)
    )


def base_estimates(
    records: Sequence[SmoothedRecording], solution: MomentumSolution, p: Array
) -> list[Estimate]:
    """All base parameters, with the dampings among those of the solution as further unknowns."""
    at = p.copy()
    at[[PARAMETERS.index(n) for n in solution.theta]] = solution.values + solution.mean_effect
    group = grouping(at)
    free = [k for k, n in enumerate(solution.theta) if n.endswith("damping")]
    equations = [
        _base_equation(s, e, free, group, at) for s, e in zip(records, solution.equations, strict=True)
    ]
    names = tuple(group.names())
    normal, step = normal_step(equations, solution.weights, (*names, *(solution.theta[k] for k in free)))
    fit = WeightedBalance(names, [0, 1, 2], solution.weights, np.array(np.linalg.inv(normal), float), at)
    moved = [e.moved(step) for e in equations]
    lacks = solution.lacks
    covariance = fit.residual_covariance(records, moved) if lacks else fit.noise(records, moved)[0]
    values = group.values(standard(at)) + step[: len(names)]
    sds, units = np.sqrt(np.diag(covariance)), [UNITS[k] for k in group.kept]
    note = "base parameter: what any motion can tell at most"
    return [
        Estimate.normal(name, float(value), unit, float(sd), note)
        for name, value, unit, sd in zip(names, values, units, sds, strict=False)
    ]


def _base_equation(
    s: SmoothedRecording, e: MomentumEquation, free: Sequence[int], group: Grouping, p: Array
) -> MomentumEquation:
    """The residual with its slopes over the base parameters and some of those of the solution."""
    by_momentum, by_force = (
        np.moveaxis(x.full().reshape(3, s.q.shape[1], len(STANDARD)), 2, 0)[list(group.kept)]
        for x in regressor()(s.q, s.w, np.zeros_like(s.q), p)[:2]
    )
    slopes = [s.filtered(f, h) for f, h in zip(by_force, by_momentum, strict=True)]
    return MomentumEquation(e.error, np.concatenate([slopes, e.slope[list(free)]]))


def panels(records: Sequence[SmoothedRecording], solution: MomentumSolution) -> tuple[Panel, ...]:
    """Two for each joint, over the time of the first recording."""
    s, e = records[0], solution.equations[0]
    asked = -np.einsum("mrt,m->rt", e.slope, solution.values + solution.mean_effect)
    every: list[Panel] = []
    for row, joint in enumerate(JOINTS):
        t, model, left = (x[s.good][::STEP] for x in (s.time[s.middle], asked[row], e.error[row]))
        torque = Panel(
            x_label=f"time, {joint}",
            y_label="torque",
            curves=(
                Curve("measured, filtered, less what is known", t, model + left, line=True),
                Curve("by the estimates", t, model, "fit", line=True),
            ),
            title=joint,
            x_unit=("s", 1.0),
            y_unit=("kN.m", 1e3),
        )
        rest = (Curve("measured - model", t, left, line=True),)
        every += [torque, replace(torque, y_label="residual", curves=rest, title="", y_unit=("N.m", 1.0))]
    return tuple(every)
