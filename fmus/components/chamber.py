"""Compressible volume, with a cavity that opens instead of tension in the oil.

The paper's capacitance C = V / beta is right above the vapour pressure. Below it a void
opens that takes up volume at nearly constant pressure; it is modelled as a capacitance

    C_void(P) = C_ref exp((P_v - P) / dP)          volume of the void = dP C_void(P)

which conserves oil: what left the chamber has to come back before the pressure rises.
With C_ref = 1e-12 m3/Pa, P_v = -20 kPa, dP = 5 kPa (gauge) a void of 1 litre lies at
-81 kPa, and 50 kPa above P_v the void is 2e-13 m3. Assumed: a smooth stand-in for vapour and
released air, not a bubble model. Valid down to 0.2 MPa below P_v, where the exponent is cut off.
"""

from __future__ import annotations

import casadi as ca

from fmus.contract import Quantity, Scalar

VOID_CAPACITANCE = 1e-12  # C_ref [m3/Pa], about that of a 4 m hose: the void is felt from P_v on
VOID_PRESSURE = -20e3  # P_v [Pa] gauge
VOID_SCALE = 5e3  # dP [Pa]
_LARGEST_EXPONENT = 40.0  # keeps trial steps of a solver finite: a void of 1e9 m3
_SMALLEST_EXPONENT = -60.0  # keeps exp() out of the slow denormal numbers: 1e-26 of C_ref


def pressure(text: str) -> Quantity:
    """A pressure of oil as a state: about 10 MPa, but where a void opens errors must be small beside dP.

    After strokes of 1 to 6 V, some of which open voids, the pressures are within 0.004 % of their range, at a
    tolerance of 1e-6; with the absolute tolerance that belongs to 10 MPa 0.35 % at the same cost.
    """
    return Quantity("Pa", text, 1e7, absolute=1e5)


def void_capacitance(pressure: Scalar) -> Scalar:
    """C_void(P) [m3/Pa]."""
    exponent = (VOID_PRESSURE - pressure) * (1 / VOID_SCALE)
    return VOID_CAPACITANCE * ca.exp(ca.fmax(_SMALLEST_EXPONENT, ca.fmin(exponent, _LARGEST_EXPONENT)))


def void_volume(pressure: Scalar) -> Scalar:
    """Volume of the void [m3]: the integral of C_void from P up."""
    return VOID_SCALE * void_capacitance(pressure)


def pressure_rate(pressure: Scalar, net_flow: Scalar, capacitance: Scalar) -> Scalar:
    """dP/dt [Pa/s] = net inflow / (C + C_void(P)), eq. (9a)."""
    return net_flow / (capacitance + void_capacitance(pressure))


def stored_energy(pressure: Scalar, capacitance: Scalar) -> Scalar:
    """Integral of P (C + C_void(P)) dP [J] from 0, the void's part from its closure at high pressure."""
    return capacitance * pressure**2 / 2 - VOID_SCALE * void_capacitance(pressure) * (pressure + VOID_SCALE)
