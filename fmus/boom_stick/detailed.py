"""Detailed boom and stick drives: spool dynamics, hoses as lines, oil with air, relief valves.

For each drive, with a single-ended cylinder,

    C_h dP_h/dt = Q_h - A_h x' - Q_relief,h + Q_anti,h        C_h = (V_0 + A_h x) kappa(P_h)
    C_r dP_r/dt = Q_r + A_r x' - Q_relief,r + Q_anti,r        C_r = (V_0 + A_r (L - x)) kappa(P_r)

with the flows Q_h, Q_r out of the hoses of `fmus.components.hose`, kappa of `chamber`, the spool of
`spool_valve` and the relief and anti-cavitation valves of `orifice`, which are mounted at the cylinder.

`boom_head_flow` is the flow into the cylinder, at the end of the hose, `boom_head_valve_flow` the flow at the
valve; the same for other sides. The argument of `detailed` changes the number of lumps of each hose. Signs as
in `fmus.boom_stick.variables`.
"""

from collections.abc import Mapping
from functools import partial
from typing import Any

from fmus.boom_stick import compensated, drive, lumped
from fmus.boom_stick.drive import CHAMBERS, PORTS, Drive
from fmus.boom_stick.variables import (
    AXES,
    SIDES,
    AxisInputs,
    BoomStickInputs,
    DetailedAxisOutputs,
    DetailedBoomStickOutputs,
    DetailedBoomStickParameters,
    OilState,
)
from fmus.components import hose, spool_valve
from fmus.components.chamber import Fluid
from fmus.components.circuit import Circuit
from fmus.components.cylinder import Cylinder
from fmus.components.detailed_drive import DetailedStates
from fmus.components.hose import Hose, HydraulicLine
from fmus.components.spool_valve import SpoolState
from fmus.contract import Group, Scalar, Subsystem, family, make_group, quantities
from fmus.parameters import group_of


def line(p: DetailedBoomStickParameters, axis: str) -> HydraulicLine:
    """Parameters of each of the two hoses of a drive."""
    return HydraulicLine(
        **vars(Hose.of(p, f"{axis}_hose")), wall_modulus=p.hose_wall_modulus, fluid=Fluid.of(p)
    )


def _drive(
    states: Mapping[str, DetailedStates],
    groups: Mapping[str, type[Any]],
    axis: str,
    x: Any,
    u: AxisInputs,
    p: DetailedBoomStickParameters,
) -> Drive:
    state, size, oil = groups[axis].of(x, axis), Cylinder.of(p, axis), Fluid.of(p)
    valve, load, spool_rates = states[axis].valve_and_lines(p, u, u.command, line(p, axis), state)
    circuit = drive.cylinder_circuit(size, u, state, oil) | valve
    circuit |= Circuit({}, drive.reliefs(p, "relief", CHAMBERS))
    shown = {
        "spool_position": state.spool_position,
        "head_bulk_modulus": 1 / oil.compliance(state.head_pressure),
        "rod_bulk_modulus": 1 / oil.compliance(state.rod_pressure),
    }
    return Drive(size, u, circuit, load, spool_rates, shown)


def _states(lumps: int) -> DetailedStates:
    """States of one drive, without prefix."""
    declared = {**quantities(OilState), **quantities(DetailedAxisOutputs)}
    head, rod = (
        hose.line_states(
            {name: declared[name] for name in (f"{side}_valve_flow", f"{side}_flow")},
            *(f"{side}_hose", "", f"the {side} hose of the {{}}", lumps),
        )
        for side in SIDES
    )
    spool = SpoolState("spool_position", "spool_speed")
    return DetailedStates(spool, (head, rod), {name: declared[name] for name in CHAMBERS}, PORTS)


def _initial(
    states: Mapping[str, DetailedStates], x: Any, u: BoomStickInputs, p: DetailedBoomStickParameters
) -> dict[str, Scalar]:
    """Initial state: pressures in balance with the holding forces, no flow, spools at their commands."""
    chambers = drive.holding_pressures(u, p)
    boom, stick = (
        n.start(
            spool_valve.commanded_position(getattr(u, f"{axis}_command"), p.valve_full_command),
            (chambers[f"{axis}_head_pressure"], chambers[f"{axis}_rod_pressure"]),
        )
        for axis, n in states.items()
    )
    return drive.prefixed(boom, stick)


def default_lumps() -> dict[str, int]:
    """Lumps per hose by axis for the values of parameters.toml."""
    p = group_of(drive.PARAMETERS, DetailedBoomStickParameters)
    return {axis: hose.default_lumps(line(p, axis)) for axis in AXES}


def detailed(lumps: int | Mapping[str, int] | None = None) -> Subsystem:
    """The subsystem of the detailed drives.

    lumps   T-lumps per hose, one number or by axis; default: from `hose.lumps_needed` for 75 Hz
    """
    count = default_lumps() if lumps is None else lumps
    by_axis = {axis: count if isinstance(count, int) else count[axis] for axis in AXES}
    of_axis = {axis: _states(n) for axis, n in by_axis.items()}
    groups = {axis: make_group("DetailedDriveState", states.all("{}")) for axis, states in of_axis.items()}

    class State(Group, **groups):
        """State of both drives."""

    sub = drive.variant(
        partial(_drive, of_axis, groups),
        Hose,
        text="Detailed hydraulic drives of boom and stick: spool dynamics, lines, air, relief valves",
        parameters=DetailedBoomStickParameters,
        states=State,
        outputs=DetailedBoomStickOutputs,
        initial=partial(_initial, of_axis),
        require=drive.require,
        validity="modes of the hoses up to 75 Hz within 5 %; no flow forces on spools, one temperature",
    )
    others = {"lumped": lumped.BOOM_STICK, "compensated": compensated.BOOM_STICK}
    return family("boom_stick", **others, detailed=sub)["detailed"]


BOOM_STICK = detailed()
