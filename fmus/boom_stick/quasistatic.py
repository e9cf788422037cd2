"""Boom and stick drives without line dynamics: a valve directly at a single-ended cylinder, for each.

The equations are those of `fmus.boom_stick.drive`, once for the boom, once for the stick: the limit of the
lumped drives for hoses without inertance. The hoses stay as volumes and as resistances in series with the
open edges. Line flows are no states but follow from the pressures.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path

from fmus.boom_stick import drive
from fmus.boom_stick.drive import CylinderDrive, Surroundings
from fmus.boom_stick.variables import (
    AXES,
    BoomStickInputs,
    BoomStickOutputs,
    OilState,
    Pressures,
    QuasistaticBoomStickParameters,
    QuasistaticBoomStickState,
)
from fmus.components.hose import LumpedHose, VolumeHose
from fmus.components.spool_valve import EdgeFlows
from fmus.contract import Scalar, Subsystem


def _hose(p: QuasistaticBoomStickParameters, prefix: str) -> LumpedHose:
    return LumpedHose(**vars(VolumeHose.of(p, prefix)), inertance=0.0)


def _now(
    x: QuasistaticBoomStickState, u: BoomStickInputs, p: QuasistaticBoomStickParameters
) -> list[tuple[CylinderDrive, OilState, tuple[EdgeFlows, EdgeFlows], Surroundings]]:
    """Of each drive its numbers, its oil with the line flows that follow from the pressures, its ports."""
    found = []
    for axis, d, at in zip(AXES, drive.drives(p, _hose), drive.surroundings(u), strict=True):
        own = Pressures.of(x, axis)
        ports = drive.direct_valve_ports(d, (own.head_pressure, own.rod_pressure), at)
        oil = OilState(**vars(own), head_flow=ports[0].line, rod_flow=ports[1].line)
        found.append((d, oil, ports, at))
    return found


def dynamics(
    x: QuasistaticBoomStickState, u: BoomStickInputs, p: QuasistaticBoomStickParameters
) -> QuasistaticBoomStickState:
    """Time derivative of the state."""
    rates = (drive.pressure_rates(d, oil, at) for d, oil, _, at in _now(x, u, p))
    boom, stick = ({"head_pressure": head, "rod_pressure": rod} for head, rod in rates)
    return QuasistaticBoomStickState(**drive.named(boom, stick))


def observe(
    x: QuasistaticBoomStickState, u: BoomStickInputs, p: QuasistaticBoomStickParameters
) -> BoomStickOutputs:
    """Outputs; forces depend on the state alone, their rates and the flows on the inputs too.

    The heat of the hoses is in that of the edges before them: the ports' pressures are those of the chambers.
    """
    boom, stick = (
        drive.observe(d, oil, drive.pressure_rates(d, oil, at), ports, at, 0)
        for d, oil, ports, at in _now(x, u, p)
    )
    return drive.together(BoomStickOutputs, boom, stick)


def initial(
    x: QuasistaticBoomStickState, u: BoomStickInputs, p: QuasistaticBoomStickParameters
) -> dict[str, Scalar]:
    """Pressures that carry the holding forces."""
    return drive.holding_pressures(u, p)


BOOM_STICK = Subsystem(
    name="boom_stick",
    text="Hydraulic drives of boom and stick without line dynamics: spool valves, cylinders",
    parameters=QuasistaticBoomStickParameters,
    states=QuasistaticBoomStickState,
    inputs=BoomStickInputs,
    outputs=BoomStickOutputs,
    dynamics=dynamics,
    observe=observe,
    initial=initial,
    require=drive.require,
    derive=partial(drive.derive, VolumeHose),
    values=Path(__file__).with_name("parameters.toml"),
    validity="motions slow beside the oil in the hoses, below some 10 Hz; spool faster than the motion",
    terminals=drive.TERMINALS,
    stiff=False,
)
