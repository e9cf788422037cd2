"""Sharp-edged orifices, and valves that open at a pressure: flow from the pressure difference.

    q = C_d A sqrt(2 / rho) r(dp)        r(dp) = dp / (dp^2 + dp_t^2)^(1/4)

The textbook's r is sign(dp) sqrt(|dp|), whose slope at dp = 0 is infinite (Merritt, Hydraulic
Control Systems, 1967, eq. 3-17). This r is odd and increasing, its slope at zero is dp_t^(-1/2),
and it lies below the square root by the share (dp_t / dp)^2 / 4 at most: 1 % at 5 dp_t,
3e-8 at 3000 dp_t.

Relief and anti-cavitation valves have a smooth static characteristic:

    Q = g r(dP - P_set, w)        r the ramp of `fmus.components.smooth`: exactly 0 for dP <= P_set

Above P_set + w a straight line of slope g that starts at P_set + w/2. A relief valve sees the pressure of
its line over that of the return line, an anti-cavitation valve the other way round. Poppet dynamics (faster
than 5 ms) and hysteresis are left out.
"""

from __future__ import annotations

import casadi as ca

from fmus.components.smooth import ramp
from fmus.contract import Group, Quantity, Scalar


def regular_root(dp: Scalar, transition: Scalar) -> Scalar:
    """r(dp) [Pa^(1/2)], the signed square root, regular within `transition` [Pa] around zero."""
    return dp / (dp**2 + transition**2) ** 0.25


def flow(area: Scalar, dp: Scalar, density: Scalar, discharge: Scalar, transition: Scalar) -> Scalar:
    """Volume flow [m3/s] along a pressure difference dp [Pa]; with the sign of dp, so dp q >= 0."""
    return discharge * area * ca.sqrt(2 / density) * regular_root(dp, transition)


def one_way_flow(area: Scalar, dp: Scalar, density: Scalar, discharge: Scalar, transition: Scalar) -> Scalar:
    """Volume flow [m3/s] of an orifice behind an ideal check valve: zero for dp < 0.

    Continuous; the slope jumps at dp = 0 from zero to that of `flow`.
    """
    return flow(area, ca.fmax(dp, 0), density, discharge, transition)


def loss(volume_flow: Scalar, dp: Scalar) -> Scalar:
    """Power [W] turned into heat, dp q; never negative for the flows above."""
    return volume_flow * dp


class PressureValve(Group):
    """Opening pressure P_set, slope g, rounding w."""

    pressure: Scalar = Quantity("Pa", "Pressure difference at which the {} valve opens", 1e7)
    gain: Scalar = Quantity("m3/(s.Pa)", "Flow of the {} valve per pressure above", 1e-9)
    rounding: Scalar = Quantity("Pa", "Width over which the foot of the {} valve is rounded", 1e5)


def relief_flow(valve: PressureValve, drop: Scalar) -> Scalar:
    """Flow [m3/s] along a pressure difference [Pa]; never against it if P_set >= 0."""
    return valve.gain * ramp(drop - valve.pressure, valve.rounding)


def cross_flow(valve: PressureValve, drop: Scalar) -> Scalar:
    """Flow [m3/s] of two valves back to back, with the sign of the pressure difference [Pa]."""
    return relief_flow(valve, drop) - relief_flow(valve, -drop)


class ReliefParameters(Group):
    """Relief and anti-cavitation valves of an actuator: two `PressureValve`s."""

    relief_pressure: Scalar = Quantity(
        "Pa", "Pressure at which a relief valve opens", 1e7, minimum=0.0, group="Relief valves"
    )
    relief_gain: Scalar = Quantity(
        "m3/(s.Pa)", "Flow of a relief valve per pressure above", 1e-9, minimum=0.0
    )
    relief_rounding: Scalar = Quantity(
        "Pa", "Width over which the foot of a relief valve is rounded", 1e5, minimum=1.0
    )
    anti_cavitation_pressure: Scalar = Quantity(
        "Pa",
        "Pressure below that of the return line at which an anti-cavitation valve opens",
        1e4,
        minimum=0.0,
    )
    anti_cavitation_gain: Scalar = Quantity(
        "m3/(s.Pa)", "Flow of an anti-cavitation valve per pressure below", 1e-7, minimum=0.0
    )
    anti_cavitation_rounding: Scalar = Quantity(
        "Pa", "Width over which the foot of an anti-cavitation valve is rounded", 1e3, minimum=1.0
    )
