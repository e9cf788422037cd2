"""Valve and a single-ended cylinder without line dynamics: the limit I -> 0 of `cylinder_drive`.

    C_h dP_h/dt  = Q_h - A_h x'        C_h = C_hose + (V_0 + A_h x) / beta
    C_r dP_r/dt  = Q_r + A_r x'        C_r = C_hose + (V_0 + A_r (L - x)) / beta

with the line flows Q_h, Q_r of the ports A and B from the pressures (`spool_valve.direct_ports`): the hose
stays as a volume and as a resistance in series with the open edge. Valid for motions that are slow beside
the oil column of the hose, which lags by I / (2 C_R Q): 3 m of 3/4 in hose by 10 ms at 40 L/min through an
edge of 40 mm2, less through a smaller one.

Signs as in `cylinder_drive`, whose drive and oil serve here with an inertance of zero.

Valve, two hoses and a single-ended cylinder: the boom and stick model of eq. (9a), corrected.

    I dQ/dt      = P_port - P - C_R,hose Q|Q|           for the head and the rod line
    C_h dP_h/dt  = Q_h - A_h x'        C_h = C_hose + (V_0 + A_h x) / beta
    C_r dP_r/dt  = Q_r + A_r x'        C_r = C_hose + (V_0 + A_r (L - x)) / beta

Signs: line flows are positive into the cylinder; x from the closed end; x' and F extend.
Corrections E3, E4, E6, E7, E8 of docs/equations.md.
"""

from __future__ import annotations

from dataclasses import dataclass

from fmus.components import chamber, cylinder, hose, spool_valve
from fmus.components.spool_valve import PortFlow, Valve
from fmus.contract import Scalar

Pressures = tuple[Scalar, Scalar]  # [Pa] of head and rod side


def direct_valve_ports(d: Drive, x: Pressures, u: Surroundings) -> tuple[PortFlow, PortFlow]:
    """The valve's ports: A feeds the head, B the rod side."""
    return spool_valve.direct_ports(
        d.valve, u.command, *x, u.supply_pressure, u.tank_pressure, d.density, d.hose_resistance
    )


def oil(d: Drive, x: Pressures, u: Surroundings) -> Oil:
    """The pressures with the line flows [m3/s] that follow from them."""
    head, rod = (node.line for node in direct_valve_ports(d, x, u))
    return Oil(*x, head, rod)


def direct_dissipated_power(d: Drive, x: Pressures, u: Surroundings) -> Scalar:
    """Heat of the metering edges and the hoses behind them [W]; never negative."""
    return sum(
        spool_valve.throttling_loss(node, u.supply_pressure, u.tank_pressure)
        for node in direct_valve_ports(d, x, u)
    )


@dataclass(frozen=True)
class Drive:
    """Numbers of one drive: cylinder [m, m3], hose (I [kg/m4], C [m3/Pa], C_R [Pa.s2/m6]), oil, valve."""

    bore: Scalar
    rod: Scalar
    stroke: Scalar
    dead_volume: Scalar
    hose_inertance: Scalar
    hose_capacitance: Scalar
    hose_resistance: Scalar
    bulk_modulus: Scalar
    density: Scalar
    valve: Valve


@dataclass(frozen=True)
class Oil:
    """State of a drive: pressures [Pa] and line flows [m3/s]; also their rates."""

    head_pressure: Scalar
    rod_pressure: Scalar
    head_flow: Scalar
    rod_flow: Scalar


@dataclass(frozen=True)
class Surroundings:
    """What a drive sees: command [V], supply and tank pressure [Pa], piston position [m], velocity [m/s]."""

    command: Scalar
    supply_pressure: Scalar
    tank_pressure: Scalar
    position: Scalar
    velocity: Scalar


def _capacitances(d: Drive, position: Scalar) -> tuple[Scalar, Scalar]:
    head, rod = cylinder.areas(d.bore, d.rod)
    at_head, at_rod = cylinder.volumes(0, d.stroke, head, rod, d.dead_volume)  # with the piston at x = 0
    return (
        d.hose_capacitance + at_head / d.bulk_modulus + head / d.bulk_modulus * position,
        d.hose_capacitance + at_rod / d.bulk_modulus - rod / d.bulk_modulus * position,
    )


def valve_ports(d: Drive, x: Oil, u: Surroundings) -> tuple[PortFlow, PortFlow]:
    """The valve's port nodes: A feeds the head, B the rod side."""
    return spool_valve.ports(
        d.valve, u.command, x.head_flow, x.rod_flow, u.supply_pressure, u.tank_pressure, d.density
    )


def pressure_rates(d: Drive, x: Oil, u: Surroundings) -> tuple[Scalar, Scalar]:
    """Time derivatives of the pressures [Pa/s]."""
    head, rod = cylinder.areas(d.bore, d.rod)
    c_head, c_rod = _capacitances(d, u.position)
    return (
        chamber.pressure_rate(x.head_pressure, x.head_flow - head * u.velocity, c_head),
        chamber.pressure_rate(x.rod_pressure, x.rod_flow + rod * u.velocity, c_rod),
    )


def rates(d: Drive, x: Oil, u: Surroundings) -> Oil:
    """Time derivative of the oil's state."""
    port_a, port_b = valve_ports(d, x, u)
    line = (d.hose_inertance, d.hose_resistance, d.valve.transition_flow)
    return Oil(
        *pressure_rates(d, x, u),
        head_flow=hose.flow_rate(port_a.pressure, x.head_pressure, x.head_flow, *line),
        rod_flow=hose.flow_rate(port_b.pressure, x.rod_pressure, x.rod_flow, *line),
    )


def force(d: Drive, x: Oil) -> Scalar:
    """Hydraulic force [N] on the piston; of rates, its time derivative [N/s]."""
    return cylinder.force(*cylinder.areas(d.bore, d.rod), x.head_pressure, x.rod_pressure)


def void_volume(x: Oil) -> Scalar:
    """Volume of the voids of both chambers [m3]; above 1e-7 the oil has torn."""
    return chamber.void_volume(x.head_pressure) + chamber.void_volume(x.rod_pressure)


def stored_energy(d: Drive, x: Oil, position: Scalar) -> Scalar:
    """Energy of compression and of the moving oil columns [J]."""
    c_head, c_rod = _capacitances(d, position)
    compression = chamber.stored_energy(x.head_pressure, c_head) + chamber.stored_energy(
        x.rod_pressure, c_rod
    )
    return compression + d.hose_inertance * (x.head_flow**2 + x.rod_flow**2) / 2


def convected_power(d: Drive, x: Oil, velocity: Scalar) -> Scalar:
    """Compression energy [W], P^2 / (2 beta) per volume of a growing chamber, less that of a shrinking one.

    Volume flows do not show it; with it the energy balance closes (docs/equations.md, section 7).
    """
    head, rod = cylinder.areas(d.bore, d.rod)
    return (head * x.head_pressure**2 - rod * x.rod_pressure**2) * velocity / (2 * d.bulk_modulus)


def dissipated_power(d: Drive, x: Oil, u: Surroundings) -> Scalar:
    """Heat of the metering edges and hoses [W]; never negative."""
    edges = sum(
        spool_valve.throttling_loss(node, u.supply_pressure, u.tank_pressure) for node in valve_ports(d, x, u)
    )
    return edges + sum(
        q * spool_valve.turbulent_drop(q, d.hose_resistance, d.valve.transition_flow)
        for q in (x.head_flow, x.rod_flow)
    )
