"""Boom and stick drives at the paper's fidelity: a valve, two hoses and a single-ended cylinder each.

The equations are those of `fmus.components.cylinder_drive`, once for the boom, once for the stick;
the two share the supply and the oil and are otherwise independent.

Signs: line flows are positive into the cylinder; positions are measured from the closed end;
velocities and forces are positive when they extend the rod; a positive command extends.
"""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path

from fmus.boom_stick.variables import BoomStickInputs, BoomStickOutputs, BoomStickParameters, BoomStickState
from fmus.components import cylinder, cylinder_drive, ports
from fmus.components.cylinder_drive import Drive, Oil, Surroundings
from fmus.contract import Scalar, Subsystem


def drives(p: BoomStickParameters) -> tuple[Drive, Drive]:
    """The two drives, boom and stick, from the flat parameters."""
    own = ("bore", "rod", "stroke", "dead_volume", "hose_inertance", "hose_capacitance", "hose_resistance")
    boom, stick = (
        Drive(
            **{n: getattr(p, f"{a}_{n}") for n in own},
            bulk_modulus=p.bulk_modulus,
            density=p.density,
            valve=p.valve,
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
        convected_power=cylinder_drive.convected_power(boom, oil_b, u.boom_velocity)
        + cylinder_drive.convected_power(stick, oil_s, u.stick_velocity),
        **vars(x),
    )


def initial(x: BoomStickState, u: BoomStickInputs, p: BoomStickParameters) -> dict[str, Scalar]:
    """Pressures that carry the holding forces with the oil at rest."""
    state: dict[str, Scalar] = {}
    loads = {"boom": u.boom_holding_force, "stick": u.stick_holding_force}
    for (name, load), d in zip(loads.items(), drives(p), strict=True):
        preload = u.tank_pressure + p.initial_preload
        head, rod = cylinder.holding_pressures(load, *cylinder.areas(d.bore, d.rod), preload)
        state |= {f"{name}_head_pressure": head, f"{name}_rod_pressure": rod}
        state |= {f"{name}_head_flow": 0, f"{name}_rod_flow": 0}
    return state


def require(x: BoomStickState, u: BoomStickInputs, p: BoomStickParameters) -> dict[str, Scalar]:
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
    validity="below the first mode of the longest hose, 60 to 80 Hz; spool faster than the motion",
    terminals=(
        *(ports.rod(axis, drives=True) for axis in ("boom", "stick")),
        *(ports.lever(axis) for axis in ("boom", "stick")),
        ports.supply_line(),
        ports.return_line(),
    ),
)
