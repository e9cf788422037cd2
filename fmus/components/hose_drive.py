"""Valve with a moving spool, two hoses as lines and a single-ended cylinder with relief valves.

    C_h dP_h/dt = Q_h - A_h x' - Q_relief,h + Q_anti,h        C_h = (V_0 + A_h x) kappa(P_h)
    C_r dP_r/dt = Q_r + A_r x' - Q_relief,r + Q_anti,r        C_r = (V_0 + A_r (L - x)) kappa(P_r)

with the flows Q_h, Q_r out of the hoses of `fmus.components.hose_line`, kappa of `oil`, the spool of
`spool_dynamics` and the relief and anti-cavitation valves of `relief`, which stand at the cylinder.

Signs as in `fmus.components.cylinder_drive`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from fmus.components import chamber, cylinder, hose_line, oil, orifice, spool_dynamics, spool_valve
from fmus.components.cylinder_drive import Surroundings
from fmus.components.hose_line import Line, LineState
from fmus.components.oil import Fluid
from fmus.components.orifice import PressureValve
from fmus.components.spool_dynamics import Edges, Spool, SpoolState
from fmus.components.spool_valve import PortFlow
from fmus.contract import Scalar


@dataclass(frozen=True)
class HoseDrive:
    """Numbers of one drive: cylinder [m, m3], command of full stroke [V], and its parts."""

    bore: Scalar
    rod: Scalar
    stroke: Scalar
    dead_volume: Scalar
    full_command: Scalar
    hose: Line
    fluid: Fluid
    edges: Edges
    spool: Spool
    relief: PressureValve
    anti_cavitation: PressureValve


@dataclass(frozen=True)
class DriveState:
    """Spool, both hoses and the pressures [Pa] of both chambers; also their rates, or their names."""

    spool: SpoolState
    head_line: LineState
    rod_line: LineState
    head_pressure: Any
    rod_pressure: Any

    def all(self) -> tuple[Any, ...]:
        """All entries in order."""
        spool = (self.spool.position, self.spool.speed)
        return (self.head_pressure, self.rod_pressure, *self.head_line.all(), *self.rod_line.all(), *spool)


@dataclass(frozen=True)
class Flows:
    """Where oil passes besides the hoses [m3/s]: relief and anti-cavitation valves of both chambers."""

    relief_head: Scalar
    relief_rod: Scalar
    anti_head: Scalar
    anti_rod: Scalar

    @property
    def to_tank(self) -> Scalar:
        """Flow into the return line."""
        return self.relief_head + self.relief_rod - self.anti_head - self.anti_rod


def valve_ports(d: HoseDrive, x: DriveState, u: Surroundings) -> tuple[PortFlow, PortFlow]:
    """The valve's port nodes: A feeds the head, B the rod side."""
    flows = (x.head_line.flows[0], x.rod_line.flows[0])
    pressures = (u.supply_pressure, u.tank_pressure)
    return spool_dynamics.ports(d.edges, x.spool.position, *flows, *pressures, d.fluid.density)


def safety_flows(d: HoseDrive, x: DriveState, u: Surroundings) -> Flows:
    """What the relief and anti-cavitation valves pass."""
    head, rod = x.head_pressure - u.tank_pressure, x.rod_pressure - u.tank_pressure
    opened = (orifice.relief_flow(d.relief, dp) for dp in (head, rod))
    drawn = (orifice.relief_flow(d.anti_cavitation, -dp) for dp in (head, rod))
    return Flows(*opened, *drawn)


def _volumes(d: HoseDrive, position: Scalar) -> tuple[Scalar, Scalar]:
    return cylinder.volumes(position, d.stroke, *cylinder.areas(d.bore, d.rod), d.dead_volume)


def pressure_rates(d: HoseDrive, x: DriveState, u: Surroundings) -> tuple[Scalar, Scalar]:
    """dP/dt [Pa/s] of both chambers."""
    a_head, a_rod = cylinder.areas(d.bore, d.rod)
    v_head, v_rod = _volumes(d, u.position)
    s = safety_flows(d, x, u)
    net_head = x.head_line.flows[-1] - a_head * u.velocity - s.relief_head + s.anti_head
    net_rod = x.rod_line.flows[-1] + a_rod * u.velocity - s.relief_rod + s.anti_rod
    return (
        oil.pressure_rate(x.head_pressure, net_head, v_head * oil.compliance(d.fluid, x.head_pressure)),
        oil.pressure_rate(x.rod_pressure, net_rod, v_rod * oil.compliance(d.fluid, x.rod_pressure)),
    )


def rates(d: HoseDrive, x: DriveState, u: Surroundings) -> DriveState:
    """Time derivative of the state."""
    port_a, port_b = valve_ports(d, x, u)
    wanted = spool_dynamics.share(u.command, d.full_command)
    head, rod = pressure_rates(d, x, u)
    return DriveState(
        spool=spool_dynamics.rates(d.spool, x.spool, wanted),
        head_line=hose_line.rates(d.hose, x.head_line, port_a.pressure, x.head_pressure),
        rod_line=hose_line.rates(d.hose, x.rod_line, port_b.pressure, x.rod_pressure),
        head_pressure=head,
        rod_pressure=rod,
    )


def force(d: HoseDrive, head: Scalar, rod: Scalar) -> Scalar:
    """Hydraulic force [N] of two pressures; of their rates, its time derivative [N/s]."""
    return cylinder.force(*cylinder.areas(d.bore, d.rod), head, rod)


def void_volume(x: DriveState) -> Scalar:
    """Volume of the voids of chambers and hoses [m3]; above 1e-7 the oil has torn."""
    chambers = chamber.void_volume(x.head_pressure) + chamber.void_volume(x.rod_pressure)
    return chambers + hose_line.void_volume(x.head_line) + hose_line.void_volume(x.rod_line)


def stored_energy(d: HoseDrive, x: DriveState, position: Scalar) -> Scalar:
    """Energy of compression, of stretched walls and of the moving oil columns [J]."""
    pressures = (x.head_pressure, x.rod_pressure)
    chambers = sum(
        v * oil.energy_density(d.fluid, p) + oil.void_energy(p)
        for v, p in zip(_volumes(d, position), pressures, strict=True)
    )
    return (
        chambers + hose_line.stored_energy(d.hose, x.head_line) + hose_line.stored_energy(d.hose, x.rod_line)
    )


def convected_power(d: HoseDrive, x: DriveState, velocity: Scalar) -> Scalar:
    """Compression energy [W], e(P) per volume of a growing chamber, less that of a shrinking one."""
    head, rod = cylinder.areas(d.bore, d.rod)
    growing = head * oil.energy_density(d.fluid, x.head_pressure)
    return (growing - rod * oil.energy_density(d.fluid, x.rod_pressure)) * velocity


def dissipated_power(d: HoseDrive, x: DriveState, u: Surroundings) -> Scalar:
    """Heat of the metering edges, hoses, relief and anti-cavitation valves [W]; never negative."""
    s, tank = safety_flows(d, x, u), u.tank_pressure
    edges = sum(spool_valve.throttling_loss(node, u.supply_pressure, tank) for node in valve_ports(d, x, u))
    head, rod = x.head_pressure - tank, x.rod_pressure - tank
    safety = head * (s.relief_head - s.anti_head) + rod * (s.relief_rod - s.anti_rod)
    return edges + safety + hose_line.heat(d.hose, x.head_line) + hose_line.heat(d.hose, x.rod_line)
