"""Boom and stick drives: a valve, two hoses and a single-ended cylinder each.

The equations are those of `fmus.components.cylinder_drive`, once for the boom, once for the stick;
the two share the supply and the oil and are otherwise independent.

Signs: line flows are positive into the cylinder; positions are measured from the closed end;
velocities and forces are positive when they extend the rod; a positive command extends.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path
from typing import Annotated

from fmus.components import cylinder, cylinder_drive
from fmus.components.cylinder_drive import Drive, Oil, Surroundings
from fmus.components.spool_valve import Valve
from fmus.contract import Quantity, Scalar, Subsystem


@dataclass(frozen=True)
class BoomStickParameters:
    """Constants; their numbers and sources are in parameters.toml."""

    density: Annotated[Scalar, Quantity("kg/m3", "Density of the oil", 1e3, minimum=100.0)]
    bulk_modulus: Annotated[Scalar, Quantity("Pa", "Bulk modulus of the oil", 1e9, minimum=1e7)]
    valve_area: Annotated[
        Scalar, Quantity("m2", "Area of a metering edge at full command", 1e-5, minimum=0.0)
    ]
    valve_discharge_coefficient: Annotated[
        Scalar, Quantity("1", "Discharge coefficient of the metering edges", minimum=0.1, maximum=1.0)
    ]
    valve_dead_band: Annotated[
        Scalar, Quantity("V", "Command up to which the valve stays closed", minimum=0.0)
    ]
    valve_full_command: Annotated[
        Scalar, Quantity("V", "Command at which the valve is fully open", minimum=0.1)
    ]
    valve_command_rounding: Annotated[
        Scalar, Quantity("V", "Width over which the foot of the opening curve is rounded", minimum=1e-3)
    ]
    valve_leakage: Annotated[
        Scalar, Quantity("m3/(s.Pa)", "Laminar leakage of each metering edge", 1e-14, minimum=1e-17)
    ]
    valve_transition_flow: Annotated[
        Scalar, Quantity("m3/s", "Flow below which metering edges and hoses are laminar", 1e-5, minimum=1e-8)
    ]
    initial_preload: Annotated[
        Scalar, Quantity("Pa", "Pressure of the unloaded side of a cylinder at the start", 1e6, minimum=1e3)
    ]
    boom_bore: Annotated[Scalar, Quantity("m", "Bore of the boom cylinder", 0.1, minimum=1e-3)]
    boom_rod: Annotated[Scalar, Quantity("m", "Rod diameter of the boom cylinder", 0.1, minimum=0.0)]
    boom_stroke: Annotated[Scalar, Quantity("m", "Stroke of the boom cylinder", minimum=1e-3)]
    boom_dead_volume: Annotated[
        Scalar, Quantity("m3", "Volume of each chamber of the boom cylinder at its end", 1e-4, minimum=1e-9)
    ]
    boom_hose_inertance: Annotated[Scalar, Quantity("kg/m4", "Inertance of each boom hose", 1e7, minimum=1.0)]
    boom_hose_capacitance: Annotated[
        Scalar, Quantity("m3/Pa", "Capacitance of each boom hose", 1e-12, minimum=0.0)
    ]
    boom_hose_resistance: Annotated[
        Scalar, Quantity("Pa.s2/m6", "Turbulent resistance C_R of each boom hose", 1e10, minimum=0.0)
    ]
    stick_bore: Annotated[Scalar, Quantity("m", "Bore of the stick cylinder", 0.1, minimum=1e-3)]
    stick_rod: Annotated[Scalar, Quantity("m", "Rod diameter of the stick cylinder", 0.1, minimum=0.0)]
    stick_stroke: Annotated[Scalar, Quantity("m", "Stroke of the stick cylinder", minimum=1e-3)]
    stick_dead_volume: Annotated[
        Scalar, Quantity("m3", "Volume of each chamber of the stick cylinder at its end", 1e-4, minimum=1e-9)
    ]
    stick_hose_inertance: Annotated[
        Scalar, Quantity("kg/m4", "Inertance of each stick hose", 1e7, minimum=1.0)
    ]
    stick_hose_capacitance: Annotated[
        Scalar, Quantity("m3/Pa", "Capacitance of each stick hose", 1e-12, minimum=0.0)
    ]
    stick_hose_resistance: Annotated[
        Scalar, Quantity("Pa.s2/m6", "Turbulent resistance C_R of each stick hose", 1e10, minimum=0.0)
    ]


@dataclass(frozen=True)
class BoomStickState:
    """Pressures and line flows of both drives."""

    boom_head_pressure: Annotated[
        Scalar, Quantity("Pa", "Pressure at the head side of the boom cylinder", 1e7)
    ]
    boom_rod_pressure: Annotated[Scalar, Quantity("Pa", "Pressure at the rod side of the boom cylinder", 1e7)]
    boom_head_flow: Annotated[Scalar, Quantity("m3/s", "Flow into the head side of the boom cylinder", 1e-3)]
    boom_rod_flow: Annotated[Scalar, Quantity("m3/s", "Flow into the rod side of the boom cylinder", 1e-3)]
    stick_head_pressure: Annotated[
        Scalar, Quantity("Pa", "Pressure at the head side of the stick cylinder", 1e7)
    ]
    stick_rod_pressure: Annotated[
        Scalar, Quantity("Pa", "Pressure at the rod side of the stick cylinder", 1e7)
    ]
    stick_head_flow: Annotated[
        Scalar, Quantity("m3/s", "Flow into the head side of the stick cylinder", 1e-3)
    ]
    stick_rod_flow: Annotated[Scalar, Quantity("m3/s", "Flow into the rod side of the stick cylinder", 1e-3)]


@dataclass(frozen=True)
class BoomStickInputs:
    """Commands, supply, and the motion of the pistons; the rate inputs carry exact time derivatives."""

    boom_command: Annotated[
        Scalar, Quantity("V", "Command to the boom valve, positive raises the boom", 10.0)
    ]
    stick_command: Annotated[Scalar, Quantity("V", "Command to the stick valve, positive extends", 10.0)]
    supply_pressure: Annotated[Scalar, Quantity("Pa", "Pressure of the supply line", 1e7)]
    tank_pressure: Annotated[Scalar, Quantity("Pa", "Pressure of the return line", 1e5)]
    boom_position: Annotated[
        Scalar,
        Quantity("m", "Piston position of the boom cylinder from its closed end", rate="boom_velocity"),
    ]
    boom_velocity: Annotated[
        Scalar, Quantity("m/s", "Piston velocity of the boom cylinder", 0.1, rate="boom_acceleration")
    ]
    boom_acceleration: Annotated[
        Scalar, Quantity("m/s2", "Rate port: time derivative of boom_velocity, may stay unconnected")
    ]
    stick_position: Annotated[
        Scalar,
        Quantity("m", "Piston position of the stick cylinder from its closed end", rate="stick_velocity"),
    ]
    stick_velocity: Annotated[
        Scalar, Quantity("m/s", "Piston velocity of the stick cylinder", 0.1, rate="stick_acceleration")
    ]
    stick_acceleration: Annotated[
        Scalar, Quantity("m/s2", "Rate port: time derivative of stick_velocity, may stay unconnected")
    ]
    boom_holding_force: Annotated[
        Scalar, Quantity("N", "Force that holds the boom at the start; used only to initialise", 1e5)
    ]
    stick_holding_force: Annotated[
        Scalar, Quantity("N", "Force that holds the stick at the start; used only to initialise", 1e5)
    ]


@dataclass(frozen=True)
class BoomStickOutputs(BoomStickState):
    """The state; forces and their rates for the mechanics; flows for the supply; and what a user looks at."""

    boom_force: Annotated[Scalar, Quantity("N", "Hydraulic force of the boom cylinder", 1e5)]
    stick_force: Annotated[Scalar, Quantity("N", "Hydraulic force of the stick cylinder", 1e5)]
    boom_force_rate: Annotated[Scalar, Quantity("N/s", "Rate port: exact time derivative of boom_force", 1e6)]
    stick_force_rate: Annotated[
        Scalar, Quantity("N/s", "Rate port: exact time derivative of stick_force", 1e6)
    ]
    supply_flow: Annotated[Scalar, Quantity("m3/s", "Flow taken from the supply line", 1e-3)]
    return_flow: Annotated[Scalar, Quantity("m3/s", "Flow given to the return line", 1e-3)]
    boom_void_volume: Annotated[
        Scalar,
        Quantity("m3", "Void in the boom cylinder: above 1e-7 the oil has torn", 1e-6, warn_above=1e-7),
    ]
    stick_void_volume: Annotated[
        Scalar,
        Quantity("m3", "Void in the stick cylinder: above 1e-7 the oil has torn", 1e-6, warn_above=1e-7),
    ]
    stored_energy: Annotated[
        Scalar, Quantity("J", "Energy of compression and of the moving oil columns", 1e3)
    ]
    dissipated_power: Annotated[Scalar, Quantity("W", "Heat of metering edges and hoses", 1e4)]


def drives(p: BoomStickParameters) -> tuple[Drive, Drive]:
    """The two drives, boom and stick, from the flat parameters."""
    valve = Valve(
        p.valve_area,
        p.valve_discharge_coefficient,
        p.valve_dead_band,
        p.valve_full_command,
        p.valve_command_rounding,
        p.valve_leakage,
        p.valve_transition_flow,
    )
    own = ("bore", "rod", "stroke", "dead_volume", "hose_inertance", "hose_capacitance", "hose_resistance")
    boom, stick = (
        Drive(
            **{n: getattr(p, f"{a}_{n}") for n in own},
            bulk_modulus=p.bulk_modulus,
            density=p.density,
            valve=valve,
        )
        for a in ("boom", "stick")
    )
    return boom, stick


def _oil(x: BoomStickState) -> tuple[Oil, Oil]:
    names = [f.name for f in fields(Oil)]
    boom, stick = (Oil(**{n: getattr(x, f"{a}_{n}") for n in names}) for a in ("boom", "stick"))
    return boom, stick


def _surroundings(u: BoomStickInputs) -> tuple[Surroundings, Surroundings]:
    return (
        Surroundings(u.boom_command, u.supply_pressure, u.tank_pressure, u.boom_position, u.boom_velocity),
        Surroundings(u.stick_command, u.supply_pressure, u.tank_pressure, u.stick_position, u.stick_velocity),
    )


def _named(boom: Oil, stick: Oil) -> dict[str, Scalar]:
    return {f"{a}_{n}": v for a, oil in (("boom", boom), ("stick", stick)) for n, v in vars(oil).items()}


def dynamics(x: BoomStickState, u: BoomStickInputs, p: BoomStickParameters) -> BoomStickState:
    """Time derivative of the state."""
    boom, stick = (
        cylinder_drive.rates(d, oil, s)
        for d, oil, s in zip(drives(p), _oil(x), _surroundings(u), strict=True)
    )
    return BoomStickState(**_named(boom, stick))


def observe(x: BoomStickState, u: BoomStickInputs, p: BoomStickParameters) -> BoomStickOutputs:
    """Outputs; forces depend on the state alone, their rates and the flows on the inputs too."""
    (boom, stick), (oil_b, oil_s), (at_b, at_s) = drives(p), _oil(x), _surroundings(u)
    nodes = (*cylinder_drive.valve_ports(boom, oil_b, at_b), *cylinder_drive.valve_ports(stick, oil_s, at_s))
    return BoomStickOutputs(
        boom_force=cylinder_drive.force(boom, oil_b),
        stick_force=cylinder_drive.force(stick, oil_s),
        boom_force_rate=cylinder_drive.force(boom, cylinder_drive.rates(boom, oil_b, at_b)),
        stick_force_rate=cylinder_drive.force(stick, cylinder_drive.rates(stick, oil_s, at_s)),
        supply_flow=sum(n.supply for n in nodes),
        return_flow=sum(n.tank for n in nodes),
        boom_void_volume=cylinder_drive.void_volume(oil_b),
        stick_void_volume=cylinder_drive.void_volume(oil_s),
        stored_energy=cylinder_drive.stored_energy(boom, oil_b, u.boom_position)
        + cylinder_drive.stored_energy(stick, oil_s, u.stick_position),
        dissipated_power=cylinder_drive.dissipated_power(boom, oil_b, at_b)
        + cylinder_drive.dissipated_power(stick, oil_s, at_s),
        **vars(x),
    )


def initial(u: BoomStickInputs, p: BoomStickParameters) -> dict[str, Scalar]:
    """Pressures that carry the holding forces with the oil at rest."""
    state: dict[str, Scalar] = {}
    loads = {"boom": u.boom_holding_force, "stick": u.stick_holding_force}
    for (name, load), d in zip(loads.items(), drives(p), strict=True):
        preload = u.tank_pressure + p.initial_preload
        head, rod = cylinder.holding_pressures(load, *cylinder.areas(d.bore, d.rod), preload)
        state |= {f"{name}_head_pressure": head, f"{name}_rod_pressure": rod}
        state |= {f"{name}_head_flow": 0, f"{name}_rod_flow": 0}
    return state


def require(x: BoomStickState, u: BoomStickInputs, p: BoomStickParameters) -> dict[str, Scalar]:  # noqa: ARG001
    """Geometry that must hold: rods thinner than bores, chambers with volume, a valve that opens."""
    conditions: dict[str, Scalar] = {
        "valve_full_command exceeds valve_dead_band": p.valve_full_command - p.valve_dead_band
    }
    positions = {"boom": u.boom_position, "stick": u.stick_position}
    for (name, position), d in zip(positions.items(), drives(p), strict=True):
        head, rod = cylinder.areas(d.bore, d.rod)
        v_head, v_rod = cylinder.volumes(position, d.stroke, head, rod, d.dead_volume)
        conditions[f"{name}_rod is thinner than {name}_bore"] = rod
        conditions[f"head chamber of the {name} cylinder has a positive volume at {name}_position"] = v_head
        conditions[f"rod chamber of the {name} cylinder has a positive volume at {name}_position"] = v_rod
    return conditions


BOOM_STICK = Subsystem(
    name="boom_stick",
    text="Hydraulic drives of boom and stick: spool valves, hoses, cylinders",
    parameters=BoomStickParameters,
    states=BoomStickState,
    inputs=BoomStickInputs,
    outputs=BoomStickOutputs,
    dynamics=dynamics,
    observe=observe,
    initial=initial,
    require=require,
    values=Path(__file__).with_name("parameters.toml"),
)
