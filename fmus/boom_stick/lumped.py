"""Boom and stick drives at the paper's fidelity: a valve, two hoses and a single-ended cylinder each.

The equations are those of `fmus.boom_stick.drive` for the boom and for the stick. Both drives have the supply
and the oil in common and are otherwise independent.
"""

from functools import partial

from fmus.boom_stick import drive
from fmus.boom_stick.variables import (
    AXES,
    BoomStickInputs,
    BoomStickOutputs,
    BoomStickParameters,
    BoomStickState,
    OilState,
)
from fmus.components.hose import LumpedHose
from fmus.contract import Scalar, quantities


def dynamics(x: BoomStickState, u: BoomStickInputs, p: BoomStickParameters) -> BoomStickState:
    """Time derivative of the state."""
    states = (OilState.of(x, axis) for axis in AXES)
    boom, stick = map(drive.rates, drive.drives(p), states, drive.inputs(u))
    return BoomStickState(**drive.prefixed(vars(boom), vars(stick)))


def observe(x: BoomStickState, u: BoomStickInputs, p: BoomStickParameters) -> BoomStickOutputs:
    """Outputs; forces depend only on the state, their rates and the flows also on the inputs."""
    boom, stick = (
        drive.observe(
            d,
            oil,
            drive.pressure_rates(d, oil, inputs),
            drive.valve_ports(d, oil, inputs),
            inputs,
            drive.hose_heat(d, oil),
        )
        for d, oil, inputs in zip(
            drive.drives(p), (OilState.of(x, axis) for axis in AXES), drive.inputs(u), strict=True
        )
    )
    return BoomStickOutputs(**drive.joint_outputs(boom, stick))


def initial(x: BoomStickState, u: BoomStickInputs, p: BoomStickParameters) -> dict[str, Scalar]:
    """Initial state: pressures in balance with the holding forces, oil at rest."""
    return dict.fromkeys(quantities(BoomStickState), 0) | drive.holding_pressures(u, p)


BOOM_STICK = drive.variant(
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
