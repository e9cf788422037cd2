"""What the variants share: drives made of the flat variables, pressures at the start, requirements, ports."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Protocol

from fmus.boom_stick.variables import BoomStickInputs, CylinderParameters, QuasistaticParameters
from fmus.components import cylinder, ports
from fmus.components.cylinder_drive import Drive, Surroundings
from fmus.contract import Scalar, Terminal


class Cylinder(Protocol):
    """What a drive knows of its cylinder [m, m3]."""

    @property
    def bore(self) -> Scalar:
        """Bore."""

    @property
    def rod(self) -> Scalar:
        """Diameter of the rod."""

    @property
    def stroke(self) -> Scalar:
        """Stroke."""

    @property
    def dead_volume(self) -> Scalar:
        """Volume of each chamber at the end of the stroke."""


def drives(
    p: QuasistaticParameters, boom_inertance: Scalar = 0.0, stick_inertance: Scalar = 0.0
) -> tuple[Drive, Drive]:
    """Boom and stick from the flat parameters, with the inertances [kg/m4] of their hoses."""
    own = ("bore", "rod", "stroke", "dead_volume", "hose_capacitance", "hose_resistance")
    boom, stick = (
        Drive(
            **{n: getattr(p, f"{a}_{n}") for n in own},
            hose_inertance=inertance,
            bulk_modulus=p.bulk_modulus,
            density=p.density,
            valve=p.valve,
        )
        for a, inertance in (("boom", boom_inertance), ("stick", stick_inertance))
    )
    return boom, stick


def surroundings(u: BoomStickInputs) -> tuple[Surroundings, Surroundings]:
    """What the two drives see."""
    return (
        Surroundings(u.boom_command, u.supply_pressure, u.tank_pressure, u.boom_position, u.boom_velocity),
        Surroundings(u.stick_command, u.supply_pressure, u.tank_pressure, u.stick_position, u.stick_velocity),
    )


def start_pressures(u: BoomStickInputs, p: QuasistaticParameters) -> dict[str, Scalar]:
    """Pressures that carry the holding forces."""
    return holding_pressures(u, p, drives(p))


def holding_pressures(
    u: BoomStickInputs, p: CylinderParameters, cylinders: Iterable[Cylinder]
) -> dict[str, Scalar]:
    """Pressures of the chambers of boom and stick that carry the holding forces."""
    state: dict[str, Scalar] = {}
    loads = {"boom": u.boom_holding_force, "stick": u.stick_holding_force}
    for (name, load), d in zip(loads.items(), cylinders, strict=True):
        preload = u.tank_pressure + p.initial_preload
        head, rod = cylinder.holding_pressures(load, *cylinder.areas(d.bore, d.rod), preload)
        state |= {f"{name}_head_pressure": head, f"{name}_rod_pressure": rod}
    return state


def require(x: object, u: BoomStickInputs, p: QuasistaticParameters) -> dict[str, Scalar]:
    """Geometry that must hold: rods thinner than bores, chambers with volume, a valve that opens."""
    opens = {"valve_full_command exceeds valve_dead_band": p.valve_full_command - p.valve_dead_band}
    return opens | room(u, drives(p))


def room(u: BoomStickInputs, cylinders: Iterable[Cylinder]) -> dict[str, Scalar]:
    """What the cylinders of boom and stick must have: rods thinner than bores, chambers with volume."""
    conditions: dict[str, Scalar] = {}
    positions = {"boom": u.boom_position, "stick": u.stick_position}
    for (name, position), d in zip(positions.items(), cylinders, strict=True):
        head, rod = cylinder.areas(d.bore, d.rod)
        v_head, v_rod = cylinder.volumes(position, d.stroke, head, rod, d.dead_volume)
        conditions[f"{name}_rod is thinner than {name}_bore"] = rod
        conditions[f"head chamber of the {name} cylinder has a positive volume at {name}_position"] = v_head
        conditions[f"rod chamber of the {name} cylinder has a positive volume at {name}_position"] = v_rod
    return conditions


TERMINALS: tuple[Terminal, ...] = (
    *(ports.rod(axis, drives=True) for axis in ("boom", "stick")),
    *(ports.lever(axis) for axis in ("boom", "stick")),
    ports.supply_line(),
    ports.return_line(),
)
