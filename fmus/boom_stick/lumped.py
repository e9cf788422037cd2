"""Boom and stick drives at the paper's fidelity: a valve, two hoses and a single-ended cylinder each.

The equations are those of `fmus.boom_stick.drive` for the boom and for the stick. Both drives have the supply
and the oil in common and are otherwise independent.
"""

from collections.abc import Iterator
from functools import partial

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
from fmus.components.oil import at_temperature
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


def dynamics(x: BoomStickState, u: BoomStickInputs, p: BoomStickParameters) -> BoomStickState:
    """Time derivative of the state."""
    boom, stick = (vars(d.rates()) for d in _drives(x, u, p))
    return BoomStickState(**drive.prefixed(boom, stick))


def observe(x: BoomStickState, u: BoomStickInputs, p: BoomStickParameters) -> BoomStickOutputs:
    """Outputs; forces depend only on the state, their rates and the flows also on the inputs."""
    boom, stick = (d.observe(d.hose_heat()) for d in _drives(x, u, p))
    return BoomStickOutputs(**drive.joint_outputs(boom, stick))


def initial(x: BoomStickState, u: BoomStickInputs, p: BoomStickParameters) -> dict[str, Scalar]:
    """Initial state: pressures in balance with the holding forces, oil at rest."""
    return dict.fromkeys(quantities(BoomStickState), 0) | drive.holding_pressures(u, p)


BOOM_STICK = at_temperature(
    drive.variant(
        text="Hydraulic drives of boom and stick: spool valves, hoses, cylinders",
        parameters=BoomStickParameters,
        states=BoomStickState,
        outputs=BoomStickOutputs,
        dynamics=dynamics,
        observe=observe,
        initial=initial,
        require=drive.require,
        derive=partial(drive.derive, LumpedHose),
        validity="below 51 Hz, eq. (3) for the longest hose; spool faster than the motion",
    )
)
