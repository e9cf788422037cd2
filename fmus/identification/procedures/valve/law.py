"""Flow through one metering edge as a function of command and pressure drop, with exact derivatives.

    (Q - L) sqrt(Q^2 + Q_t^2) = K^2 dp        L = G dp - G (dp_s - dp)
    K = C_d a(V) A sqrt(2/rho)                C_R = 1/K^2, eqs. (1), (2)

with the leakage G of the open edge, less that of the closed edge of the same port, which has the rest of the
drop dp_s from supply to tank. The opening a(V) and the inverse of the turbulent law are those of
`fmus.components.spool_valve`, so what is fitted is what the machine simulates. a(V) rises with V for any
positive area: the fitted C_R is positive and falls with the command, whatever the data.

Validity: the leakage is a small part of the flow (below a tenth).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from fmus.components import spool_valve
from fmus.contract import Scalar
from fmus.identification.procedures.shared.given import value
from fmus.parameters import Number

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Constants:
    """What is known of the valve and its oil."""

    discharge_coefficient: float
    full_command: float
    leakage: float
    transition_flow: float
    density: float

    @staticmethod
    def of(known: Mapping[str, Number]) -> Constants:
        """From the parameters of the machine; the three valves are identical (section 4(a))."""
        names = ("discharge_coefficient", "full_command", "leakage", "transition_flow")
        rest = {name: value(known, f"boom_stick.valve_{name}") for name in names}
        return Constants(**rest, density=value(known, "boom_stick.density"))

    def all(self) -> tuple[float, ...]:
        """In the order of the fields."""
        return (
            self.discharge_coefficient,
            self.full_command,
            self.leakage,
            self.transition_flow,
            self.density,
        )


@dataclass(frozen=True)
class Law:
    """What is fitted: area [m2] at full command, dead band [V] and rounding [V] of the opening."""

    area: float
    dead_band: float
    rounding: float


@cache
def _functions() -> tuple[ca.Function, ca.Function]:
    names = "command drop whole area dead_band rounding c_d full leakage transition density"
    given = [ca.SX.sym(name) for name in names.split()]
    command, drop, whole, area, dead_band, rounding, c_d, full, leakage, transition, density = given
    share = spool_valve.opening(command, dead_band, full, rounding)
    square = (spool_valve.flow_gain(area, c_d, density) * share) ** 2
    y = square * drop
    turbulent, leak = y * spool_valve.turbulent_factor(y, transition), leakage * (2 * drop - whole)
    flow = _with_leakage(turbulent, leak, y, transition)
    slope = ca.gradient(flow, drop)
    return ca.Function("flow", given, [flow, slope]), ca.Function("square_gain", given, [square])


def _with_leakage(turbulent: Scalar, leak: Scalar, y: Scalar, transition: Scalar) -> Scalar:
    """Q of (Q - leak) sqrt(Q^2 + Q_t^2) = y: one Newton step, which leaves leak^3/Q^2."""
    flow = turbulent + leak / 2
    speed = ca.sqrt(flow**2 + transition**2)
    return flow - ((flow - leak) * speed - y) / (speed + (flow - leak) * flow / speed)


def flow(command: Array, drop: Array, whole: Array, law: Law, constants: Constants) -> tuple[Array, Array]:
    """Flow [m3/s] out of the port and its derivative by the drop [m3/(s.Pa)].

    command      > 0 [V]
    drop, whole  over the edge, and from supply to tank [Pa]
    """
    rest = (law.area, law.dead_band, law.rounding, *constants.all())
    found = _functions()[0](command[None, :], drop[None, :], whole[None, :], *rest)
    return found[0].full()[0], found[1].full()[0]


def resistance(command: Array, law: Law, constants: Constants) -> Array:
    """C_R [Pa.s2/m6] at commands [V] by eq. (2); infinite where the edge is closed."""
    rest = (law.area, law.dead_band, law.rounding, *constants.all())
    square: Array = _functions()[1](command[None, :], 0.0, 0.0, *rest).full()[0]
    return np.divide(1.0, square, out=np.full_like(square, np.inf), where=square > 0)
