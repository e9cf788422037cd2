"""Fixed-displacement hydraulic motor with laminar internal and external leakage.

    line A --R1--> (1)      (2) <--R2-- line B
                    |--R_in--|
                  R_ex      R_ex      to the case drain at tank pressure

Signs: flow is positive into port 1; D = D_m N [m3/rad]; speed w of the gear's output shaft.
"""

from dataclasses import dataclass

from fmus.contract import Scalar


@dataclass(frozen=True)
class MotorNodes:
    """Pressures [Pa] of both motor ports, flows from the lines into them and case drain flow [m3/s]."""

    pressure_1: Scalar
    pressure_2: Scalar
    flow_1: Scalar
    flow_2: Scalar
    drain: Scalar


def nodes(
    line_1: Scalar,
    line_2: Scalar,
    tank: Scalar,
    displaced_flow: Scalar,
    line_resistance_1: Scalar,
    line_resistance_2: Scalar,
    internal_resistance: Scalar,
    external_resistance: Scalar,
) -> MotorNodes:
    """Solve the port nodes of eq. (9a) (corrections E1, E2), G = 1/R:

        [G1 + G_in + G_ex   -G_in           ] [P1]   [G1 P_c1 + G_ex P_t - D w]
        [-G_in              G2 + G_in + G_ex] [P2] = [G2 P_c2 + G_ex P_t + D w]

    with the pressures P_c of the lines, P_t of the tank, and the displaced flow D w.
    """
    g1, g2 = 1 / line_resistance_1, 1 / line_resistance_2
    g_in, g_ex = 1 / internal_resistance, 1 / external_resistance
    a, d = g1 + g_in + g_ex, g2 + g_in + g_ex
    b1 = g1 * line_1 + g_ex * tank - displaced_flow
    b2 = g2 * line_2 + g_ex * tank + displaced_flow
    determinant = a * d - g_in**2
    p1 = (d * b1 + g_in * b2) / determinant
    p2 = (a * b2 + g_in * b1) / determinant
    # line flows from the node balance, because (P_c1 - P1)/R_1 is a difference of nearly equal values
    return nodes_at_port_pressures(p1, p2, tank, displaced_flow, internal_resistance, external_resistance)


def nodes_at_port_pressures(
    pressure_1: Scalar,
    pressure_2: Scalar,
    tank: Scalar,
    displaced_flow: Scalar,
    internal_resistance: Scalar,
    external_resistance: Scalar,
) -> MotorNodes:
    """Nodes at given port pressures, eqs. (11), (12), without line resistances."""
    g_in, g_ex = 1 / internal_resistance, 1 / external_resistance
    cross, drain_1, drain_2 = (
        g_in * (pressure_1 - pressure_2),
        g_ex * (pressure_1 - tank),
        g_ex * (pressure_2 - tank),
    )
    flow_1, flow_2 = displaced_flow + cross + drain_1, -displaced_flow - cross + drain_2
    return MotorNodes(pressure_1, pressure_2, flow_1, flow_2, drain_1 + drain_2)


def leakage_loss(
    node: MotorNodes, tank: Scalar, internal_resistance: Scalar, external_resistance: Scalar
) -> Scalar:
    """Power [W] dissipated by both leakages; never negative."""
    p1, p2 = node.pressure_1, node.pressure_2
    drain = ((p1 - tank) ** 2 + (p2 - tank) ** 2) / external_resistance
    return drain + (p1 - p2) ** 2 / internal_resistance
