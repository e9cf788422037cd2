"""Boom and stick drives at the paper's fidelity: a valve, two hoses and a single-ended cylinder each.

The equations are those of `fmus.boom_stick.drive`, once for the boom, once for the stick;
the two share the supply and the oil and are otherwise independent.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path

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
from fmus.contract import Scalar, Subsystem, quantities


def dynamics(x: BoomStickState, u: BoomStickInputs, p: BoomStickParameters) -> BoomStickState:
    """Time derivative of the state."""
    oils = (OilState.of(x, axis) for axis in AXES)
    boom, stick = map(drive.rates, drive.drives(p), oils, drive.surroundings(u))
    return BoomStickState(**drive.named(vars(boom), vars(stick)))


def observe(x: BoomStickState, u: BoomStickInputs, p: BoomStickParameters) -> BoomStickOutputs:
    """Outputs; forces depend on the state alone, their rates and the flows on the inputs too."""
    boom, stick = (
        drive.observe(
            d,
            oil,
            drive.pressure_rates(d, oil, at),
            drive.valve_ports(d, oil, at),
            at,
            drive.hose_heat(d, oil),
        )
        for d, oil, at in zip(
            drive.drives(p), (OilState.of(x, axis) for axis in AXES), drive.surroundings(u), strict=True
        )
    )
    return drive.together(BoomStickOutputs, boom, stick)


def initial(x: BoomStickState, u: BoomStickInputs, p: BoomStickParameters) -> dict[str, Scalar]:
    """Pressures that carry the holding forces with the oil at rest."""
    return dict.fromkeys(quantities(BoomStickState), 0) | drive.holding_pressures(u, p)


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
    require=drive.require,
    derive=partial(drive.derive, LumpedHose),
    values=Path(__file__).with_name("parameters.toml"),
    validity="below 51 Hz, eq. (3) for the longest hose; spool faster than the motion",
    terminals=drive.TERMINALS,
)
