"""Section of a mobile valve: meter-in edge with pressure compensator and check valve, meter-out edge.

                    compensator, check      metering edge
    P_s ----------------|>|-------- P_m --------o-------- P (port A or B) --------o-------- P_t
                                             opening y                     meter-out

The compensator stands before the edge and holds the drop over it, whatever the load:

    d_c = min(d_0, s (P_s - P_LS))                     regulated drop
    d   = min(d_c (1 + k (D - D_0)), D/(1 + y^2 c/d_0))         D = max(P_s - P, 0), drop over both
    Q   = q_0 y sqrt(d/d_0)

q_0 is the flow at full command with the drop d_0. The second argument is the drop that is left for the edge
if the compensator is fully open, c its own drop at q_0. Flow sharing: if the pump cannot give what is
asked for, P_s falls towards the highest load P_LS. The drop is then s (P_s - P_LS) in all sections, those of
other drives included, and their flows keep the ratio of q_0 y. With s (1 + c/d_0) < 0.95 the section of the
highest load shares alike. k is the droop by the spring, which is compressed as the
compensator closes: the flow falls when the load rises, by the fraction k/2 per Pa, and damps the load a
little. D_0 = 100 bar is where q_0 is stated; k D_0 < 1.

No flow comes back: Q >= 0, the check valve opens over `CHECK_ROUNDING`. min is `smooth.lower`, max is the
`ramp`, sqrt is laminar at small flows as in `orifice.Edge`, with the area that passes q_0 at d_0; P_s - P_LS
below zero counts as zero, rounded over `MARGIN_ROUNDING`. So Q has a continuous derivative everywhere,
increases with P_s and falls with P. Exact for D above 1 bar and drops that differ by 10 %.

The meter-out edge is an orifice of its own size. In neutral both ports are connected to the tank by a small
orifice, so that no leakage builds up pressure at the pilots of counterbalance valves; it closes between half
the dead band and its end.

Dynamics of the compensator (5 to 20 ms) are neglected. References: H. E. Merritt, Hydraulic Control Systems,
1967, ch. 5 (flow forces); J. Ivantysyn and M. Ivantysynova, Hydrostatic Pumps and Motors, 2001, ch. 9;
data sheets of proportional valves with pre-compensated sections (Danfoss PVG 32).
"""

from dataclasses import dataclass

import casadi as ca

from fmus.components import opening_curve, spool_valve
from fmus.components.hose import Law, flow_in_series
from fmus.components.opening_curve import OpeningCurves
from fmus.components.orifice import Liquid, root
from fmus.components.spool_valve import DeadBand, EdgeFlows, EdgeShape, Lines, Pair
from fmus.contract import Group, Quantity, Scalar
from fmus.smooth import lower, positive, ramp, s_curve

CHECK_ROUNDING = 1e4  # Pa: pressure difference over which the check valve opens
MARGIN_ROUNDING = 2e4  # Pa: 50 Pa at a margin of 20 bar
NOMINAL_DROP = 1e7  # D_0 [Pa]
LEAST_DEAD_BAND = 1e-3  # of full command; keeps the neutral position defined for a valve without dead band


class SectionValve(OpeningCurves, DeadBand, EdgeShape):
    """A spool valve whose edges have areas of their own, each with an optional table of its opening curve."""


class Compensator(Group):
    """Parameters of the pressure compensators."""

    setting: Scalar = Quantity(
        "Pa", "Drop over the metering edge that a compensator holds", 1e6, minimum=1e4, group="Compensators"
    )
    sharing: Scalar = Quantity(
        "1",
        "Drop over the metering edge relative to the margin of the supply, while the supply is saturated",
        minimum=0.1,
        maximum=0.95,
    )
    open_drop: Scalar = Quantity(
        "Pa", "Drop over a fully open compensator at the section flow", 1e5, minimum=0.0
    )
    droop: Scalar = Quantity(
        "1/Pa",
        "Relative rise of the regulated drop per drop over section and compensator",
        1e-9,
        minimum=0.0,
        maximum=5e-8,
    )


def requirements(valve: SectionValve, c: Compensator) -> dict[str, Scalar]:
    """Requirements of a section: it opens, and its droop leaves a drop to regulate."""
    return {
        **spool_valve.requirements(valve),
        "compensator_droop is below 1e-7 1/Pa": 1 - c.droop * NOMINAL_DROP,
        "the section of the highest load shares the flow: compensator_sharing (1 + compensator_open_drop"
        " / compensator_setting) is below 0.95": 0.95 - c.sharing * (1 + c.open_drop / c.setting),
    }


