"""Fixed-displacement hydraulic motor with laminar internal and external leakage, and its holding brake.

    line A --R1--> (1)      (2) <--R2-- line B
                    |--R_in--|
                  R_ex      R_ex      to the case drain at tank pressure

Signs: flow is positive into port 1; D = D_m N [m3/rad]; speed w of the gear's output shaft.

**Holding brake**: wet discs, spring-applied, released by pressure.

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

from collections.abc import Mapping
from dataclasses import dataclass

from fmus.components.circuit import TANK, Branch, Circuit, Kind, Node
from fmus.contract import Group, Quantity, Scalar
from fmus.smooth import ramp, s_curve

Pair = tuple[str, str]  # names of the nodes at A and B
SHAFT = ("q̇_sw", "B_sw")  # speed of the gear, and its damping, which is in the mechanics
BRAKE_ROUNDING = 1e-3  # b relative to T_b


def branches(ports: Pair, displaced: Scalar, internal: Scalar, external: Scalar) -> dict[str, Branch]:
    """The motor between its ports, and its leakage, eqs. (11), (12).

    displaced            flow D w [m3/s]
    internal, external   leakage resistances R_in and R_ex [Pa.s/m3]
    """
    (a, b), g_in, g_ex = ports, 1 / internal, 1 / external
    return {
        "motor": Branch(a, b, Kind.MOTOR, displaced, "D_m N", mechanics=SHAFT),
        "internal_leakage": Branch(a, b, Kind.LEAKAGE, lambda drop: g_in * drop, "R_in"),
        "drain_a": Branch(a, TANK, Kind.DRAIN, lambda drop: g_ex * drop, "R_e1"),
        "drain_b": Branch(b, TANK, Kind.DRAIN, lambda drop: g_ex * drop, "R_e2"),
    }


def behind_lines(
    nodes: Mapping[str, Node], lines: Pair, ports: Pair, line_resistance: Scalar, *motor: Scalar
) -> Circuit:
    """The motor with its ports, which have no oil, behind laminar lines; motor: as in `branches`."""
    p_a, p_b = (nodes[line].pressure for line in lines)
    found = port_pressures(p_a, p_b, nodes[TANK].pressure, line_resistance, *motor)
    at_ports = Circuit(
        {**nodes, **dict(zip(ports, map(Node, found, ("P_1", "P_2")), strict=True))}, branches(ports, *motor)
    )
    # line flows from the node balance, because (P_c1 - P1)/R_1 is a difference of nearly equal values
    flow_a, flow_b = (-at_ports.into(port) for port in ports)
    return at_ports | Circuit(
        {},
        {
            "line_a": Branch(
                *(lines[0], ports[0], Kind.RESISTANCE, flow_a, "R_1"), drop=flow_a * line_resistance
            ),
            "line_b": Branch(
                *(lines[1], ports[1], Kind.RESISTANCE, flow_b, "R_2"), drop=flow_b * line_resistance
            ),
        },
    )


def port_pressures(
    line_1: Scalar,
    line_2: Scalar,
    tank: Scalar,
    line_resistance: Scalar,
    displaced: Scalar,
    internal: Scalar,
    external: Scalar,
) -> tuple[Scalar, Scalar]:
    """Solve the port nodes of eq. (9a) (corrections E1, E2), G = 1/R, for their pressures [Pa]:

        [G + G_in + G_ex   -G_in          ] [P1]   [G P_c1 + G_ex P_t - D w]
        [-G_in             G + G_in + G_ex] [P2] = [G P_c2 + G_ex P_t + D w]

    with the pressures P_c of the lines, P_t of the tank, and the displaced flow D w. Linear, so from rates it
    returns rates.
    """
    g, g_in, g_ex = 1 / line_resistance, 1 / internal, 1 / external
    own = g + g_in + g_ex
    b1 = g * line_1 + g_ex * tank - displaced
    b2 = g * line_2 + g_ex * tank + displaced
    determinant = own**2 - g_in**2
    return (own * b1 + g_in * b2) / determinant, (own * b2 + g_in * b1) / determinant


# ---- holding brake


@dataclass(frozen=True)
class BrakeTorque:
    """dT/dt [N.m/s], heat [W], stored energy [J]."""

    rate: Scalar
    heat: Scalar
    stored: Scalar


class Brake(Group):
    """Parameters of a holding brake, at the output of the gear."""

    holding_torque: Scalar = Quantity(
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

    def hold(self, torque: Scalar, applied: Scalar, speed: Scalar) -> BrakeTorque:
        """The brake under a torque [N.m], applied by `applied` [1], at the speed [rad/s] of the shaft."""
        held, width = self.holding_torque * applied, BRAKE_ROUNDING * self.holding_torque
        slip = (ramp(torque - held, width) - ramp(-torque - held, width)) / self.drag
        return BrakeTorque(self.stiffness * (speed - slip), torque * slip, torque**2 / (2 * self.stiffness))

    def released(self, in_use: Scalar, pressure: Scalar) -> Scalar:
        """f [1] from how far the command releases [1] and the release pressure [Pa] above the tank."""
        return in_use * s_curve(2 * pressure / self.release_pressure - 1)

    def applied_rate(self, applied: Scalar, release: Scalar) -> Scalar:
        """dq/dt [1/s]."""
        return (1 - release) * (1 - applied) / self.apply_time - release * applied / self.release_time
