"""Lumped hose: inertance, capacitance and turbulent resistance of one line.

Valid below the frequency of eq. (3), C0/(2 pi l): 51 Hz for the longest hose.
"""

from __future__ import annotations

import math

import casadi as ca

from fmus.components.spool_valve import turbulent_drop
from fmus.contract import Scalar


def flow_rate(
    inlet: Scalar,
    outlet: Scalar,
    flow: Scalar,
    inertance: Scalar,
    resistance: Scalar,
    transition_flow: Scalar,
) -> Scalar:
    """dQ/dt [m3/s2] of the oil column: I dQ/dt = P_in - P_out - C_R Q |Q|, eq. (9a) with correction E3."""
    return (inlet - outlet - turbulent_drop(flow, resistance, transition_flow)) / inertance


def area(diameter: Scalar) -> Scalar:
    """Cross-section [m2] of a bore [m]."""
    return math.pi / 4 * diameter**2


def inertance(length: Scalar, diameter: Scalar, density: Scalar) -> Scalar:
    """I = rho l / A [kg/m4]."""
    return density * length / area(diameter)


def capacitance(length: Scalar, diameter: Scalar, bulk_modulus: Scalar) -> Scalar:
    """C = A l / beta [m3/Pa] with a rigid wall."""
    return area(diameter) * length / bulk_modulus


def scaled_resistance(resistance: Scalar, length_ratio: Scalar, diameter_ratio: Scalar) -> Scalar:
    """C_R [Pa.s2/m6] of another hose at the same flow, eq. (10): C_R ~ l / D^4.75.

    Blasius: turbulent flow in a smooth pipe, Re 3e3 to 1e5. C_R belongs to one reference
    flow: the true drop grows as Q^1.75, so C_R falls by 16 % per doubling of Q (E10).
    """
    return resistance * length_ratio / diameter_ratio**4.75


def laminar_resistance(length: Scalar, diameter: Scalar, viscosity: Scalar) -> Scalar:
    """R = 128 mu l / (pi D^4) [Pa.s/m3], Hagen-Poiseuille, Re < 2300."""
    return 128 * viscosity * length / (math.pi * diameter**4)


def frequency_limit(length: Scalar, density: Scalar, bulk_modulus: Scalar) -> Scalar:
    """Highest frequency [Hz] at which one lump describes the line, eq. (3): C0 / (2 pi l)."""
    return ca.sqrt(bulk_modulus / density) / (2 * math.pi * length)
