"""Speeds of the axes of a crane at full command, by the equations of its drives.

One axis moves at a time, with the lever J, the inertia M and the weight G that it has in the start pose,

    M w' = J F - (b + J^2 R) w - (T_c + |J| F_c) sign(w) - G         T_c, F_c: dry friction at fast slip

and the drive and its supply are integrated until they are steady. The speed is the mean of the last half,
because a counterbalance valve may keep an axis swinging.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import casadi as ca
import numpy as np

from fmus.contract import Subsystem, Symbolic, column, symbolic
from fmus.crane.axes import SUPPLIES, AxisCheck, Speeds, at_start
from fmus.crane.description import CraneDescription
from fmus.crane.machine import drives, with_pressures
from fmus.machine.machine import wiring
from fmus.monolith import Monolith, join, start_values
from fmus.parameters import values
from fmus.supply import supply
from orchestrator.data.table import Array

STEADY, FULL = 10.0, 10.0  # s, V
SLIDING = 1e-3  # rad/s or m/s, over which the sign of dry friction is rounded: below any speed that is shown
OPTIONS = {"reltol": 1e-5, "abstol": 1e-6, "max_num_steps": 100_000, "show_eval_warnings": False}


AXIS, PART = "axis", "drives"  # names in the equations, which axes of one structure share


def full_speeds(
    crane: CraneDescription, found: Sequence[AxisCheck], variants: Sequence[str] = tuple(SUPPLIES)
) -> dict[str, Speeds]:
    """Of each joint; negative: against the command; NaN: no steady motion."""
    made = dict[tuple[Any, ...], _Moving]()
    return {a.joint.name: {v: _speeds(crane, a, v, made) for v in variants} for a in found}


@dataclass(frozen=True)
class _Moving:
    """An axis in motion: its drive and supply as one ODE in the states over their nominal values.

    solver   start, P -> states at half of the time and at its end; P: inputs, parameters, `_own`
    oil      states, speed, P -> speed of the oil in its hoses [m/s]
    """

    model: Monolith
    solver: ca.Function
    oil: ca.Function

    @classmethod
    def of(cls, model: Monolith, motor: bool) -> _Moving:
        """The equations of an axis."""
        effort, motion = ("torque", "speed") if motor else ("force", "velocity")
        x, w, p = ca.SX.sym("x", len(model.states)), ca.SX.sym("w"), ca.SX.sym("p", model.p.size)
        u, own = ca.SX.sym("u", len(model.inputs)), ca.SX.sym("own", 5)
        lever, inertia, viscous, dry, holding = ca.vertsplit(own)
        given = dict(zip(model.inputs, ca.vertsplit(u), strict=True)) | {f"{AXIS}_{motion}": lever * w}
        inputs, parameters = column(*given.values()), ca.vertcat(u, p, own)
        y = dict(zip(model.output_names, ca.vertsplit(model.outputs(x, inputs, p)), strict=True))
        friction = viscous * w + dry * ca.tanh(w / SLIDING)
        torque = lever * (y[f"{PART}.{AXIS}_{effort}"] - holding) - friction
        rates = column(model.right_hand_side(x, inputs, p), torque / inertia, w)
        of = ca.Function("of", [x, w, parameters], [rates, y[f"{PART}.{AXIS}_oil_velocity"]], {"cse": True})
        nominal, z = np.append(model.nominal, [1, 1]), ca.SX.sym("z", len(model.states) + 2)
        rate = of(z[:-2] * model.nominal, z[-2], parameters)[0] / nominal
        ode = {"x": z, "p": parameters, "ode": rate}
        solver = ca.integrator("steady", "cvodes", ode, 0.0, [STEADY / 2, STEADY], OPTIONS)
        return cls(model, solver, of)


@lru_cache(maxsize=16)
def _fed(crane: CraneDescription, variant: str) -> tuple[Subsystem, Symbolic]:
    """The supply of one part."""
    fed = with_pressures(supply([PART])[SUPPLIES[variant]], crane)
    return fed, symbolic(fed)


def _speeds(
    crane: CraneDescription, a: AxisCheck, variant: str, made: dict[tuple[Any, ...], _Moving]
) -> tuple[float, float, float]:
    (fed, known), name = _fed(crane, variant), f"{a.joint.name}_"
    pose = {n.replace(name, f"{AXIS}_", 1): x for n, x in at_start(crane).items() if n.startswith(name)}
    joint = replace(a.joint, name=AXIS, part=PART)
    chosen = {PART: drives(crane, PART, [joint], pose, variant), fed.component: fed}
    connections, inputs = wiring(chosen)
    key = variant, joint.motor, joint.additions, joint.held
    if key not in made:
        model = join(chosen, connections, inputs, known={fed.component: known})
        made[key] = _Moving.of(model, joint.motor)
    start = start_values({n: values(sub) for n, sub in chosen.items()}, inputs)
    (out, oil_out), (inwards, oil_inwards) = (_steady(made[key], start, a, pose, s) for s in (1.0, -1.0))
    return out, inwards, max(oil_out, oil_inwards)


def _steady(
    axis: _Moving, start: tuple[Array, Array, Array], a: AxisCheck, pose: Mapping[str, float], sign: float
) -> tuple[float, float]:
    """Speed of the joint, and of the oil in its hoses, at full command of a sign."""
    motor, model, (x, u, p) = a.joint.motor, axis.model, start
    u = np.where(np.array(model.inputs) == f"{AXIS}_command", sign * FULL, u)
    dry, viscous = a.joint["coulomb"], a.damping
    if not motor:
        viscous += a.lever**2 * a.joint["piston_damping"]
        dry += abs(a.lever) * a.joint["piston_coulomb"]
    holding = pose[f"{AXIS}_holding_{'torque' if motor else 'force'}"]
    given = np.concatenate([u, p, [a.lever, a.inertia, viscous, dry, holding]])
    nominal = np.append(model.nominal, [1, 1])
    begin = np.append(model.start(x, start[1], p).full()[:, 0], [0, 0])
    try:
        half, whole = axis.solver(x0=begin / nominal, p=given)["xf"].full().T * nominal
    except RuntimeError:
        return math.nan, math.nan
    speed = float(whole[-1] - half[-1]) / (STEADY / 2)
    return sign * math.copysign(speed, speed * a.lever), float(axis.oil(whole[:-2], whole[-2], given)[1])
