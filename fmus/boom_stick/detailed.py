"""Boom and stick drives in detail: moving spools, hoses as lines, oil with air, relief valves.

The equations are those of `fmus.components.hose_drive`, once for the boom, once for the stick.
`boom_head_flow` and its like are the flows into the cylinder, at the hose's far end; `boom_head_valve_flow`
and its like those at the valve. `detailed` chooses what changes the number of states: the lumps of each
hose and the frequency-dependent friction.

Signs: flows are positive towards the cylinder; positions are measured from the closed end;
velocities and forces are positive when they extend the rod; a positive command extends.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

from fmus.boom_stick import lumped
from fmus.boom_stick.detailed_variables import (
    AXES,
    SIDES,
    DetailedOutputs,
    DetailedParameters,
    drive_names,
    states,
)
from fmus.boom_stick.drives import TERMINALS, holding_pressures, room, surroundings
from fmus.boom_stick.variables import BoomStickInputs
from fmus.components import hose_drive, oil, spool_dynamics
from fmus.components.cylinder_drive import Surroundings
from fmus.components.detailed_parameters import BANDWIDTH, ERROR, fluid
from fmus.components.hose_drive import DriveState, HoseDrive
from fmus.components.hose_line import Line, lumps_needed
from fmus.components.spool_dynamics import SpoolState
from fmus.contract import Scalar, Subsystem, family
from fmus.parameters import read

NUMBERS = Path(__file__).with_name("parameters.toml")

Names = Mapping[str, DriveState]


def hose(p: DetailedParameters, axis: str) -> Line:
    """Each of the two hoses of a drive."""
    of = fluid(p, p.density, p.bulk_modulus)
    own = {n: getattr(p, f"{axis}_hose_{n}") for n in ("length", "bore", "resistance")}
    return Line(**own, wall_modulus=p.hose_wall_modulus, fluid=of)


def drives(p: DetailedParameters) -> tuple[HoseDrive, ...]:
    """The two drives, boom and stick, from the flat parameters."""
    own = ("bore", "rod", "stroke", "dead_volume")
    return tuple(
        HoseDrive(
            **{n: getattr(p, f"{axis}_{n}") for n in own},
            full_command=p.valve_full_command,
            hose=(line := hose(p, axis)),
            fluid=line.fluid,
            edges=p.edges,
            spool=p.spool,
            relief=p.relief,
            anti_cavitation=p.anti_cavitation,
        )
        for axis in AXES
    )


def _of(x: Any, n: DriveState) -> DriveState:
    """The state of one drive from the flat states."""

    def get(name: str) -> Scalar:
        return getattr(x, name)

    spool = SpoolState(get(n.spool.position), get(n.spool.speed))
    hoses = (n.head_line.each(get), n.rod_line.each(get))
    return DriveState(spool, *hoses, get(n.head_pressure), get(n.rod_pressure))


def _shown(d: HoseDrive, x: DriveState, at: Surroundings) -> dict[str, Scalar]:
    """Outputs of one drive, without the name of its axis."""
    ports, rates = hose_drive.valve_ports(d, x, at), hose_drive.pressure_rates(d, x, at)
    safe = hose_drive.safety_flows(d, x, at)
    pressures = (x.head_pressure, x.rod_pressure)
    shown = {
        "force": hose_drive.force(d, *pressures),
        "force_rate": hose_drive.force(d, *rates),
        "void_volume": hose_drive.void_volume(x),
        "spool_position": x.spool.position,
        "relief_flow": safe.relief_head + safe.relief_rod,
        "anti_cavitation_flow": safe.anti_head + safe.anti_rod,
    }
    for side, pressure, port, of in zip(SIDES, pressures, ports, (x.head_line, x.rod_line), strict=True):
        shown |= {
            f"{side}_pressure": pressure,
            f"{side}_flow": of.flows[-1],
            f"{side}_valve_flow": of.flows[0],
            f"{side}_valve_pressure": port.pressure,
            f"{side}_bulk_modulus": oil.bulk_modulus(d.fluid, pressure),
        }
    return shown


def _observe(names: Names, x: Any, u: BoomStickInputs, p: DetailedParameters) -> DetailedOutputs:
    """Outputs; forces depend on the state alone, their rates and the flows on the inputs too."""
    both = tuple(zip(drives(p), (_of(x, n) for n in names.values()), surroundings(u), strict=True))
    ports = [node for d, oils, at in both for node in hose_drive.valve_ports(d, oils, at)]
    shown = {
        f"{axis}_{name}": value
        for axis, one in zip(AXES, both, strict=True)
        for name, value in _shown(*one).items()
    }
    return DetailedOutputs(
        **shown,
        supply_flow=sum(n.supply for n in ports),
        return_flow=sum(n.tank for n in ports) + sum(hose_drive.safety_flows(*one).to_tank for one in both),
        stored_energy=sum(hose_drive.stored_energy(d, oils, at.position) for d, oils, at in both),
        dissipated_power=sum(hose_drive.dissipated_power(*one) for one in both),
        convected_power=sum(hose_drive.convected_power(d, oils, at.velocity) for d, oils, at in both),
    )


def _initial(names: Names, x: Any, u: BoomStickInputs, p: DetailedParameters) -> dict[str, Scalar]:
    """Pressures that carry the holding forces, all along the hoses; no flow; the spool where it is told."""
    chambers = holding_pressures(u, p, drives(p))
    commands = (u.boom_command, u.stick_command)
    state: dict[str, Scalar] = {}
    for (axis, n), command in zip(names.items(), commands, strict=True):
        state |= dict.fromkeys(n.all(), 0.0)
        state[n.spool.position] = spool_dynamics.share(command, p.valve_full_command)
        for side, of in zip(SIDES, (n.head_line, n.rod_line), strict=True):
            pressure = chambers[f"{axis}_{side}_pressure"]
            state |= dict.fromkeys((f"{axis}_{side}_pressure", *of.pressures), pressure)
    return state


def _require(x: object, u: BoomStickInputs, p: DetailedParameters) -> dict[str, Scalar]:
    """Rods thinner than bores, chambers with volume."""
    return room(u, drives(p))


def advised_lumps() -> dict[str, int]:
    """Lumps per hose by axis that `BANDWIDTH` and `ERROR` need with the numbers of parameters.toml."""
    found = read(NUMBERS)["parameters"]
    p = DetailedParameters(**{f.name: found[f.name].value for f in fields(DetailedParameters)})
    hoses = {axis: hose(p, axis) for axis in AXES}
    return {
        axis: lumps_needed(h.length, h.bore, BANDWIDTH, ERROR, h.fluid, h.wall_modulus)
        for axis, h in hoses.items()
    }


def detailed(lumps: int | Mapping[str, int] | None = None, unsteady_friction: bool = False) -> Subsystem:
    """The detailed drives.

    lumps               T-lumps per hose, or by axis; by default what `lumps_needed` advises up to 75 Hz
    unsteady_friction   with the frequency-dependent friction of the hoses: three more states for each flow
    """
    count = advised_lumps() if lumps is None else lumps
    each = {axis: count if isinstance(count, int) else count[axis] for axis in AXES}
    names = {axis: drive_names(axis, n, unsteady_friction) for axis, n in each.items()}
    state = states(names)

    def dynamics(x: Any, u: BoomStickInputs, p: DetailedParameters) -> Any:
        """Time derivative of the state."""
        return state(
            **{
                name: rate
                for d, n, at in zip(drives(p), names.values(), surroundings(u), strict=True)
                for name, rate in zip(n.all(), hose_drive.rates(d, _of(x, n), at).all(), strict=True)
            }
        )

    sub = Subsystem(
        name="boom_stick",
        text="Hydraulic drives of boom and stick in detail: moving spools, lines, air, relief valves",
        parameters=DetailedParameters,
        states=state,
        inputs=BoomStickInputs,
        outputs=DetailedOutputs,
        dynamics=dynamics,
        observe=lambda x, u, p: _observe(names, x, u, p),
        initial=lambda x, u, p: _initial(names, x, u, p),
        require=_require,
        values=NUMBERS,
        validity="modes of the hoses up to 75 Hz within 5 %; no flow forces on spools, one temperature",
        terminals=TERMINALS,
    )
    return family("boom_stick", lumped=lumped.BOOM_STICK, detailed=sub)["detailed"]


BOOM_STICK = detailed()
