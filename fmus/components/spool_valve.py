"""Four-way spool valve without dynamics: four sharp metering edges and two port nodes.

    P --edge--> A <--edge-- T        command > 0 opens P-A and B-T
    P --edge--> B <--edge-- T        command < 0 opens P-B and A-T, closed between

Signs: line flow is positive out of a port towards the actuator.
References: paper eqs. (1), (2); corrections E3, E7 in docs/equations.md.

Parameters that every subsystem with spool valves declares: the valves are identical (section 3(b)).
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca

from fmus.components.smooth import ramp
from fmus.contract import Group, Quantity, Scalar


@dataclass(frozen=True)
class PortFlow:
    """One port node: its pressure [Pa]; flow from supply, flow to tank and flow into the line [m3/s]."""

    pressure: Scalar
    supply: Scalar
    tank: Scalar
    line: Scalar


def opening(command: Scalar, dead_band: Scalar, full_command: Scalar, rounding: Scalar) -> Scalar:
    """Share of the full area [1] of the edges that a positive command [V] opens.

    Zero up to the dead band, then a straight line to 1 at full command (the form of the
    PVG32 valve of Khadim et al. 2022), its foot rounded over `rounding` volts; 1 above.
    """
    effective = ca.fmin(command, full_command)
    return ramp(effective - dead_band, rounding) / ramp(full_command - dead_band, rounding)


def flow_gain(area: Scalar, discharge_coefficient: Scalar, density: Scalar) -> Scalar:
    """C_R^(-1/2) [m3/s/Pa^(1/2)], paper eq. (2): C_R = rho / (2 C_d^2 A^2)."""
    return discharge_coefficient * area * ca.sqrt(2 / density)


def turbulent_drop(flow: Scalar, resistance: Scalar, transition_flow: Scalar) -> Scalar:
    """Pressure drop [Pa] over C_R [Pa.s2/m6], paper eq. (1): dp = C_R Q |Q|.

    |Q| is rounded to sqrt(Q^2 + Q_t^2), so that the slope at Q = 0 is C_R Q_t instead of
    zero: laminar there. The drop exceeds eq. (1) by less than 0.5 % for |Q| > 10 Q_t.
    """
    return resistance * flow * ca.sqrt(flow**2 + transition_flow**2)


def turbulent_factor(drop: Scalar, transition_flow: Scalar) -> Scalar:
    """Q / y [s/m3] of the inverse of `turbulent_drop`, for y = dp / C_R = K^2 dp [m6/s2].

    y = Q sqrt(Q^2 + Q_t^2) is solved by

        Q = y sqrt(c / (1 + sqrt(1 + (c y)^2)))        c = 2 / Q_t^2

    odd and increasing in y; its slope at y = 0 is 1 / Q_t, so that of an edge is K^2 / Q_t. No difference of
    nearly equal numbers occurs, and a closed edge (K = 0) passes exactly nothing.
    """
    c = 2 / transition_flow**2
    return ca.sqrt(c / (1 + ca.sqrt(1 + (c * drop) ** 2)))


def port(
    line_flow: Scalar,
    gain_supply: Scalar,
    gain_tank: Scalar,
    leakage: Scalar,
    transition_flow: Scalar,
    supply_pressure: Scalar,
    tank_pressure: Scalar,
) -> PortFlow:
    """Port node between a supply edge and a tank edge that carries the line flow Q away.

    Each edge has the conductance G = G_leak + K / sqrt(C_R (Q^2 + Q_t^2)) with K^2 = 1 / C_R,

        (P_s - P) G_s = Q + (P - P_t) G_t

    so an open edge obeys eq. (1) (rounded as in `turbulent_drop`) and a closed one passes
    exactly G_leak times its pressure difference. At most one of the two is open; taking the
    line flow for the edge flow neglects the leakage of the closed one in the turbulent term: below 0.1 % of
    the drop from 1000 times that leakage (20 L/min) up.
    """
    speed = ca.sqrt(line_flow**2 + transition_flow**2)
    g_supply = leakage + gain_supply**2 / speed
    g_tank = leakage + gain_tank**2 / speed
    pressure = (g_supply * supply_pressure + g_tank * tank_pressure - line_flow) / (g_supply + g_tank)
    supply, tank = g_supply * (supply_pressure - pressure), g_tank * (pressure - tank_pressure)
    return PortFlow(pressure, supply, tank, line_flow)


@dataclass(frozen=True)
class Valve:
    """A symmetrical spool valve: its numbers, named as in parameters.toml."""

    area: Scalar
    discharge_coefficient: Scalar
    dead_band: Scalar
    full_command: Scalar
    command_rounding: Scalar
    leakage: Scalar
    transition_flow: Scalar


def ports(
    valve: Valve,
    command: Scalar,
    flow_a: Scalar,
    flow_b: Scalar,
    supply_pressure: Scalar,
    tank_pressure: Scalar,
    density: Scalar,
) -> tuple[PortFlow, PortFlow]:
    """Both port nodes at a command [V] and the line flows [m3/s] out of A and B."""
    full = flow_gain(valve.area, valve.discharge_coefficient, density)
    shape = (valve.dead_band, valve.full_command, valve.command_rounding)
    forward, backward = full * opening(command, *shape), full * opening(-command, *shape)
    rest = (valve.leakage, valve.transition_flow, supply_pressure, tank_pressure)
    return port(flow_a, forward, backward, *rest), port(flow_b, backward, forward, *rest)


def _square_gain(valve: Valve, command: Scalar, density: Scalar) -> Scalar:
    """K^2 [m6/(s2.Pa)] of what a positive command [V] opens: `flow_gain` times `opening`, squared."""
    foot = ramp(valve.full_command - valve.dead_band, valve.command_rounding)
    full = flow_gain(valve.area, valve.discharge_coefficient, density) / foot
    effective = ca.fmin(command, valve.full_command)
    return (full * ramp(effective - valve.dead_band, valve.command_rounding)) ** 2


def _direct_port(
    pressure: Scalar,
    source: Scalar,
    from_supply: Scalar,
    square: Scalar,
    leakage: Scalar,
    transition_flow: Scalar,
    supply_pressure: Scalar,
    tank_pressure: Scalar,
) -> PortFlow:
    """Port whose edges lead directly into a chamber at this pressure P: flows from pressures.

    Each edge passes G_leak dp, the one that is open (to the supply if `from_supply`, else to the tank, with
    the pressure `source` behind it) also Q(K^2 dp), see `turbulent_factor`. At most one is open.
    """
    y = square * (source - pressure)
    turbulent = y * turbulent_factor(y, transition_flow)
    supply, tank = leakage * (supply_pressure - pressure), leakage * (pressure - tank_pressure)
    return PortFlow(
        pressure,
        supply + ca.if_else(from_supply, turbulent, 0),
        tank - ca.if_else(from_supply, 0, turbulent),
        leakage * (supply_pressure + tank_pressure - 2 * pressure) + turbulent,
    )


def direct_ports(
    valve: Valve,
    command: Scalar,
    pressure_a: Scalar,
    pressure_b: Scalar,
    supply_pressure: Scalar,
    tank_pressure: Scalar,
    density: Scalar,
    line_resistance: Scalar,
) -> tuple[PortFlow, PortFlow]:
    """Both ports at a command [V], lines without inertia to chambers at these pressures [Pa].

    The line's C_R [Pa.s2/m6] is in series with the open edge: 1 / K_both^2 = 1 / K^2 + C_R.
    """
    edge = _square_gain(valve, ca.fabs(command), density)
    square = edge / (1 + line_resistance * edge)
    forward = command > 0
    behind_a = ca.if_else(forward, supply_pressure, tank_pressure)
    behind_b = supply_pressure + tank_pressure - behind_a  # the other one
    rest = (square, valve.leakage, valve.transition_flow, supply_pressure, tank_pressure)
    return (
        _direct_port(pressure_a, behind_a, forward, *rest),
        _direct_port(pressure_b, behind_b, 1 - forward, *rest),
    )


def throttling_loss(node: PortFlow, supply_pressure: Scalar, tank_pressure: Scalar) -> Scalar:
    """Power [W] turned into heat by the two edges of a port; never negative."""
    return node.supply * (supply_pressure - node.pressure) + node.tank * (node.pressure - tank_pressure)


class EdgeParameters(Group):
    """The numbers of the metering edges and the density of the oil, to inherit from."""

    valve_area: Scalar = Quantity(
        "m2", "Opening area of each metering edge at full command", 1e-5, minimum=0.0, group="Valve"
    )
    valve_discharge_coefficient: Scalar = Quantity(
        "1", "Discharge coefficient of the metering edges", minimum=0.1, maximum=1.0
    )
    valve_full_command: Scalar = Quantity("V", "Command at which the valve is fully open", minimum=0.1)
    valve_command_rounding: Scalar = Quantity(
        "V", "Width over which the foot of the opening curve is rounded", minimum=1e-3
    )
    valve_leakage: Scalar = Quantity(
        "m3/(s.Pa)", "Laminar leakage of each metering edge", 1e-14, minimum=1e-17
    )
    valve_transition_flow: Scalar = Quantity(
        "m3/s", "Flow below which edges, hoses and lines are laminar", 1e-5, minimum=1e-8
    )
    density: Scalar = Quantity("kg/m3", "Density of the oil", 1e3, minimum=100.0, group="Oil")


class ValveParameters(EdgeParameters):
    """With the dead band of a spool without dynamics."""

    valve_dead_band: Scalar = Quantity(
        "V", "Dead band: command up to which the valve stays closed", minimum=0.0, group="Valve"
    )

    @property
    def valve(self) -> Valve:
        """The valve these numbers describe."""
        return Valve(
            self.valve_area,
            self.valve_discharge_coefficient,
            self.valve_dead_band,
            self.valve_full_command,
            self.valve_command_rounding,
            self.valve_leakage,
            self.valve_transition_flow,
        )
