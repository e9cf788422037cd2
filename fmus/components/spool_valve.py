"""Four-way spool valve: flows of the metering edges (meter-in, meter-out), and dynamics of the spool.

    P --edge--> A <--edge-- T        command > 0 opens P-A and B-T
    P --edge--> B <--edge-- T        command < 0 opens P-B and A-T; closed in the dead band

For an open edge P-A the meter-in flow is `EdgeFlows.supply` of port A, and the meter-out flow of the open
edge B-T is `EdgeFlows.tank` of port B. Two ways to compute them:

    edge_flows_from_flow        from the line flow, a state: lines with inertance
    edge_flows_from_pressure    from the chamber pressure: lines without inertance

Laminar and turbulent flow through an edge: `orifice.Edge`.

The opening of each edge is a straight line over the command behind the dead band (`opening`), or a table of
its own (`fmus.components.opening_curve`).

Signs: line flow is positive out of a port towards the actuator.
References: paper eqs. (1), (2); corrections E3, E7 in docs/equations.md.

A spool with dynamics is a second-order lag of its command, limited in speed and stroke:

    dx/dt = v        dv/dt = 2 z w (v_c - v)        v_c = min(max(s(w/(2 z) (u - x)), -c (1 + x)), c (1 - x))

x is the position and u the command, both relative to the stroke; w is the natural frequency, z the damping
ratio. s is a saturation at the largest speed v_max: exactly linear up to 0.9 v_max, twice continuously
differentiable. So small motions obey x'' + 2 z w x' + w^2 x = w^2 u. The other two limits, with c = z w/2,
keep the spool inside its stroke: its speed towards an end stays below z w times the distance left. The spool
never hits an end, so no stop is modelled. These limits act closer than v_max/c to an end. |v| <= v_max is
true as well. Each edge has its own overlap.

Reference: the second-order model of data sheets; B. Petrovic and J. Mattila 2022 give 30 Hz and 0.707.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, TypeAlias

import casadi as ca

from fmus.components import hose, opening_curve
from fmus.components import oil as oils
from fmus.components.circuit import SUPPLY, TANK, Branch, Kind
from fmus.components.hose import Law
from fmus.components.opening_curve import EDGES, OpeningCurves, StraightOpening
from fmus.components.orifice import CLOSED, Edge, Liquid
from fmus.contract import Group, Quantity, Scalar
from fmus.smooth import ramp

FORWARD = ("pa", "bt")  # the edges that a positive command opens
Pair: TypeAlias = tuple[Scalar, Scalar]  # of ports A and B
Lines: TypeAlias = Any  # with supply_pressure and tank_pressure [Pa], as the inputs of a drive


class EdgeShape(Edge):
    """Parameters of the metering edges of a valve without their areas."""

    full_command: Scalar = Quantity("V", "Command at which the valve is fully open", minimum=0.1)
    command_rounding: Scalar = Quantity(
        "V", "Command range over which the valve begins to open", minimum=1e-3
    )
    leakage: Scalar = Quantity(
        "m3/(s.Pa)", "Laminar leakage of each metering edge", 1e-14, minimum=1e-17, warmed=oils.LEAKAGE
    )


class Edges(EdgeShape):
    """Parameters of the metering edges of a valve; all valves are identical (section 3(b))."""

    area: Scalar = Quantity("m2", "Opening area of each metering edge at full command", 1e-5, minimum=1e-9)


class DeadBand(Group):
    """Dead band of a valve without dynamics."""

    dead_band: Scalar = Quantity("V", "Dead band: command up to which the valve stays closed", minimum=0.0)


class Valve(DeadBand, Edges):
    """Parameters of a symmetrical spool valve without dynamics."""


class CurvedEdges(OpeningCurves, Edges):
    """Parameters of the metering edges, each with an optional table of its opening curve."""


class CurvedValve(OpeningCurves, Valve):
    """Parameters of a valve without dynamics, each edge with an optional table of its opening curve."""

    def openings(self, command: Scalar) -> dict[str, Scalar]:
        """Openings [1] of the edges at a command [V]; a valve of another kind has its own."""
        return edge_openings(self, command)


def position(text: str) -> Quantity:
    """Declaration of the position of a spool as an output: beyond its stroke there is no spool."""
    text, meaning = f"{text}, relative to its stroke", "the spool of the {} valve leaves its stroke"
    return Quantity("1", text, warn_above=1.0001, meaning=meaning)  # 1: tolerance of a solver


def _overlap(edge: str) -> Quantity:
    text = f"Overlap of the edge {edge}: fraction of the stroke up to which it stays closed"
    return Quantity("1", text, 0.1, minimum=0.0, maximum=0.9)


class Spool(Group):
    """Parameters of a spool with dynamics: natural frequency, damping ratio, largest speed, overlaps."""

    frequency: Scalar = Quantity("Hz", "Natural frequency of the spool", 10.0, minimum=0.1, group="Spool")
    damping: Scalar = Quantity("1", "Damping ratio of the spool", minimum=0.1)
    speed: Scalar = Quantity(
        "1/s", "Largest speed of the spool, relative to its stroke from the centre", 10.0, minimum=0.1
    )
    overlap_pa: Scalar = _overlap("P-A")
    overlap_at: Scalar = _overlap("A-T")
    overlap_pb: Scalar = _overlap("P-B")
    overlap_bt: Scalar = _overlap("B-T")

    @property
    def overlaps(self) -> dict[str, Scalar]:
        """Overlap by edge."""
        values = (self.overlap_pa, self.overlap_at, self.overlap_pb, self.overlap_bt)
        return dict(zip(EDGES, values, strict=True))


def opens(valve: DeadBand) -> dict[str, Scalar]:
    """Requirement: the valve opens before full command."""
    return {"valve_full_command exceeds valve_dead_band": valve.full_command - valve.dead_band}


def requirements(valve: Any, _: object = None) -> dict[str, Scalar]:
    """Requirements of the valve of a drive; one with a spool has no common dead band."""
    opening = opens(valve) if isinstance(valve, DeadBand) else {}
    return opening | opening_curve.requirements(valve, valve.full_command)


@dataclass(frozen=True)
class EdgeFlows:
    """A port with its two edges: pressure [Pa]; flow from supply, to tank and into the line [m3/s]."""

    pressure: Scalar
    supply: Scalar
    tank: Scalar
    line: Scalar


def opening(command: Scalar, dead_band: Scalar, full_command: Scalar, rounding: Scalar) -> Scalar:
    """Opening [1], relative to the full area, of the edges that a positive command [V] opens.

    Zero up to the dead band, then a straight line to 1 at full command (the form of the PVG32 valve of Khadim
    et al. 2022) with a start rounded over `rounding` volts; 1 above.
    """
    effective = ca.fmin(command, full_command)
    return ramp(effective - dead_band, rounding) / ramp(full_command - dead_band, rounding)


def edge_openings(valve: Any, command: Scalar) -> dict[str, Scalar]:
    """Openings [1] of the edges pa, at, pb and bt at a command [V]: by its table, or the straight line.

    valve   a `CurvedValve`, or one whose edges have areas of their own
    """
    line = StraightOpening(valve.dead_band, valve.full_command, valve.command_rounding)
    return _openings(dict.fromkeys(EDGES, line), valve, command)


def _openings(
    lines: Mapping[str, StraightOpening], curves: OpeningCurves, command: Scalar
) -> dict[str, Scalar]:
    """Openings [1] by edge at a command [V]."""
    return {
        edge: opening_curve.pieces(getattr(curves, edge), line).opening(
            command if edge in FORWARD else -command
        )
        for edge, line in lines.items()
    }


def edge_flows_from_flow(
    edges: Edges, line_flow: Scalar, opening_supply: Scalar, opening_tank: Scalar, lines: Lines, oil: Liquid
) -> EdgeFlows:
    """Flows of the two edges of a port, supply (meter-in) and tank (meter-out), from the line flow Q.

    Each edge has the conductance G = G_leak + 1 / (C_R (|Q_e| + Q_t)),

        (P_s - P) G_s = Q + (P - P_t) G_t        Q_e = G_leak (P_s - P_t) + Q, or - Q behind the tank edge

    so an open edge obeys the law of `orifice.Edge`, and the flow through a closed edge is G_leak times its
    pressure difference. At most one edge is open. Q_e is the flow of the open edge without a drop of its own:
    more than its flow by twice the leakage of that drop. With |Q| in its place P would rise with Q where the
    leakage of the closed edge exceeds Q, and the port would have no stable flow.
    """
    # of the full area, which is a number; the laminar limit at an opening grows with its root
    square, laminar = edges.square(edges.area, oil), edges.transition_flow(edges.area, oil, 0)
    p_s, p_t = lines.supply_pressure, lines.tank_pressure
    through = edges.leakage * (p_s - p_t) + ca.if_else(opening_tank > 0, -line_flow, line_flow)
    slowed = ca.fabs(through) + laminar * ca.sqrt(opening_supply + opening_tank + CLOSED / edges.area)
    g_supply = edges.leakage + square * opening_supply**2 / slowed
    g_tank = edges.leakage + square * opening_tank**2 / slowed
    drop = (line_flow + g_tank * (p_s - p_t)) / (g_supply + g_tank)  # P_s - P without their difference
    from_supply = g_supply * drop
    return EdgeFlows(p_s - drop, from_supply, from_supply - line_flow, line_flow)


def ports_from_flow(
    valve: CurvedValve, command: Scalar, flows: Pair, lines: Lines, oil: Liquid
) -> tuple[EdgeFlows, EdgeFlows]:
    """Both ports at a command [V], from the line flows [m3/s] out of A and B."""
    return _ports(valve, valve.openings(command), flows, lines, oil)


def _ports(
    edges: Edges, share: Mapping[str, Scalar], flows: Pair, lines: Lines, oil: Liquid
) -> tuple[EdgeFlows, EdgeFlows]:
    """Both ports at the openings [1] of the edges."""
    return (
        edge_flows_from_flow(edges, flows[0], share["pa"], share["at"], lines, oil),
        edge_flows_from_flow(edges, flows[1], share["pb"], share["bt"], lines, oil),
    )


def edge_flows_from_pressure(
    edges: EdgeShape,
    pressure: Scalar,
    source: Scalar,
    from_supply: Scalar,
    area: Scalar,
    lines: Lines,
    oil: Liquid,
    line: Law | None = None,
) -> EdgeFlows:
    """Flows of the two edges of a port that leads over a line directly into a chamber at the pressure P.

    Each edge has the leakage G_leak dp. The open edge, to the supply if `from_supply` and else to the tank,
    also has the flow through its opening [m2] and the line in series. At most one edge is open.

    source   pressure behind the open edge
    """
    drop, leakage, p_s, p_t = source - pressure, edges.leakage, lines.supply_pressure, lines.tank_pressure
    through = hose.flow_in_series(edges, area, drop, oil, line) if line else edges.flow(area, drop, oil)
    return EdgeFlows(
        pressure,
        leakage * (p_s - pressure) + ca.if_else(from_supply, through, 0),
        leakage * (pressure - p_t) - ca.if_else(from_supply, 0, through),
        leakage * (p_s + p_t - 2 * pressure) + through,
    )


def ports_from_pressure(
    valve: CurvedValve, command: Scalar, pressures: Pair, lines: Lines, oil: Liquid, line: Law | None
) -> tuple[EdgeFlows, EdgeFlows]:
    """Both ports at a command [V], from the chamber pressures [Pa]; lines without inertance."""
    share = valve.openings(command)
    area_a, area_b = (valve.area * (share[x] + share[y]) for x, y in (("pa", "at"), ("pb", "bt")))
    forward, p_s, p_t = command > 0, lines.supply_pressure, lines.tank_pressure
    behind_a = ca.if_else(forward, p_s, p_t)
    behind_b = p_s + p_t - behind_a  # the other of the two
    return (
        edge_flows_from_pressure(valve, pressures[0], behind_a, forward, area_a, lines, oil, line),
        edge_flows_from_pressure(valve, pressures[1], behind_b, 1 - forward, area_b, lines, oil, line),
    )


PORTS = ("P_A", "P_B")  # symbols of the pressures


def branches(ports: tuple[EdgeFlows, EdgeFlows], nodes: tuple[str, str]) -> dict[str, Branch]:
    """The metering edges of ports A and B, which are these nodes of a circuit."""
    a, b = nodes
    return {
        "P-A": Branch(SUPPLY, a, Kind.EDGE, ports[0].supply, "C_R"),
        "A-T": Branch(a, TANK, Kind.EDGE, ports[0].tank, "C_Re"),
        "P-B": Branch(SUPPLY, b, Kind.EDGE, ports[1].supply, "C_R"),
        "B-T": Branch(b, TANK, Kind.EDGE, ports[1].tank, "C_Re"),
    }


# ---- a spool with dynamics


@dataclass(frozen=True)
class SpoolState:
    """Position [1] and speed [1/s] of a spool; also used for their rates and for their names."""

    position: Scalar
    speed: Scalar


def saturation(z: Scalar) -> Scalar:
    """z limited to -1 ... 1: exact up to 0.9, +-1 beyond 1.1, smooth in between."""
    return z - ramp(z - 0.9, 0.2) + ramp(-z - 0.9, 0.2)


def commanded_position(command: Scalar, full_command: Scalar) -> Scalar:
    """Position [1] for a command [V]: full stroke from the full command on."""
    return ca.fmax(-1, ca.fmin(1, command / full_command))


def spool_rates(spool: Spool, x: SpoolState, commanded: Scalar) -> SpoolState:
    """Time derivative of the state for a commanded position [1]."""
    w = 2 * math.pi * spool.frequency
    lag = 2 * spool.damping * w
    closing = lag / 4
    saturated = spool.speed * saturation(w**2 / lag * (commanded - x.position) / spool.speed)
    limited = ca.fmin(ca.fmax(saturated, -closing * (1 + x.position)), closing * (1 - x.position))
    return SpoolState(x.speed, lag * (limited - x.speed))


def spool_ports(
    edges: CurvedEdges, spool: Spool, position: Scalar, flows: Pair, lines: Lines, oil: Liquid
) -> tuple[EdgeFlows, EdgeFlows]:
    """Both ports at a spool position [1], from the line flows [m3/s] out of A and B.

    A table is one over the position times full command.
    """
    full = (edges.full_command, edges.command_rounding)
    straight = {
        edge: StraightOpening(overlap * edges.full_command, *full) for edge, overlap in spool.overlaps.items()
    }
    share = _openings(straight, edges, position * edges.full_command)
    return _ports(edges, share, flows, lines, oil)
