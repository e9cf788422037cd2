"""Counterbalance (overcentre, load-holding) valve between a line and a chamber of a cylinder.

              check valve, free flow in
    V  o----+--------|>|--------+----o  C        X: pilot, the opposite line
            +---- poppet, y ----+

The poppet opens against its spring by the load pressure P_C and, R times as much, by the pilot pressure P_X:

    y_0 = lim((P_C + R P_X - (1 + R) P_ref - P_set)/B)        P_ref = P_t + v (P_V - P_t)
    dy/dt = (y_0 - y)/T                                       lim(z) = r(z, w) - r(z - 1, w)

r is the `ramp` of `smooth` with w = 0.1, so y_0 is exactly 0 up to the setting and the valve opens at

    P_X - P_ref = (P_set - (P_C - P_ref))/R

v = 0 is a vented (balanced) valve of four ports: its spring chamber is drained, and back pressure does not
close it. v = 1 is the usual one of three ports, whose setting rises by 1 + R times the back pressure. The
valve is the relief valve of a locked chamber as well. Free flow and poppet are in parallel, in series with
the hose that leads to the valve:

    Q |Q| = K^2 (P_V - P_C)        K = K_y y + K_c h        h = step((P_V - P_C - p_c)/p_r)

positive into the cylinder, laminar at small flows as in `orifice.Edge`, in series with the hose as in
`hose.flow_in_series`; h opens the check valve from its cracking pressure p_c over the range p_r. A laminar
leakage is in parallel.

T is the lag of the poppet behind its balance, set by the orifice in the pilot line; the poppet's inertia
(above 100 Hz) and friction (hysteresis, 5 to 15 %) are neglected.
References: Sun Hydraulics, data sheets CBCA, CBCG, CWCA (setting at least 1.3 times the highest load
pressure, reseat above 85 %, back pressure counts 1 + R times); M. B. Kjelland and M. R. Hansen, Numerical and
Experimental Study of Motion Control Using Pressure Feedback, SICFP 2013 (stability behind compensated flow).
"""

from dataclasses import dataclass

from fmus.components import oil as oils
from fmus.components.hose import Law, flow_in_series
from fmus.components.orifice import Edge, Liquid
from fmus.contract import Group, Quantity, Scalar
from fmus.smooth import ramp, s_curve

ROUNDING = 0.1  # w


class Counterbalance(Group):
    """Parameters that all counterbalance valves share; each has a pilot ratio R of its own."""

    pressure: Scalar = Quantity(
        "Pa",
        "Load pressure at which a counterbalance valve opens without pilot pressure",
        1e7,
        minimum=1e5,
        group="Counterbalance valves",
    )
    band: Scalar = Quantity(
        "Pa",
        "Load pressure above the setting at which a counterbalance valve is fully open",
        1e7,
        minimum=1e5,
    )
    back_pressure_share: Scalar = Quantity(
        "1",
        "Share of the back pressure that acts on the spring side: 0 vented (four ports), 1 three ports",
        minimum=0.0,
        maximum=1.0,
    )
    lag: Scalar = Quantity("s", "Lag of the poppet of a counterbalance valve", 1e-2, minimum=1e-5)
    area: Scalar = Quantity("m2", "Area of a fully open counterbalance valve", 1e-4, minimum=1e-9)
    check_area: Scalar = Quantity("m2", "Area of its fully open check valve", 1e-4, minimum=1e-9)
    check_pressure: Scalar = Quantity("Pa", "Cracking pressure of its check valve", 1e5, minimum=0.0)
    check_range: Scalar = Quantity(
        "Pa",
        "Pressure above the cracking pressure at which its check valve is fully open",
        1e5,
        minimum=100.0,
    )
    leakage: Scalar = Quantity(
        "m3/(s.Pa)", "Leakage of a closed counterbalance valve", 1e-15, minimum=0.0, warmed=oils.LEAKAGE
    )


@dataclass(frozen=True)
class Restriction:
    """What a flow through the valve meets besides the valve itself.

    edge   of poppet and check valve
    hose   friction of the hose
    oil    density and viscosity
    """

    edge: Edge
    hose: Law
    oil: Liquid


def balance(
    c: Counterbalance, pilot_ratio: Scalar, chamber: Scalar, pilot: Scalar, line: Scalar, tank: Scalar
) -> Scalar:
    """y_0 [1], the opening at rest, from R and the pressures [Pa] of chamber, pilot, own line and tank."""
    reference = tank + c.back_pressure_share * (line - tank)
    excess = chamber + pilot_ratio * pilot - (1 + pilot_ratio) * reference - c.pressure
    z = excess / c.band
    return ramp(z, ROUNDING) - ramp(z - 1, ROUNDING)


def flow(c: Counterbalance, opening: Scalar, around: Restriction, drop: Scalar) -> Scalar:
    """Flow [m3/s] from the line into the chamber at a pressure difference [Pa]."""
    check = s_curve((drop - c.check_pressure) / c.check_range)
    area = c.area * opening + c.check_area * check
    return flow_in_series(around.edge, area, drop, around.oil, around.hose) + c.leakage * drop
