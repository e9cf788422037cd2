"""Boom and stick drives at the paper's fidelity: a valve, two hoses and a single-ended cylinder each.

The equations are those of `fmus.boom_stick.drive` for the boom and for the stick. Both drives have the supply
and the oil in common and are otherwise independent.
"""

from collections.abc import Iterator

from fmus.boom_stick import drive
from fmus.boom_stick.drive import CylinderDrive
from fmus.boom_stick.variables import (
    AXES,
    BoomStickInputs,
    BoomStickOutputs,
    BoomStickParameters,
    BoomStickState,
    OilState,
)
from fmus.components import spool_valve
from fmus.components.cylinder import Cylinder
from fmus.components.hose import LumpedHose
from fmus.components.opening_curve import OpeningCurves
from fmus.components.spool_valve import Valve
from fmus.contract import Scalar, quantities


def _drives(x: BoomStickState, u: BoomStickInputs, p: BoomStickParameters) -> Iterator[CylinderDrive]:
    """Boom and stick drive from the variables of the subsystem."""
    valve, curves = Valve.of(p, "valve"), OpeningCurves.of(p, "valve")
    for axis, inputs in zip(AXES, drive.inputs(u), strict=True):
        cylinder, hose, oil = Cylinder.of(p, axis), LumpedHose.of(p, f"{axis}_hose"), OilState.of(x, axis)
        ports = spool_valve.ports_from_flow(
            *(valve, inputs.command, oil.head_flow, oil.rod_flow),
            *(inputs.supply_pressure, inputs.tank_pressure, p.density, curves),
        )
        yield CylinderDrive(cylinder, hose, valve, curves, p.bulk_modulus, oil, inputs, ports)


def initial(x: BoomStickState, u: BoomStickInputs, p: BoomStickParameters) -> dict[str, Scalar]:
    """Initial state: pressures in balance with the holding forces, oil at rest."""
    return dict.fromkeys(quantities(BoomStickState), 0) | drive.holding_pressures(u, p)


BOOM_STICK = drive.variant(
    _drives,
    LumpedHose,
    text="Hydraulic drives of boom and stick: spool valves, hoses, cylinders",
    parameters=BoomStickParameters,
    states=BoomStickState,
    outputs=BoomStickOutputs,
    initial=initial,
    require=drive.require,
    validity="below 51 Hz, eq. (3) for the longest hose; spool faster than the motion",
)
