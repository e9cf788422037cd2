"""Boom and stick drives at the paper's fidelity: a valve, two hoses and a single-ended cylinder each.

The equations are those of `fmus.boom_stick.drive` for the boom and for the stick. Both drives have the supply
and the oil in common and are otherwise independent.
"""

from fmus.boom_stick import drive
from fmus.boom_stick.drive import PORTS, Drive
from fmus.boom_stick.variables import (
    AxisInputs,
    BoomStickInputs,
    BoomStickOutputs,
    BoomStickParameters,
    BoomStickState,
    OilState,
)
from fmus.components import spool_valve
from fmus.components.chamber import Oil
from fmus.components.circuit import Circuit, Node
from fmus.components.cylinder import Cylinder
from fmus.components.hose import LumpedHose, column
from fmus.components.load_sensing import sensed
from fmus.components.opening_curve import OpeningCurves
from fmus.components.spool_valve import Valve
from fmus.contract import Scalar, quantities


def _drive(axis: str, x: BoomStickState, u: AxisInputs, p: BoomStickParameters) -> Drive:
    state, size, line = OilState.of(x, axis), Cylinder.of(p, axis), LumpedHose.of(p, f"{axis}_hose")
    valve, curves = Valve.of(p, "valve"), OpeningCurves.of(p, "valve")
    a, b = spool_valve.ports_from_flow(
        *(valve, u.command, state.head_flow, state.rod_flow),
        *(u.supply_pressure, u.tank_pressure, p.density, curves),
    )
    hose_values = (line.inertance, line.resistance, valve.transition_flow)
    circuit = drive.cylinder_circuit(size, u, state, Oil.of(p), line.capacitance) | Circuit(
        {"head_valve_pressure": Node(a.pressure), "rod_valve_pressure": Node(b.pressure)},
        {
            **spool_valve.branches((a, b), *PORTS),
            "head_flow": column("head_valve_pressure", "head_pressure", state.head_flow, "I_1", *hose_values),
            "rod_flow": column("rod_valve_pressure", "rod_pressure", state.rod_flow, "I_2", *hose_values),
        },
    )
    return Drive(size, u, circuit, sensed(p, u.command, u.command_rate))


def initial(x: BoomStickState, u: BoomStickInputs, p: BoomStickParameters) -> dict[str, Scalar]:
    """Initial state: pressures in balance with the holding forces, oil at rest."""
    return dict.fromkeys(quantities(BoomStickState), 0) | drive.holding_pressures(u, p)


BOOM_STICK = drive.variant(
    _drive,
    LumpedHose,
    text="Hydraulic drives of boom and stick: spool valves, hoses, cylinders",
    parameters=BoomStickParameters,
    states=BoomStickState,
    outputs=BoomStickOutputs,
    initial=initial,
    require=drive.require,
    validity="below 51 Hz, eq. (3) for the longest hose; spool faster than the motion",
)
