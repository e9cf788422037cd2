"""One drive: valve, two hoses and a single-ended cylinder, and what boom and stick have in common.

The boom and stick model of eq. (9a), corrected (E3, E4, E6, E7, E8 of docs/equations.md):

    I dQ/dt      = P_port - P - C_R,hose Q|Q|           for the head and the rod line
    C_h dP_h/dt  = Q_h - A_h x'        C_h = C_hose + (V_0 + A_h x) / beta
    C_r dP_r/dt  = Q_r + A_r x'        C_r = C_hose + (V_0 + A_r (L - x)) / beta

Without line dynamics, the limit I -> 0, the line flows Q_h, Q_r of the ports A and B follow from the
pressures (`spool_valve.ports_from_pressure`): the hose stays as a volume and as a resistance in series with
the open edge. Valid for motions that are slow compared with the oil column of the hose, which lags by
I / (2 C_R Q): 3 m of 3/4 in hose by 10 ms at 40 L/min through an edge of 40 mm2, less through a smaller one.

Signs: line flows are positive into the cylinder; x from the closed end; x' and F extend.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, TypeVar

from fmus.boom_stick.variables import AXES, BoomStickInputs, OilState
from fmus.components import chamber, cylinder, hose, ports, spool_valve
from fmus.components.cylinder import Cylinder
from fmus.components.hose import Hose, LumpedHose
from fmus.components.spool_valve import EdgeFlows, Valve
from fmus.contract import Group, Scalar, Terminal

Pair = tuple[Scalar, Scalar]  # of head and rod side
G = TypeVar("G", bound=Group)


@dataclass(frozen=True)
class CylinderDrive:
    """Numbers of one drive; of the oil density [kg/m3] and bulk modulus [Pa]."""

    cylinder: Cylinder
    hose: LumpedHose
    valve: Valve
    density: Scalar
    bulk_modulus: Scalar


@dataclass(frozen=True)
class Surroundings:
    """What a drive sees: command [V], supply and tank pressure [Pa], piston position [m], velocity [m/s]."""

    command: Scalar
    supply_pressure: Scalar
    tank_pressure: Scalar
    position: Scalar
    velocity: Scalar


def drives(p: Any, hose: Any = LumpedHose.of) -> tuple[CylinderDrive, CylinderDrive]:
    """Boom and stick from the flat parameters; `hose` makes the hose of them and a prefix."""
    boom, stick = (
        CylinderDrive(
            Cylinder.of(p, axis), hose(p, f"{axis}_hose"), Valve.of(p, "valve"), p.density, p.bulk_modulus
        )
        for axis in AXES
    )
    return boom, stick


def surroundings(u: BoomStickInputs) -> tuple[Surroundings, Surroundings]:
    """What the two drives see."""
    line = (u.supply_pressure, u.tank_pressure)
    return (
        Surroundings(u.boom_command, *line, u.boom_position, u.boom_velocity),
        Surroundings(u.stick_command, *line, u.stick_position, u.stick_velocity),
    )


def derive(kind: type[Hose], p: Any) -> dict[str, Scalar]:
    """Numbers of both hoses that follow from length and bore."""
    oil = (p.density, p.bulk_modulus, p.hose_reference_resistance)
    return {
        f"{axis}_hose_{name}": value
        for axis in AXES
        for name, value in hose.derived_parameters(kind.of(p, f"{axis}_hose"), *oil).items()
    }


# ---- one drive


def capacitances(d: CylinderDrive, position: Scalar) -> Pair:
    """C_h and C_r [m3/Pa]."""
    head, rod = d.cylinder.areas
    at_head, at_rod = d.cylinder.volumes(0)  # with the piston at x = 0
    return (
        d.hose.capacitance + at_head / d.bulk_modulus + head / d.bulk_modulus * position,
        d.hose.capacitance + at_rod / d.bulk_modulus - rod / d.bulk_modulus * position,
    )


def valve_ports(d: CylinderDrive, x: OilState, u: Surroundings) -> tuple[EdgeFlows, EdgeFlows]:
    """The valve's port nodes: A feeds the head, B the rod side."""
    return spool_valve.ports_from_flow(
        d.valve, u.command, x.head_flow, x.rod_flow, u.supply_pressure, u.tank_pressure, d.density
    )


def direct_valve_ports(d: CylinderDrive, pressures: Pair, u: Surroundings) -> tuple[EdgeFlows, EdgeFlows]:
    """The same without line dynamics, from the pressures of the chambers."""
    return spool_valve.ports_from_pressure(
        d.valve, u.command, *pressures, u.supply_pressure, u.tank_pressure, d.density, d.hose.resistance
    )


def pressure_rates(d: CylinderDrive, x: OilState, u: Surroundings) -> Pair:
    """Time derivatives of the pressures [Pa/s]."""
    head, rod = d.cylinder.areas
    c_head, c_rod = capacitances(d, u.position)
    return (
        chamber.pressure_rate(x.head_pressure, x.head_flow - head * u.velocity, c_head),
        chamber.pressure_rate(x.rod_pressure, x.rod_flow + rod * u.velocity, c_rod),
    )


