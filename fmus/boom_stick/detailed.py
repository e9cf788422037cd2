"""Detailed boom and stick drives: spool dynamics, hoses as lines, oil with air, relief valves.

For each drive, with a single-ended cylinder,

    C_h dP_h/dt = Q_h - A_h x' - Q_relief,h + Q_anti,h        C_h = (V_0 + A_h x) kappa(P_h)
    C_r dP_r/dt = Q_r + A_r x' - Q_relief,r + Q_anti,r        C_r = (V_0 + A_r (L - x)) kappa(P_r)

with the flows Q_h, Q_r out of the hoses of `fmus.components.hose`, kappa of `chamber`, the spool of
`spool_valve` and the relief and anti-cavitation valves of `orifice`, which are mounted at the cylinder.

`boom_head_flow` is the flow into the cylinder, at the end of the hose, `boom_head_valve_flow` the flow at the
valve; the same for other sides. The arguments of `detailed` change the number of states: lumps of each hose,
and frequency-dependent friction. Signs as in `fmus.boom_stick.variables`.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

from fmus.boom_stick import compensated, drive, lumped
from fmus.boom_stick.drive import Pair
from fmus.boom_stick.variables import (
    AXES,
    SIDES,
    AxisInputs,
    BoomStickInputs,
    DetailedBoomStickOutputs,
    DetailedBoomStickParameters,
    OilState,
)
from fmus.components import chamber, cylinder, hose, orifice, spool_valve
from fmus.components.chamber import Fluid
from fmus.components.cylinder import Cylinder
from fmus.components.detailed_drive import DetailedState, ValveAndLines
from fmus.components.hose import Hose, HydraulicLine
from fmus.components.orifice import PressureValve
from fmus.components.spool_valve import SpoolState
from fmus.contract import Group, Quantity, Scalar, Subsystem, family, make_group, quantities
from fmus.parameters import group_of


@dataclass(frozen=True)
class DetailedDrive:
    """One drive at one instant.

    state, names      group of its states without prefix, and their names
    valve             with its lines: port A at the head side, B at the rod side
    u                 inputs
    relief            flows of the relief valves of both chambers [m3/s]
    anti_cavitation   flows of the anti-cavitation valves of both chambers [m3/s]
    """

    state: type[Any]
    names: DetailedState
    cylinder: Cylinder
    valve: ValveAndLines
    u: AxisInputs
    relief: Pair
    anti_cavitation: Pair

    @property
    def volumes(self) -> Pair:
        """Volumes [m3] of the chambers."""
        return self.cylinder.volumes(self.u.position)

    def pressure_rates(self) -> Pair:
        """dP/dt [Pa/s] of both chambers."""
        a_head, a_rod = self.cylinder.areas
        displaced = (-a_head * self.u.velocity, a_rod * self.u.velocity)
        head, rod = (
            chamber.pressure_rate(
                p, line.flows[-1] + swept - relief + anti, v * chamber.compliance(self.valve.line.fluid, p)
            )
            for p, line, swept, relief, anti, v in zip(
                *(self.valve.x.pressures, self.valve.x.lines, displaced),
                *(self.relief, self.anti_cavitation, self.volumes),
                strict=True,
            )
        )
        return head, rod

    def rates(self) -> Any:
        """Time derivative of the state."""
        rates = self.valve.rates(self.u.command, self.pressure_rates())
        return self.state(**dict(zip(self.names.all(), rates.all(), strict=True)))

    def observe(self) -> dict[str, Any]:
        """Outputs by name without prefix, for `drive.joint_outputs`."""
        (head, rod), x, line, ports = self.cylinder.areas, self.valve.x, self.valve.line, self.valve.ports
        (p_head, p_rod), fluid, tank = x.pressures, line.fluid, self.u.tank_pressure
        relieved = tuple(out - back for out, back in zip(self.relief, self.anti_cavitation, strict=True))
        densities = tuple(chamber.energy_density(fluid, p) for p in x.pressures)
        compression = sum(
            v * e + chamber.stored_energy(p, 0.0)
            for v, e, p in zip(self.volumes, densities, x.pressures, strict=True)
        )
        edges = sum(spool_valve.throttling_loss(n, self.u.supply_pressure, tank) for n in ports)
        relief_heat = (p_head - tank) * relieved[0] + (p_rod - tank) * relieved[1]
        outputs = {
            "force": cylinder.force(head, rod, p_head, p_rod),
            "force_rate": cylinder.force(head, rod, *self.pressure_rates()),
            "void_volume": sum(map(chamber.cavity_volume, x.pressures))
            + sum(map(hose.cavity_volume, x.lines)),
            "spool_position": x.spool.position,
            "relief_flow": sum(self.relief),
            "anti_cavitation_flow": sum(self.anti_cavitation),
            "supply_flow": sum(n.supply for n in ports),
            "return_flow": sum(n.tank for n in ports) + sum(relieved),
            "stored_energy": compression + sum(hose.stored_energy(line, state) for state in x.lines),
            "dissipated_power": edges + relief_heat + sum(hose.heat(line, state) for state in x.lines),
            "convected_power": (head * densities[0] - rod * densities[1]) * self.u.velocity,
            drive.LOAD: self.valve.load_pressure(self.pressure_rates(), self.u),
        }
        for side, p, port, state in zip(SIDES, x.pressures, ports, x.lines, strict=True):
            outputs |= {
                f"{side}_pressure": p,
                f"{side}_flow": state.flows[-1],
                f"{side}_valve_flow": state.flows[0],
                f"{side}_valve_pressure": port.pressure,
                f"{side}_bulk_modulus": chamber.bulk_modulus(fluid, p),
            }
        return outputs


def line(p: DetailedBoomStickParameters, axis: str) -> HydraulicLine:
    """Parameters of each of the two hoses of a drive."""
    return HydraulicLine(
        **vars(Hose.of(p, f"{axis}_hose")), wall_modulus=p.hose_wall_modulus, fluid=Fluid.of(p)
    )


def _drives(
    states: Mapping[str, type[Any]],
    names: Mapping[str, DetailedState],
    x: Any,
    u: BoomStickInputs,
    p: DetailedBoomStickParameters,
) -> Iterator[DetailedDrive]:
    """Boom and stick drive from the variables of the subsystem."""
    relief, anti = PressureValve.of(p, "relief"), PressureValve.of(p, "anti_cavitation")
    for (axis, group), inputs in zip(states.items(), drive.inputs(u), strict=True):
        state = names[axis].apply(partial(getattr, group.of(x, axis)))
        excess = tuple(pressure - inputs.tank_pressure for pressure in state.pressures)
        yield DetailedDrive(
            *(group, names[axis], Cylinder.of(p, axis)),
            *(ValveAndLines.of(p, inputs, line(p, axis), state), inputs),
            relief=(orifice.relief_flow(relief, excess[0]), orifice.relief_flow(relief, excess[1])),
            anti_cavitation=(
                orifice.relief_flow(anti, -excess[0]),
                orifice.relief_flow(anti, -excess[1]),
            ),
        )


def _names(lumps: int, unsteady_friction: bool) -> DetailedState:
    """Names of the states of one drive, without prefix."""
    head, rod = (
        hose.state_names(f"{side}_valve_flow", f"{side}_flow", f"{side}_hose", "", lumps, unsteady_friction)
        for side in SIDES
    )
    spool = SpoolState("spool_position", "spool_speed")
    return DetailedState(spool, (head, rod), ("head_pressure", "rod_pressure"))


def _state(names: DetailedState) -> type[Any]:
    """The group of the states of one drive."""
    lines = [
        (
            f"the {side} hose of the {{}}",
            Quantity("m3/s", f"Flow from the valve into the {side} hose of the {{}}", 1e-3),
            quantities(OilState)[f"{side}_flow"],
        )
        for side in SIDES
    ]
    return make_group("DetailedDriveState", dict(names.declarations("{}", lines, quantities(OilState))))


def _initial(
    names: Mapping[str, DetailedState], x: Any, u: BoomStickInputs, p: DetailedBoomStickParameters
) -> dict[str, Scalar]:
    """Initial state: pressures in balance with the holding forces, no flow, spools at their commands."""
    chambers = drive.holding_pressures(u, p)
    boom, stick = (
        n.start(
            spool_valve.commanded_position(getattr(u, f"{axis}_command"), p.valve_full_command),
            (chambers[f"{axis}_head_pressure"], chambers[f"{axis}_rod_pressure"]),
        )
        for axis, n in names.items()
    )
    return drive.prefixed(boom, stick)


def default_lumps() -> dict[str, int]:
    """Lumps per hose by axis for the values of parameters.toml."""
    p = group_of(drive.PARAMETERS, DetailedBoomStickParameters)
    return {axis: hose.default_lumps(line(p, axis)) for axis in AXES}


def detailed(lumps: int | Mapping[str, int] | None = None, unsteady_friction: bool = False) -> Subsystem:
    """The subsystem of the detailed drives.

    lumps               T-lumps per hose, one number or by axis; default: from `hose.lumps_needed` for 75 Hz
    unsteady_friction   whether hoses have frequency-dependent friction: three more states for each flow
    """
    count = default_lumps() if lumps is None else lumps
    by_axis = {axis: count if isinstance(count, int) else count[axis] for axis in AXES}
    names = {axis: _names(n, unsteady_friction) for axis, n in by_axis.items()}
    states = {axis: _state(n) for axis, n in names.items()}

    class State(Group, **states):
        """State of both drives."""

    sub = drive.variant(
        partial(_drives, states, names),
        Hose,
        text="Detailed hydraulic drives of boom and stick: spool dynamics, lines, air, relief valves",
        parameters=DetailedBoomStickParameters,
        states=State,
        outputs=DetailedBoomStickOutputs,
        initial=partial(_initial, names),
        require=drive.require,
        validity="modes of the hoses up to 75 Hz within 5 %; no flow forces on spools, one temperature",
    )
    others = {"lumped": lumped.BOOM_STICK, "compensated": compensated.BOOM_STICK}
    return family("boom_stick", **others, detailed=sub)["detailed"]


BOOM_STICK = detailed()
