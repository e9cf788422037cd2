"""Boom and stick drives at the paper's fidelity: a valve, two hoses and a single-ended cylinder each.

The equations are those of `fmus.components.cylinder_drive`, once for the boom, once for the stick;
the two share the supply and the oil and are otherwise independent.

Signs: line flows are positive into the cylinder; positions are measured from the closed end;
velocities and forces are positive when they extend the rod; a positive command extends.
"""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path

from fmus.boom_stick.drives import TERMINALS, drives, require, start_pressures, surroundings
from fmus.boom_stick.variables import BoomStickInputs, BoomStickOutputs, BoomStickParameters, BoomStickState
from fmus.components import cylinder_drive
from fmus.components.cylinder_drive import Drive, Oil
from fmus.contract import Scalar, Subsystem


def _drives(p: BoomStickParameters) -> tuple[Drive, Drive]:
    return drives(p, p.boom_hose_inertance, p.stick_hose_inertance)


def _oil(x: BoomStickState) -> tuple[Oil, Oil]:
    names = [f.name for f in fields(Oil)]
    boom, stick = (Oil(**{n: getattr(x, f"{a}_{n}") for n in names}) for a in ("boom", "stick"))
    return boom, stick


def _named(boom: Oil, stick: Oil) -> dict[str, Scalar]:
    return {f"{a}_{n}": v for a, oil in (("boom", boom), ("stick", stick)) for n, v in vars(oil).items()}


def dynamics(x: BoomStickState, u: BoomStickInputs, p: BoomStickParameters) -> BoomStickState:
    """Time derivative of the state."""
    boom, stick = (
        cylinder_drive.rates(d, oil, s)
        for d, oil, s in zip(_drives(p), _oil(x), surroundings(u), strict=True)
    )
    return BoomStickState(**_named(boom, stick))


def observe(x: BoomStickState, u: BoomStickInputs, p: BoomStickParameters) -> BoomStickOutputs:
    """Outputs; forces depend on the state alone, their rates and the flows on the inputs too."""
    (boom, stick), (oil_b, oil_s), (at_b, at_s) = _drives(p), _oil(x), surroundings(u)
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
    at_rest = {f"{axis}_{side}_flow": 0 for axis in ("boom", "stick") for side in ("head", "rod")}
    return start_pressures(u, p) | at_rest


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
    validity="below 51 Hz, eq. (3) for the longest hose; spool faster than the motion",
    terminals=TERMINALS,
)