@dataclass(frozen=True)
class Section:
    """Parameters of one section.

    flows          q_0 of ports A and B [m3/s]
    return_areas   of the meter-out edges of ports A and B at full command [m2]
    neutral_areas  that connect ports A and B to the tank in neutral [m2]
    oil            density and viscosity
    lines          in series with the meter-out edges of ports A and B, None: without one
    """

    valve: SectionValve
    compensator: Compensator
    flows: Pair
    return_areas: Pair
    neutral_areas: Pair
    oil: Liquid
    lines: tuple[Law | None, Law | None]

    def openings(self, command: Scalar) -> tuple[tuple[Scalar, Scalar], tuple[Scalar, Scalar]]:
        """Openings [1] (meter-in, meter-out) of the edges of port A and of port B."""
        y = spool_valve.edge_openings(self.valve, command)
        return (y["pa"], y["at"]), (y["pb"], y["bt"])

    def dead_bands(self) -> tuple[Scalar, Scalar]:
        """Commands at which the meter-in edges of port A and of port B begin to open [V]."""
        v = self.valve
        return opening_curve.meter_in_dead_bands(v, v.dead_band, v.dead_band)

    def in_use(self, command: Scalar) -> tuple[Scalar, Scalar]:
        """Of ports A and B: 0 up to half of the dead band of the edge that feeds them, 1 from its end on."""
        a, b = (ca.fmax(d, LEAST_DEAD_BAND * self.valve.full_command) for d in self.dead_bands())
        return s_curve(2 * command / a - 1), s_curve(-2 * command / b - 1)

    def neutral(self, command: Scalar) -> Scalar:
        """1 in neutral, 0 as soon as a meter-in edge can be open."""
        to_a, to_b = self.in_use(command)
        return 1 - to_a - to_b


@dataclass(frozen=True)
class SectionPort:
    """A port: flows and pressure, drop over its metering edge and over its compensator [Pa]."""

    edges: EdgeFlows
    metering_drop: Scalar
    compensator_drop: Scalar


def metering_drop(
    c: Compensator, opening: Scalar, supply: Scalar, load_sensing: Scalar, port: Scalar
) -> tuple[Scalar, Scalar]:
    """d and D [Pa]."""
    both = ramp(supply - port, CHECK_ROUNDING)
    regulated = lower(c.setting, c.sharing * positive(supply - load_sensing, MARGIN_ROUNDING))
    regulated *= 1 + c.droop * (both - NOMINAL_DROP)
    left = both / (1 + opening**2 * c.open_drop / c.setting)
    return ca.fmax(lower(left, regulated), 0), both


def section_ports(
    section: Section, command: Scalar, pressures: Pair, lines: Lines
) -> tuple[SectionPort, SectionPort]:
    """Ports A and B at a command [V] and their pressures [Pa]; lines with load_sensing_pressure, too."""
    v, c, tank, oil = section.valve, section.compensator, lines.tank_pressure, section.oil
    ports = []
    own = (section.flows, section.return_areas, section.neutral_areas, section.lines)
    sides = zip(section.openings(command), pressures, *own, strict=True)
    for (inward, outward), p, full, return_area, neutral_area, line in sides:
        full_area = full / ca.sqrt(v.square(1.0, oil) * c.setting)
        drop, both = metering_drop(c, inward, lines.supply_pressure, lines.load_sensing_pressure, p)
        to_port = root((full * inward) ** 2 * drop / c.setting, v.transition_flow(full_area * inward, oil))
        area = return_area * outward + neutral_area * section.neutral(command)
        through = (v, area, p - tank, oil)
        to_tank = flow_in_series(*through, line) if line else v.flow(*through[1:])
        entering = to_port + v.leakage * both
        leaving = to_tank + v.leakage * (p - tank)
        edges = EdgeFlows(p, entering, leaving, entering - leaving)
        ports.append(SectionPort(edges, drop, both - drop))
    return ports[0], ports[1]


class SectionOutputs(Group):
    """Signals of a section; both drops are 0 in neutral."""

    meter_in_flow: Scalar = Quantity("m3/s", "Flow of the {} section from the supply line", 1e-3)
    metering_drop: Scalar = Quantity("Pa", "Drop over the open meter-in edge of the {} section", 1e6)
    compensator_drop: Scalar = Quantity("Pa", "Drop over the compensator of the {} section", 1e7)


def shown(section: Section, ports: tuple[SectionPort, SectionPort], command: Scalar) -> SectionOutputs:
    """Outputs of a section."""
    (a, b), (to_a, to_b) = ports, section.in_use(command)
    return SectionOutputs(
        meter_in_flow=a.edges.supply + b.edges.supply,
        metering_drop=to_a * a.metering_drop + to_b * b.metering_drop,
        compensator_drop=to_a * a.compensator_drop + to_b * b.compensator_drop,
    )
