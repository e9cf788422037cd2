"""Speeds of the axes of a crane at full command, by the equations of its drives.

One axis moves at a time, with the lever J, the inertia M and the weight G that it has in the start pose,

    M w' = J F - (b + J^2 R) w - (T_c + |J| F_c) sign(w) - G         T_c, F_c: dry friction at fast slip

and the drive and its supply are integrated until they are steady. The speed is the mean of the last half,
because a counterbalance valve may keep an axis swinging.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Any

import casadi as ca
import numpy as np

from fmus.contract import Subsystem, Symbolic, column, symbolic
from fmus.crane.axes import SUPPLIES, AxisCheck, Speeds, at_start
from fmus.crane.description import CraneDescription
from fmus.crane.machine import drives, with_pressures
from fmus.machine.machine import wiring
from fmus.monolith import Monolith, join
from fmus.supply import supply

STEADY, FULL = 10.0, 10.0  # s, V
SLIDING = 1e-3  # rad/s or m/s, over which the sign of dry friction is rounded: below any speed that is shown
OPTIONS = {"reltol": 1e-5, "abstol": 1e-6, "max_num_steps": 100_000, "show_eval_warnings": False}


def full_speeds(
    crane: CraneDescription, found: Sequence[AxisCheck], variants: Sequence[str] = tuple(SUPPLIES)
) -> dict[str, Speeds]:
    """Of each joint; negative: against the command; NaN: no steady motion."""
    return {a.joint.name: {v: _speeds(crane, a, v) for v in variants} for a in found}


@lru_cache(maxsize=16)
def _fed(crane: CraneDescription, part: str, variant: str) -> tuple[Subsystem, Symbolic]:
    """The supply of one part."""
    fed = with_pressures(supply([part])[SUPPLIES[variant]], crane)
    return fed, symbolic(fed)


def _speeds(crane: CraneDescription, a: AxisCheck, variant: str) -> tuple[float, float, float]:
    pose, (fed, known) = at_start(crane), _fed(crane, a.joint.part, variant)
    chosen = {a.joint.part: drives(crane, a.joint.part, [a.joint], pose, variant), fed.component: fed}
    model = join(chosen, *wiring(chosen), known={fed.component: known})
    (out, oil_out), (inwards, oil_inwards) = (_steady(model, a, pose, sign) for sign in (1.0, -1.0))
    return out, inwards, max(oil_out, oil_inwards)


def _steady(model: Monolith, a: AxisCheck, pose: Mapping[str, float], sign: float) -> tuple[float, float]:
    """Speed of the joint, and of the oil in its hoses, at full command of a sign."""
    name, motor = a.joint.name, a.joint.motor
    effort, motion = ("torque", "speed") if motor else ("force", "velocity")
    viscous = a.damping + (0.0 if motor else a.lever**2 * a.joint["piston_damping"])
    x, w = ca.SX.sym("x", len(model.states)), ca.SX.sym("w")
    given: dict[str, Any] = dict(zip(model.inputs, map(float, model.u), strict=True))
    given |= {f"{name}_command": sign * FULL, f"{name}_{motion}": a.lever * w}
    u = column(*given.values())
    y = dict(zip(model.output_names, ca.vertsplit(model.outputs(x, u, model.p)), strict=True))
    own = f"{a.joint.part}.{name}_"
    dry = a.joint["coulomb"]
    dry += 0.0 if motor else abs(a.lever) * a.joint["piston_coulomb"]
    friction = viscous * w + dry * ca.tanh(w / SLIDING)
    torque = a.lever * (y[own + effort] - pose[f"{name}_holding_{effort}"]) - friction
    rates = column(model.right_hand_side(x, u, model.p), torque / a.inertia, w)
    of = ca.Function("of", [x, w], [rates, y[own + "oil_velocity"]])
    nominal, z = np.append(model.nominal, [1, 1]), ca.SX.sym("z", len(model.states) + 2)
    ode = {"x": z, "ode": of(z[:-2] * model.nominal, z[-2])[0] / nominal}
    solver = ca.integrator("steady", "cvodes", ode, 0.0, [STEADY / 2, STEADY], OPTIONS)
    start = np.append(model.start(model.x, model.u, model.p).full()[:, 0], [0, 0])
    try:
        half, whole = solver(x0=start / nominal)["xf"].full().T * nominal
    except RuntimeError:
        return math.nan, math.nan
    speed = float(whole[-1] - half[-1]) / (STEADY / 2)
    return sign * math.copysign(speed, speed * a.lever), float(of(whole[:-2], whole[-2])[1])
