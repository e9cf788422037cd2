"""Holding brake: wet discs, spring-applied, released by pressure.

The discs slip where the torque exceeds what the springs hold, and drag in the oil; shaft and discs twist:

    dT/dt = k (w - s(T)/c)        s(T) = r(T - T_h, b) - r(-T - T_h, b)        T_h = T_b q

T is the torque against the motion of speed w, T_b the torque of the applied brake, q = 0 ... 1 how far it is
applied, c the drag of the discs, r the `ramp` of `smooth`. An elastic spring in series with a Bingham body:

- |T| <= T_h: elastic, no creep at all, unlike bristles whose speed is rounded (`friction`);
- steady slip: |T| = T_h + c |w| + b/2; the released brake drags with c w + b/2;
- the torque is a state, so it does not depend on the speed directly;
- heat T s(T)/c >= 0, stored energy T^2/(2 k), and T w = d(T^2/(2 k))/dt + heat exactly, q moving or not.

The brake is released by the command, once the pressure is there:

    dq/dt = (1 - f)(1 - q)/t_on - f q/t_off       f = command's part * step(2 P/P_r - 1)

so q stays within 0 ... 1. Validity: static and sliding torque alike, no wear, no fading by heat. The Bingham
body is that of viscoplasticity, P. Perzyna, Advances in Applied Mechanics 9 (1966) 243.
"""

from dataclasses import dataclass

from fmus.components.smooth import ramp, s_curve
from fmus.contract import Group, Quantity, Scalar

ROUNDING = 1e-3  # b relative to T_b


class Brake(Group):
    """Parameters of a holding brake, at the output of the gear."""

    torque: Scalar = Quantity(
        "N.m", "Holding torque of the applied {} brake", 1e4, minimum=1.0, group="{} brake"
    )
    stiffness: Scalar = Quantity(
        "N.m/rad", "Torsional stiffness of the {} brake with its shaft", 1e6, minimum=1.0
    )
    drag: Scalar = Quantity("N.m.s/rad", "Viscous drag of the discs of the {} brake", 100.0, minimum=1e-3)
    release_pressure: Scalar = Quantity(
        "Pa", "Supply pressure at which the {} brake is released", 1e6, minimum=1e3
    )
    release_time: Scalar = Quantity("s", "Time constant of the release of the {} brake", 0.1, minimum=1e-4)
    apply_time: Scalar = Quantity("s", "Time constant with which the {} brake is applied", 0.1, minimum=1e-4)


@dataclass(frozen=True)
class BrakeTorque:
    """dT/dt [N.m/s], heat [W], stored energy [J]."""

    rate: Scalar
    heat: Scalar
    stored: Scalar


def hold(brake: Brake, torque: Scalar, applied: Scalar, speed: Scalar) -> BrakeTorque:
    """The brake under a torque [N.m], applied by `applied` [1], at the speed [rad/s] of the shaft."""
    held, width = brake.torque * applied, ROUNDING * brake.torque
    slip = (ramp(torque - held, width) - ramp(-torque - held, width)) / brake.drag
    return BrakeTorque(brake.stiffness * (speed - slip), torque * slip, torque**2 / (2 * brake.stiffness))


def released(brake: Brake, in_use: Scalar, pressure: Scalar) -> Scalar:
    """f [1] from how far the command releases [1] and the release pressure [Pa] above the tank."""
    return in_use * s_curve(2 * pressure / brake.release_pressure - 1)


def applied_rate(brake: Brake, applied: Scalar, release: Scalar) -> Scalar:
    """dq/dt [1/s]."""
    return (1 - release) * (1 - applied) / brake.apply_time - release * applied / brake.release_time
