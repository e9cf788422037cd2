"""Boom and stick drives without line dynamics: a valve directly at a single-ended cylinder each.

The equations are those of `fmus.boom_stick.drive` for the boom and for the stick, in the limit of hoses
without inertance. The hoses are volumes, and resistances in series with the open edges. Line flows are not
states but follow from the pressures.
"""

from fmus.boom_stick import drive
from fmus.boom_stick.drive import CHAMBERS, Drive
from fmus.boom_stick.variables import (
    AxisInputs,
    BoomStickInputs,
    BoomStickOutputs,
    Preload,
    Pressures,
    QuasistaticDriveParameters,
)
from fmus.components import spool_valve
from fmus.components.chamber import Oil
from fmus.components.circuit import Circuit
from fmus.components.cylinder import Cylinder
from fmus.components.hose import ReferenceHose, VolumeHose
from fmus.components.load_sensing import sensed
from fmus.components.opening_curve import OpeningCurves
from fmus.components.spool_valve import CurvedValve, Valve
from fmus.contract import Group, Scalar


class Parameters(
    Oil,
    Preload,
    ReferenceHose,
    valve=CurvedValve,
    boom=QuasistaticDriveParameters,
    stick=QuasistaticDriveParameters,
):
    """Parameters of the quasistatic drives; values and sources are in parameters.toml."""


class State(Group, boom=Pressures, stick=Pressures):
    """State of the quasistatic drives: pressures."""


def _drive(axis: str, x: State, u: AxisInputs, p: Parameters) -> Drive:
    state, size, hose = Pressures.of(x, axis), Cylinder.of(p, axis), VolumeHose.of(p, f"{axis}_hose")
    valve, curves = Valve.of(p, "valve"), OpeningCurves.of(p, "valve")
    a, b = spool_valve.ports_from_pressure(
        *(valve, u.command, state.head_pressure, state.rod_pressure),
        *(u.supply_pressure, u.tank_pressure, p.density, hose.resistance, curves),
    )
    circuit = drive.cylinder_circuit(size, u, state, Oil.of(p), hose.capacitance)
    circuit |= Circuit({}, spool_valve.branches((a, b), *CHAMBERS))
    flows = {"head_flow": a.line, "rod_flow": b.line}
    return Drive(size, u, circuit, sensed(p, u.command, u.command_rate), shown=flows)


def initial(x: State, u: BoomStickInputs, p: Parameters) -> dict[str, Scalar]:
    """Initial state: pressures in balance with the holding forces."""
    return drive.holding_pressures(u, p)


BOOM_STICK = drive.variant(
    _drive,
    VolumeHose,
    text="Hydraulic drives of boom and stick without line dynamics: spool valves, cylinders",
    parameters=Parameters,
    states=State,
    outputs=BoomStickOutputs,
    initial=initial,
    require=drive.require,
    validity="motions slow compared with the oil in the hoses, below about 10 Hz;"
    " spool faster than the motion",
    stiff=False,
)
