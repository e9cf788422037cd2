"""Valve and a single-ended cylinder without line dynamics: the limit I -> 0 of `cylinder_drive`.

    C_h dP_h/dt  = Q_h - A_h x'        C_h = C_hose + (V_0 + A_h x) / beta
    C_r dP_r/dt  = Q_r + A_r x'        C_r = C_hose + (V_0 + A_r (L - x)) / beta

with the line flows Q_h, Q_r of the ports A and B from the pressures (`spool_valve.direct_ports`): the hose
stays as a volume and as a resistance in series with the open edge. Valid for motions that are slow beside
the oil column of the hose, which lags by I / (2 C_R Q): 3 m of 3/4 in hose by 10 ms at 40 L/min through an
edge of 40 mm2, less through a smaller one.

Signs as in `cylinder_drive`, whose drive and oil serve here with an inertance of zero.
"""

from __future__ import annotations

from fmus.components import spool_valve
from fmus.components.cylinder_drive import Drive, Oil, Surroundings
from fmus.components.spool_valve import PortFlow
from fmus.contract import Scalar

Pressures = tuple[Scalar, Scalar]  # [Pa] of head and rod side


def valve_ports(d: Drive, x: Pressures, u: Surroundings) -> tuple[PortFlow, PortFlow]:
    """The valve's ports: A feeds the head, B the rod side."""
    return spool_valve.direct_ports(
        d.valve, u.command, *x, u.supply_pressure, u.tank_pressure, d.density, d.hose_resistance
    )


def oil(d: Drive, x: Pressures, u: Surroundings) -> Oil:
    """The pressures with the line flows [m3/s] that follow from them."""
    head, rod = (node.line for node in valve_ports(d, x, u))
    return Oil(*x, head, rod)


def dissipated_power(d: Drive, x: Pressures, u: Surroundings) -> Scalar:
    """Heat of the metering edges and the hoses behind them [W]; never negative."""
    return sum(
        spool_valve.throttling_loss(node, u.supply_pressure, u.tank_pressure) for node in valve_ports(d, x, u)
    )
