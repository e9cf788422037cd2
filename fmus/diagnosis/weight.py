"""Payload by one cylinder, by Lagrange's equations with the energies T and V of the arm:

    tau - d(V - T)/dq - (p - p_late)/T_w = m (the same of a kilogram of payload)        p = dT/dq'

behind the lag T_w. The momentum p needs no acceleration. Not near the ends of a stroke.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import casadi as ca

from fmus.contract import Quantity, Scalar, Subsystem, flat, nested, quantities
from fmus.controller.arm import ControlledAxis
from fmus.diagnosis.axis import Axis, Effort, Finding
from fmus.diagnosis.estimates import Fit, Told, whether
from fmus.parameters import values

TORQUE = 1e4  # N.m, scale of torques
HUNDRED = 100.0  # kg, scale of weights
END = 0.01  # m, from the end of a stroke
NEVER = 1e-9  # 1/s, a weight of nothing
PRIOR = {"weight": 20.0}  # standard deviation [100 kg]

Efforts = Callable[[Any], Mapping[str, tuple[Effort, Effort]]]
"""Readings -> axis: the empty arm, and what a kilogram of payload adds."""


def findings(axis: ControlledAxis) -> dict[str, Finding]:
    """A gauge of cylinders: no size of it is a fault."""
    text = "Payload by the {}"
    return {} if axis.turns else {"weight": Finding("kg", text, 100.0, "pressure sensors of the {}")}


def states(axis: ControlledAxis) -> dict[str, Quantity]:
    """Torques and momenta behind the lag."""
    if axis.turns:
        return {}
    rows = (
        ("torque", "N.m", "Torque less that of the empty arm, behind the lag", TORQUE),
        ("momentum", "N.m.s", "Momentum of the empty arm, behind the lag", TORQUE),
        ("mass_torque", "N.m/kg", "Torque per payload, behind the lag", 1.0),
        ("mass_momentum", "N.m.s/kg", "Momentum per payload, behind the lag", 1.0),
    )
    return {n: Quantity(unit, f"{text}: {axis.name}", nominal) for n, unit, text, nominal in rows}


def fits(axis: ControlledAxis) -> dict[str, Fit]:
    """The payload."""
    return {} if axis.turns else {"weight": Fit("weight", ("mass",))}


def efforts_of(manipulator: Subsystem, axes: Sequence[ControlledAxis]) -> Efforts:
    """From the mechanics of a machine, with the values of its parameters."""
    known, arm = values(manipulator), [a for a in axes if not a.turns]
    p, still = nested(manipulator.parameters, known.p), nested(manipulator.inputs, known.u)
    rest = dict.fromkeys(quantities(manipulator.states), 0.0)
    names = [n for a in axes for n in (a.coordinate[0], a.speed[0])]
    readings, mass = ca.SX.sym("readings", len(names)), ca.SX.sym("mass")
    at = dict(zip(names, ca.vertsplit(readings), strict=True))
    x = nested(manipulator.states, rest | at | {"held_mass": mass})
    seen = flat(manipulator.observe(x, still, p))
    kinetic, rows = seen["kinetic_energy"], list[Scalar]()
    for a in arm:
        weight = ca.gradient(seen["potential_energy"] - kinetic, at[a.coordinate[0]])
        rows += [weight, ca.gradient(kinetic, at[a.speed[0]])]
    function = ca.Function("efforts", [readings, mass], [ca.vertcat(*rows)])

    def efforts(u: Any) -> Mapping[str, tuple[Effort, Effort]]:
        now = ca.vertcat(*(getattr(u, n) for n in names))
        empty, loaded = (ca.vertsplit(function(now, m)) for m in (0, 1))
        pairs = [(e, one - e) for e, one in zip(empty, loaded, strict=True)]
        return {
            a.name: (
                Effort(pairs[2 * k][0], pairs[2 * k + 1][0]),
                Effort(pairs[2 * k][1], pairs[2 * k + 1][1]),
            )
            for k, a in enumerate(arm)
        }

    return efforts


def start(a: Axis) -> dict[str, Scalar]:
    """States at the readings."""
    if a.axis.turns:
        return {}
    (empty, mass), now = a.effort, a.lever * a.actuator.force(*a.pressures)
    return {
        "torque": now - empty.torque,
        "momentum": empty.momentum,
        "mass_torque": mass.torque,
        "mass_momentum": mass.momentum,
    }


def rates(a: Axis) -> dict[str, Scalar]:
    """Lags, and the sums of the payload."""
    if a.axis.turns:
        return {}
    p, (empty, mass), lag = a.p, a.effort, a.p.weighing_lag
    found = {n: (v - getattr(a, n)) / lag for n, v in start(a).items()}
    stroke = getattr(p, a.axis.name).stroke
    free = whether(a.position > END) * whether(a.position < stroke - END)
    force = a.torque - (empty.momentum - a.momentum) / lag
    per_mass = a.mass_torque + (mass.momentum - a.mass_momentum) / lag
    equation = [([HUNDRED * per_mass / TORQUE], force / TORQUE)]
    counts = a.sound * a.speeds * free / lag + NEVER  # an old weight fades, too
    return found | fits(a.axis)["weight"].rates(a, counts, equation, p.weighing_memory)


def usable(a: Axis) -> Scalar:
    """1: the readings that the weight needs were usable at the last sample."""
    return a.usable * a.rated


def size(a: Axis) -> tuple[Scalar, Scalar]:
    """Payload [kg] with its deviation, less the weight of the empty arm beyond the known one."""
    ((mass, off),) = a.solved(fits(a.axis)["weight"], PRIOR, 0.02, 0.1)[0]
    deviation = ca.sqrt((HUNDRED * off) ** 2 + a.p.weighing_error**2)
    return HUNDRED * mass - a.reference("weight"), deviation


def told(a: Axis) -> dict[str, Told]:
    """The gauge."""
    return {} if a.axis.turns else {"weight": (*size(a), ca.if_else(usable(a) > 0, 0, -1))}
