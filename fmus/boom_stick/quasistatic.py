"""Boom and stick drives without line dynamics: a valve directly at a single-ended cylinder, for each.

The equations are those of `fmus.components.cylinder_drive`, once for the boom, once for the stick: the limit of
the lumped drives for hoses without inertance. The hoses stay as volumes and as resistances in series with
the open edges. Line flows are no states but follow from the pressures.

Signs: line flows are positive into the cylinder; positions are measured from the closed end;
velocities and forces are positive when they extend the rod; a positive command extends.
"""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path

from fmus.boom_stick.drives import TERMINALS, drives, require, start_pressures, surroundings
from fmus.boom_stick.variables import BoomStickInputs, BoomStickOutputs, QuasistaticParameters
from fmus.components import chamber, cylinder_drive
from fmus.components import cylinder_drive as components_cylinder_drive
from fmus.components.cylinder_drive import Oil
from fmus.contract import Group, Scalar, Subsystem, quantities


class QuasistaticState(Group):
    """State of the quasistatic drives: pressures."""

    boom_head_pressure: Scalar = chamber.pressure("Pressure at the head side of the boom cylinder")
    boom_rod_pressure: Scalar = chamber.pressure("Pressure at the rod side of the boom cylinder")
    stick_head_pressure: Scalar = chamber.pressure("Pressure at the head side of the stick cylinder")
    stick_rod_pressure: Scalar = chamber.pressure("Pressure at the rod side of the stick cylinder")


def _pressures(x: QuasistaticState) -> tuple[tuple[Scalar, Scalar], tuple[Scalar, Scalar]]:
    return (x.boom_head_pressure, x.boom_rod_pressure), (x.stick_head_pressure, x.stick_rod_pressure)


def _oil(x: QuasistaticState, u: BoomStickInputs, p: QuasistaticParameters) -> tuple[Oil, Oil]:
    boom, stick = map(components_cylinder_drive.oil, drives(p), _pressures(x), surroundings(u))
    return boom, stick


def dynamics(x: QuasistaticState, u: BoomStickInputs, p: QuasistaticParameters) -> QuasistaticState:
    """Time derivative of the state."""
    boom, stick = map(cylinder_drive.pressure_rates, drives(p), _oil(x, u, p), surroundings(u))
    names = quantities(QuasistaticState)
    return QuasistaticState(**dict(zip(names, (*boom, *stick), strict=True)))


def observe(x: QuasistaticState, u: BoomStickInputs, p: QuasistaticParameters) -> BoomStickOutputs:
    """Outputs; forces depend on the state alone, their rates and the flows on the inputs too."""
    (boom, stick), (oil_b, oil_s), (at_b, at_s) = drives(p), _oil(x, u, p), surroundings(u)
    rates_b, rates_s = _pressures(dynamics(x, u, p))
    here_b, here_s = _pressures(x)
    nodes = (
        *components_cylinder_drive.direct_valve_ports(boom, here_b, at_b),
        *components_cylinder_drive.direct_valve_ports(stick, here_s, at_s),
    )
    flows = {
        f"{axis}_{f.name}": getattr(oil, f.name)
        for axis, oil in (("boom", oil_b), ("stick", oil_s))
        for f in fields(Oil)
    }
    return BoomStickOutputs(
        boom_force=cylinder_drive.force(boom, oil_b),
        stick_force=cylinder_drive.force(stick, oil_s),
        boom_force_rate=cylinder_drive.force(boom, Oil(*rates_b, 0, 0)),
        stick_force_rate=cylinder_drive.force(stick, Oil(*rates_s, 0, 0)),
        supply_flow=sum(n.supply for n in nodes),
        return_flow=sum(n.tank for n in nodes),
        boom_void_volume=cylinder_drive.void_volume(oil_b),
        stick_void_volume=cylinder_drive.void_volume(oil_s),
        stored_energy=cylinder_drive.stored_energy(boom, oil_b, u.boom_position)
        + cylinder_drive.stored_energy(stick, oil_s, u.stick_position),
        dissipated_power=components_cylinder_drive.direct_dissipated_power(boom, here_b, at_b)
        + components_cylinder_drive.direct_dissipated_power(stick, here_s, at_s),
        convected_power=cylinder_drive.convected_power(boom, oil_b, u.boom_velocity)
        + cylinder_drive.convected_power(stick, oil_s, u.stick_velocity),
        **flows,
    )


def initial(x: QuasistaticState, u: BoomStickInputs, p: QuasistaticParameters) -> dict[str, Scalar]:
    """Pressures that carry the holding forces."""
    return start_pressures(u, p)


BOOM_STICK = Subsystem(
    name="boom_stick",
    text="Hydraulic drives of boom and stick without line dynamics: spool valves, cylinders",
    parameters=QuasistaticParameters,
    states=QuasistaticState,
    inputs=BoomStickInputs,
    outputs=BoomStickOutputs,
    dynamics=dynamics,
    observe=observe,
    initial=initial,
    require=require,
    values=Path(__file__).with_name("parameters.toml"),
    validity="motions slow beside the oil in the hoses, below some 10 Hz; spool faster than the motion",
    terminals=TERMINALS,
    stiff=False,
)