def rates(d: CylinderDrive, x: OilState, u: Surroundings) -> OilState:
    """Time derivative of the oil's state."""
    port_a, port_b = valve_ports(d, x, u)
    head, rod = pressure_rates(d, x, u)
    line = (d.hose.inertance, d.hose.resistance, d.valve.transition_flow)
    return OilState(
        head_pressure=head,
        rod_pressure=rod,
        head_flow=hose.flow_rate(port_a.pressure, x.head_pressure, x.head_flow, *line),
        rod_flow=hose.flow_rate(port_b.pressure, x.rod_pressure, x.rod_flow, *line),
    )


def hose_heat(d: CylinderDrive, x: OilState) -> Scalar:
    """Heat of the hoses [W]."""
    return sum(
        q * spool_valve.turbulent_drop(q, d.hose.resistance, d.valve.transition_flow)
        for q in (x.head_flow, x.rod_flow)
    )


def observe(
    d: CylinderDrive,
    x: OilState,
    pressure_rates: Pair,
    ports: Iterable[EdgeFlows],
    u: Surroundings,
    hose_heat: Scalar,
) -> dict[str, Scalar]:
    """Outputs of one drive, without the name of its axis; those in TOTALS count for both together.

    The convected power is P^2 / (2 beta) per volume of a growing chamber, less that of a shrinking one.
    Volume flows do not show it; with it the energy balance closes (docs/equations.md, section 7).
    """
    head, rod = d.cylinder.areas
    pressures, nodes = (x.head_pressure, x.rod_pressure), tuple(ports)
    compression = sum(map(chamber.stored_energy, pressures, capacitances(d, u.position)))
    edges = sum(spool_valve.throttling_loss(node, u.supply_pressure, u.tank_pressure) for node in nodes)
    return {
        **vars(x),
        "force": cylinder.force(head, rod, *pressures),
        "force_rate": cylinder.force(head, rod, *pressure_rates),
        "void_volume": sum(map(chamber.cavity_volume, pressures)),
        "supply_flow": sum(node.supply for node in nodes),
        "return_flow": sum(node.tank for node in nodes),
        "stored_energy": compression + d.hose.inertance * (x.head_flow**2 + x.rod_flow**2) / 2,
        "dissipated_power": edges + hose_heat,
        "convected_power": (head * x.head_pressure**2 - rod * x.rod_pressure**2)
        * u.velocity
        / (2 * d.bulk_modulus),
    }


# ---- both drives

TOTALS = ("supply_flow", "return_flow", "stored_energy", "dissipated_power", "convected_power")


def together(outputs: type[G], boom: Mapping[str, Scalar], stick: Mapping[str, Scalar]) -> G:
    """The outputs of both drives, TOTALS summed."""
    return outputs(**named(boom, stick, TOTALS), **{name: boom[name] + stick[name] for name in TOTALS})


def named(
    boom: Mapping[str, Scalar], stick: Mapping[str, Scalar], without: Iterable[str] = ()
) -> dict[str, Scalar]:
    """Values of both drives by their names in the machine."""
    both = zip(AXES, (boom, stick), strict=True)
    return {f"{axis}_{name}": v for axis, own in both for name, v in own.items() if name not in without}


def holding_pressures(u: BoomStickInputs, p: Any) -> dict[str, Scalar]:
    """Pressures of the chambers of boom and stick that carry the holding forces."""
    state: dict[str, Scalar] = {}
    preload = u.tank_pressure + p.initial_preload
    for axis in AXES:
        load, areas = getattr(u, f"{axis}_holding_force"), Cylinder.of(p, axis).areas
        head, rod = cylinder.holding_pressures(load, *areas, preload)
        state |= {f"{axis}_head_pressure": head, f"{axis}_rod_pressure": rod}
    return state


def room(x: Group, u: BoomStickInputs, p: Any) -> dict[str, Scalar]:
    """What the cylinders of boom and stick must have: rods thinner than bores, chambers with volume."""
    conditions: dict[str, Scalar] = {}
    for axis in AXES:
        own = Cylinder.of(p, axis)
        v_head, v_rod = own.volumes(getattr(u, f"{axis}_position"))
        conditions[f"{axis}_rod is thinner than {axis}_bore"] = own.areas[1]
        conditions[f"head chamber of the {axis} cylinder has a positive volume at {axis}_position"] = v_head
        conditions[f"rod chamber of the {axis} cylinder has a positive volume at {axis}_position"] = v_rod
    return conditions


def require(x: Group, u: BoomStickInputs, p: Any) -> dict[str, Scalar]:
    """Geometry that must hold: rods thinner than bores, chambers with volume, a valve that opens."""
    return spool_valve.opens(Valve.of(p, "valve")) | room(x, u, p)


TERMINALS: tuple[Terminal, ...] = (
    *(ports.rod(axis, drives=True) for axis in AXES),
    *(ports.lever(axis) for axis in AXES),
    ports.supply_line(),
    ports.return_line(),
)
