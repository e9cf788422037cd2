"""Inertia procedure: masses and moments of inertia from joint motion and torque (the paper uses CAD values).

The momentum balance (`momentum_balance`) is linear in masses and in moments of inertia about the centres of
mass, if geometry and centres are known. All joints are fitted together. The dampings of swing and pistons are
further unknowns, so that errors of their known values do not bias the inertia. Parameters that the motion
does not determine keep their known values, and the remarks list them.

Data can at best determine the base parameters (`others` of the result). These are combinations of the
standard parameters of the links (column, then boom and stick), in which momenta and forces are linear:

    J_0      m, m x, m z, S_xx, S_xz, S_zz         S_ab = int a b dm about the link's pivot

The links are slender, their mass is in the plane of the arm, and the head is a part of the stick. The
regressors are derivatives of the manipulator's equations: m with respect to the mass, m x to mass and centre,
S_xx to the inertia, S_xz and S_zz to the mass and twice the centre. QR decomposition finds the linearly
dependent regressors (Gautier 1991, J. Robotic Systems 8, 485); their parameters are added to the others.

Validity: rigid links, viscous friction, correct known parameters.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache

import casadi as ca
import numpy as np
import scipy.linalg

from fmus.contract import quantities
from fmus.identification import balance
from fmus.identification.balance import Normal, Solution, flat
from fmus.identification.procedures import experiment_data as data
from fmus.identification.procedures import momentum_balance as momentum
from fmus.identification.results import Curve, Estimate, Panel, ProcedureResult
from fmus.manipulator import MANIPULATOR
from fmus.parameters import Number
from orchestrator.base.errors import Problem
from orchestrator.data.recording import Recording
from orchestrator.data.table import Array

SIGNALS: Mapping[str, str] = momentum.SIGNALS
FREE = ("head_mass", "stick_inertia", "boom_inertia", "column_inertia")
DAMPINGS = ("swing_damping", "boom_piston_damping", "stick_piston_damping")
WINDOW = 0.4  # s: longer than by default, because small inertias are only visible in fast motion
MOMENTS = {"m": "kg", "m x": "kg.m", "m z": "kg.m", "S_xx": "kg.m2", "S_xz": "kg.m2", "S_zz": "kg.m2"}
STANDARD = ("column J_0", *(f"{link} {moment}" for link in ("boom", "stick") for moment in MOMENTS))
UNITS = ("kg.m2", *(unit for _ in ("boom", "stick") for unit in MOMENTS.values()))
# order in which independent standard parameters are chosen: moments about the pivots before masses
PREFERRED = [0, 2, 3, 4, 5, 6, 8, 9, 10, 11, 12, 1, 7]
STATES = 200  # random states from which the base parameters are determined
RANK_TOLERANCE = 1e-9  # relative diagonal of R below which a regressor depends on others


def identify(recordings: Sequence[Recording], parameters: Mapping[str, Number]) -> ProcedureResult:
    """Masses and inertias `FREE` of the manipulator, from recordings of the machine, else of its joints.

    The least determined parameter is dropped until all remaining ones are determined.
    """
    procedures = [r.procedure for r in recordings if r.use == "train"]
    source = next((p for p in ("machine", "damping") if p in procedures), None)
    if source is None:
        present = ", ".join(sorted({r.procedure for r in recordings})) or "no recording"
        raise Problem(
            f'inertia: expected a recording of the machine or of a joint with use = "train", got {present}'
        )
    training, p = data.training_recordings(recordings, source, SIGNALS), momentum.parameter_vector(parameters)
    names, dropped, limits = list(FREE), list[str](), data.declared_limits(training, momentum.ALL_PRESSURES)
    while True:
        theta = tuple(f"manipulator.{n}" for n in (*names, *DAMPINGS))
        records = [momentum.joint_recording(r, momentum.JOINTS, theta, p, window=WINDOW) for r in training]
        start = {n: parameters[n].value for n in theta}
        solution = balance.solve([r.samples for r in records], start, "inertia", limits)
        fit = solution.fit
        relative = [fit.sd(n) / fit[n] if fit[n] > 0 else math.inf for n in theta[: len(names)]]
        if max(relative, default=0.0) <= balance.DETERMINED:
            break
        dropped.append(names.pop(relative.index(max(relative))))
    effects, declared = momentum.known_parameter_effects(solution, parameters), MANIPULATOR.parameters
    note, units = "balance of the joints' momenta", {n: q.unit for n, q in quantities(declared).items()}
    by_name = {n: effects[f"manipulator.{n}"] for n in names}
    seconds = sum(float(r.time[-1] - r.time[0]) for r in training)
    titles = ", ".join(r.title for r in training)
    misfit = (
        "Noise does not explain the residuals: the model is incomplete, for instance without dry "
        "friction or a swinging head. The intervals are those of the residuals."
    )
    return ProcedureResult(
        procedure="inertia",
        title="Inertial parameters from the torques of the joints",
        figure=0,
        estimates=tuple(
            Estimate.normal(n, fit[f"manipulator.{n}"], units[n], e.total, note + e.note)
            for n, e in by_name.items()
        ),
        panels=panels(records[0], solution),
        remarks=(
            f"{seconds:.3g} s of {len(training)} recordings are used: {titles}.",
            *(
                f"{n}: this motion does not determine the parameter, which keeps its known value."
                for n in dropped
            ),
            *([misfit] if fit.misfit else []),
            *(f"{n}: {text}" for n, e in by_name.items() for text in e.remarks),
        ),
        others=(
            *(fit.estimate(f"{n}, further unknown", units[n], note, f"manipulator.{n}") for n in DAMPINGS),
            *base_estimates(records, solution, p),
        ),
        findings=(
            balance.shift_finding(solution, momentum.ALL_PRESSURES, "inertia"),
            *balance.zero_findings(solution, "inertia"),
            *data.signal_findings(training, SIGNALS, "inertia"),
            balance.model_finding(solution, "inertia"),
        ),
    )


@lru_cache(maxsize=1)
def regressor() -> ca.Function:
    """(q, q', q'', p) -> derivatives of h, f and torques with respect to pi, each (3, 13) side by side."""
    e, a = momentum.symbolic_equations(), ca.SX.sym("a", 3)
    by_momentum, by_force = (_by_standard_parameters(term, e.p) for term in (e.momentum, e.force))
    rate = [ca.jtimes(h, e.q, e.w) + ca.jtimes(h, e.w, a) for h in ca.horzsplit(by_momentum)]
    terms = [by_momentum, by_force, ca.horzcat(*rate) - by_force]
    return ca.Function("regressor", [e.q, e.w, a, e.p], [ca.densify(t) for t in terms])


def _by_standard_parameters(term: ca.SX, p: ca.SX) -> ca.SX:
    """Derivatives of momenta or forces with respect to the standard parameters, shape (3, 13)."""
    own = {n: p[k] for k, n in enumerate(momentum.PARAMETERS)}
    columns = [ca.jacobian(term, own["manipulator.column_inertia"])]
    for link in ("boom", "stick"):
        names = ("mass", "inertia", "centre_x", "centre_z")
        mass, inertia, cx, cz = (own[f"manipulator.{link}_{n}"] for n in names)
        by_mass = ca.jacobian(term, mass)
        by_x, by_z = ca.jacobian(by_mass, cx), ca.jacobian(by_mass, cz)
        at_pivot = [by_mass, by_x, by_z, ca.jacobian(by_x, cz), ca.jacobian(by_z, cz) / 2]
        m, mx, mz, xz, zz = ca.substitute(at_pivot, [ca.vertcat(cx, cz)], [ca.DM.zeros(2)])
        columns += [m, mx, mz, ca.jacobian(term, inertia), xz, zz]
    return ca.horzcat(*columns)


def standard(p: Array) -> Array:
    """The standard parameters, shape (13,), from those of the machine."""
    v = {
        n.partition(".")[2]: x
        for n, x in zip(momentum.PARAMETERS, p, strict=True)
        if n.startswith("manipulator.")
    }
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
    """Base parameters beta = pi[kept] + weights pi[others]; `weights` has shape (kept, others)."""

    kept: tuple[int, ...]
    others: tuple[int, ...]
    weights: Array

    def values(self, pi: Array) -> Array:
        """beta."""
        beta: Array = pi[list(self.kept)] + self.weights @ pi[list(self.others)]
        return beta

    def names(self) -> list[str]:
        """Each base parameter as a sum of standard parameters."""
        names = []
        for k, row in zip(self.kept, self.weights, strict=True):
            terms = [f"{c:+.4g} {STANDARD[o]}" for c, o in zip(row, self.others, strict=True) if c]
            names.append(" ".join([STANDARD[k], *terms]))
        return names


def grouping(p: Array) -> Grouping:
    """Base parameters that any motion can determine, from the regressor at random states."""
    random = np.random.default_rng(0)  # rank and combinations do not depend on the states
    q, w, a = (random.uniform(-2.0, 2.0, (3, STATES)) for _ in range(3))
    columns = np.array(regressor()(q, w, a, p)[2].full())
    y = columns.reshape(3, STATES, len(STANDARD)).reshape(-1, len(STANDARD))
    scale = np.linalg.norm(y, axis=0)
    diagonal = np.abs(np.diag(scipy.linalg.qr((y / scale)[:, PREFERRED], mode="r")[0]))
    independent = diagonal > RANK_TOLERANCE * diagonal.max()
    kept, others = np.array(PREFERRED)[independent], np.array(PREFERRED)[~independent]
    weights = np.linalg.lstsq(y[:, kept] / scale[kept], y[:, others] / scale[others], rcond=None)[0]
    weights = weights * scale[others] / scale[kept][:, None]
    weights = np.where(np.abs(weights) < 1e-9, 0.0, weights)
    return Grouping(tuple(map(int, kept)), tuple(map(int, others)), weights)


def base_estimates(
    records: Sequence[momentum.JointRecording], solution: Solution, p: Array
) -> Iterator[Estimate]:
    """All base parameters, estimated together with the dampings and zeros, in one step from the solution."""
    estimated, fit, parts = p.copy(), solution.fit, []
    estimated[[momentum.PARAMETERS.index(n) for n in fit.names]] = fit.values
    group = grouping(estimated)
    for r, part in zip(records, solution.parts, strict=True):
        by_momentum, by_force = (
            np.moveaxis(x.full().reshape(3, r.z.shape[1], len(STANDARD)), 2, 0)[list(group.kept)]
            for x in regressor()(r.z[:3], r.z[3:6], np.zeros_like(r.z[:3]), estimated)[:2]
        )
        parts.append(part.whiten(flat(r.samples.integral(by_force, by_momentum))))
    own = [k for k, n in enumerate(fit.names) if not n.endswith("damping")]
    normal = Normal(
        np.concatenate([np.concatenate(parts, axis=1), np.delete(solution.normal.columns, own, axis=0)]),
        np.concatenate([np.zeros(len(group.kept)), np.delete(solution.normal.prior, own)]),
    )
    step, covariance = normal.step(solution.residual), normal.inverse
    if fit.misfit:
        covariance = normal.covariance(solution.residual, solution.samples, fit.times_noise**2)
    note = "base parameter: combination that any motion can determine"
    for name, k, value, change, variance in zip(
        group.names(), group.kept, group.values(standard(estimated)), step, np.diag(covariance), strict=False
    ):
        yield Estimate.normal(name, float(value + change), UNITS[k], math.sqrt(variance), note)


def panels(record: momentum.JointRecording, solution: Solution) -> tuple[Panel, ...]:
    """Torque and residual of each joint over the time of one recording."""
    linear = solution.parts[0].linear
    by_estimates = -np.einsum("mrt,m->rt", linear.by_theta, solution.fit.values)
    result: list[Panel] = []
    for joint, model, residual in zip(momentum.JOINTS, by_estimates, linear.e, strict=True):
        measured = Curve("measured, filtered, minus known terms", model, model + residual, line=True)
        fit = Curve("by the estimates", model, model, "fit", line=True)
        label = (f"time, {joint}", "torque")
        result += momentum.torque_panels(label, joint, record, measured, fit, "measured - model")
    return tuple(result)
