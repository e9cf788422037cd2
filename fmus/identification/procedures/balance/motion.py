"""The machine's equation of motion as measured signals see it, for procedures that ask for its parameters.

Paper eq. (4) without the acceleration, by the generalised momenta h = M(q) q':

    dh/dt = f        f = tau + dT/dq - G        dT/dq = dM/dt q' - V

with M, V, G and tau of `fmus.manipulator` and the hydraulic torque and forces of `fmus.swing` (motor ports by
line resistance and leakage) and `fmus.boom_stick`, of measured pressures. Nothing is written twice.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import casadi as ca

from fmus.boom_stick import BOOM_STICK
from fmus.contract import Subsystem, quantities, symbolic, symbols
from fmus.manipulator import MANIPULATOR, arm
from fmus.manipulator.design import POINT_MASS, VISCOUS
from fmus.manipulator.model import Design, forces
from fmus.manipulator.variables import ManipulatorInputs
from fmus.swing import SWING

JOINTS = ("swing", "boom", "stick")
ANGLES = tuple(f"manipulator.{j}_angle" for j in JOINTS)
PRESSURES = {
    "swing": ("swing.swing_pressure_a", "swing.swing_pressure_b"),
    "boom": ("boom_stick.boom_head_pressure", "boom_stick.boom_rod_pressure"),
    "stick": ("boom_stick.stick_head_pressure", "boom_stick.stick_rod_pressure"),
}
ALL_PRESSURES = tuple(name for both in PRESSURES.values() for name in both)
SIGNALS = dict.fromkeys(ANGLES, "rad") | dict.fromkeys(ALL_PRESSURES, "Pa")
_LUMPED = Design(MANIPULATOR.states, MANIPULATOR.outputs, POINT_MASS, VISCOUS)
_PARTS = (SWING, BOOM_STICK, MANIPULATOR)
PARAMETERS = tuple(f"{sub.name}.{n}" for sub in _PARTS for n in quantities(sub.parameters))


@dataclass(frozen=True)
class Motion:
    """Functions of (q, q', pressures, tank pressure, parameters), each column one sample.

    balance    -> h, f, each (3, n)
    slopes     -> dh/dtheta, df/dtheta, each (3 m, n), column by column
    gradients  -> entries of d(f, h)/d(q, q', pressures, parameters) that are not zero, (entries, n)
    entries    their rows, 0 to 5, and columns
    sway       -> d(f, df/dtheta.., h, dh/dtheta..)/dq', (3 * 2 * (1 + m) * 3, n), the speed slowest
    bend       -> d2f/dq_k'^2, (3 * 3, n), the speed k slowest
    pistons    (q, parameters) -> positions and moment arms of boom and stick, each (2, n)
    printed    (q, q', q'', ...) -> f - dh/dt, df_i/dq_i', x_i'/q_i', each (3, n); the first as (13) prints it
    """

    theta: tuple[str, ...]
    balance: ca.Function
    slopes: ca.Function
    gradients: ca.Function
    entries: tuple[tuple[int, int], ...]
    sway: ca.Function
    bend: ca.Function
    pistons: ca.Function
    printed: ca.Function


@dataclass(frozen=True)
class _Symbols:
    q: ca.SX
    w: ca.SX
    pressures: ca.SX
    tank: ca.SX
    p: ca.SX
    momentum: ca.SX
    force: ca.SX
    position: ca.SX
    lever: ca.SX


@lru_cache(maxsize=1)
def _equations() -> _Symbols:
    q, w = ca.SX.sym("q", 3), ca.SX.sym("w", 3)
    pressures, tank = ca.SX.sym("pressure", len(ALL_PRESSURES)), ca.SX.sym("tank")
    p = ca.SX.sym("p", len(PARAMETERS))
    x, own = symbols(MANIPULATOR.states), symbols(MANIPULATOR.parameters)
    u = symbols(ManipulatorInputs)
    measured = dict(zip(ALL_PRESSURES, ca.vertsplit(pressures), strict=True)) | {"swing.swing_speed": w[0]}
    hydraulics = [
        _output(SWING, "swing_torque", measured, tank, p),
        _output(BOOM_STICK, "boom_force", measured, tank, p),
        _output(BOOM_STICK, "stick_force", measured, tank, p),
    ]
    motion, rods = arm.mechanics(x, own, POINT_MASS), arm.pistons(x, own)
    tau = forces(_LUMPED, x, u, own)
    terms = [motion.mass, motion.coriolis, motion.gravity, tau]
    terms += [ca.vertcat(*(r.position for r in rods)), ca.vertcat(*(r.triangle.arm for r in rods))]
    coordinates = [getattr(x, f"{j}_{kind}") for kind in ("angle", "speed") for j in JOINTS]
    applied = [u.swing_torque, u.boom_force, u.stick_force]
    old = ca.vertcat(*coordinates, *applied, *vars(own).values())
    new = ca.vertcat(q, w, *hydraulics, *_own(MANIPULATOR, p))
    mass, coriolis, gravity, tau, position, lever = ca.substitute(terms, [old], [new])
    momentum = mass @ w
    force = tau + ca.jtimes(momentum, q, w) - coriolis - gravity
    return _Symbols(q, w, pressures, tank, p, momentum, force, position, lever)


def _own(sub: Subsystem, p: ca.SX) -> list[ca.SX]:
    """The part's own parameters among those of the machine."""
    return [p[PARAMETERS.index(f"{sub.name}.{n}")] for n in quantities(sub.parameters)]


def _output(sub: Subsystem, name: str, measured: dict[str, Any], tank: ca.SX, p: ca.SX) -> ca.SX:
    """One output of a drive at measured pressures; it must not depend on what is not measured."""
    model = symbolic(sub)
    given = measured | {f"{sub.name}.tank_pressure": tank}
    declared = [
        (n, s)
        for group, column in ((sub.states, model.x), (sub.inputs, model.u))
        for n, s in zip(quantities(group), ca.vertsplit(column), strict=True)
    ]
    old = [s for n, s in declared if f"{sub.name}.{n}" in given]
    new = [given[f"{sub.name}.{n}"] for n, _ in declared if f"{sub.name}.{n}" in given]
    wanted = model.y[list(quantities(sub.outputs)).index(name)]
    return ca.substitute(wanted, ca.vertcat(*old, model.p), ca.vertcat(*new, *_own(sub, p)))


@lru_cache(maxsize=8)
def motion(theta: tuple[str, ...]) -> Motion:
    """The functions for these parameters."""
    e = _equations()
    unknown = ca.vertcat(*(e.p[PARAMETERS.index(n)] for n in theta))
    known = [e.q, e.w, e.pressures, e.tank, e.p]
    acceleration = ca.SX.sym("a", 3)
    slopes = [ca.vec(ca.jacobian(t, unknown)) for t in (e.momentum, e.force)]
    full = ca.jacobian(ca.vertcat(e.force, e.momentum), ca.vertcat(e.q, e.w, e.pressures, e.p))
    entries = tuple(zip(full.sparsity().row(), full.sparsity().get_col(), strict=True))
    own, levers = ca.diag(ca.jacobian(e.force, e.w)), ca.vertcat(1, e.lever)
    stacked = ca.vertcat(e.force, slopes[1], e.momentum, slopes[0])
    bend = [ca.jacobian(ca.jacobian(e.force, speed), speed) for speed in ca.vertsplit(e.w)]
    rate = ca.jtimes(e.momentum, e.q, e.w) + ca.jtimes(e.momentum, e.w, acceleration)
    return Motion(
        theta,
        ca.Function("balance", known, [e.momentum, e.force]),
        ca.Function("slopes", known, slopes),
        ca.Function("gradients", known, [full.nz[:]]),
        entries,
        ca.Function("sway", known, [ca.densify(ca.vec(ca.jacobian(stacked, e.w)))]),
        ca.Function("bend", known, [ca.densify(ca.vertcat(*bend))]),
        ca.Function("pistons", [e.q, e.p], [e.position, e.lever]),
        ca.Function("printed", [e.q, e.w, acceleration, *known[2:]], [e.force - rate, own, levers]),
    )
