"""Boom and stick drives of a load-sensing machine: compensated sections, counterbalance valves, port reliefs.

For each side of each cylinder, head (port A) or rod (port B), with the pressures P_V of the hose at the valve
and P_C of the chamber:

    C_V dP_V/dt    = Q_port - Q_C - Q_relief + Q_anti         Q_port = Q_in - Q_out of `pressure_compensator`
    C_C dP_C/dt    = Q_C -+ A x'                              C_C = V_C(x) kappa(P_C)
    dy/dt          = (y_0 - y)/T                              Q_C, y_0 of `counterbalance_valve`

C_V = A l (kappa(P_V) + 1/E_wall), with kappa of `chamber`: the walls are elastic, and the oil has air.
The counterbalance valves are mounted at the cylinder, each piloted by the hose of the other side. Relief and
anti-cavitation valves of `orifice` are mounted at the valve. Hoses are volumes, and resistances in series
with the counterbalance valves, as in `quasistatic`; flows follow from pressures. The sections sense the
pressures of their ports. Forces depend only on the states. Signs as in `fmus.boom_stick.variables`.

The boom's counterbalance valve meters when the boom is lowered: its meter-out edge is wide, so that no more
pressure is needed than opens the valve. Behind a compensated section this is stable only with a low pilot
ratio (docs/equations.md). The other meter-out edges are so small that their counterbalance valves are fully
open in motion.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from fmus.boom_stick import drive
from fmus.boom_stick.drive import Pair
from fmus.boom_stick.variables import (
    AXES,
    SIDES,
    AxisInputs,
    BoomStickInputs,
    BoomStickOutputs,
    Preload,
    Pressures,
    QuasistaticDriveParameters,
)
from fmus.components import chamber, counterbalance_valve, cylinder, hose, load_sensing, orifice, spool_valve
from fmus.components import pressure_compensator as compensator
from fmus.components.chamber import AeratedOil
from fmus.components.counterbalance_valve import Counterbalance, Restriction
from fmus.components.cylinder import Cylinder
from fmus.components.hose import HoseWall, ReferenceHose, VolumeHose
from fmus.components.orifice import AntiCavitationParameters, PressureValve
from fmus.components.pressure_compensator import Compensator, Section, SectionPort, SectionValve
from fmus.contract import Group, Quantity, Scalar


class AxisParameters(QuasistaticDriveParameters):
    """Cylinder, hoses and section of one drive."""

    section_flow: Scalar = Quantity(
        "m3/s", "Flow of the {} section at full command", 1e-3, minimum=1e-6, group="{} section"
    )
    head_return_area: Scalar = Quantity(
        "m2", "Area of the meter-out edge from the head side of the {} at full command", 1e-4, minimum=1e-9
    )
    rod_return_area: Scalar = Quantity(
        "m2", "Area of the meter-out edge from the rod side of the {} at full command", 1e-4, minimum=1e-9
    )
    head_pilot_ratio: Scalar = Quantity(
        "1", "Pilot ratio R of the counterbalance valve at the head side of the {} cylinder", minimum=0.0
    )
    rod_pilot_ratio: Scalar = Quantity(
        "1", "Pilot ratio R of the counterbalance valve at the rod side of the {} cylinder", minimum=0.0
    )


class Parameters(
    AeratedOil,
    Preload,
    ReferenceHose,
    HoseWall,
    AntiCavitationParameters,
    valve=SectionValve,
    compensator=Compensator,
    counterbalance=Counterbalance,
    port_relief=(PressureValve, "port relief"),
    boom=AxisParameters,
    stick=AxisParameters,
):
    """Parameters of the compensated drives; values and sources are in parameters.toml."""

    neutral_area: Scalar = Quantity(
        "m2", "Area that connects each port to the return line in neutral", 1e-6, minimum=0.0, group="Neutral"
    )


class Lines(Group):
    """Pressures at the valve and openings of the counterbalance valves of one drive."""

    head_valve_pressure: Scalar = chamber.pressure("Pressure at port A of the {} valve")
    rod_valve_pressure: Scalar = chamber.pressure("Pressure at port B of the {} valve")
    head_counterbalance_opening: Scalar = Quantity(
        "1", "Opening of the counterbalance valve at the head side of the {} cylinder"
    )
    rod_counterbalance_opening: Scalar = Quantity(
        "1", "Opening of the counterbalance valve at the rod side of the {} cylinder"
    )


class AxisState(Pressures, Lines):
    """State of one drive; also used for its rates."""

    def pair(self, name: str) -> Pair:
        """The values of a name at head and rod side."""
        return getattr(self, f"head_{name}"), getattr(self, f"rod_{name}")


class State(Group, boom=AxisState, stick=AxisState):
    """State of both drives."""


class AxisOutputs(Lines):
    """Signals of section, counterbalance valves and relief valves of one drive."""

    meter_in_flow: Scalar = Quantity("m3/s", "Flow of the {} section from the supply line", 1e-3)
    metering_drop: Scalar = Quantity("Pa", "Drop over the open meter-in edge of the {} section", 1e6)
    compensator_drop: Scalar = Quantity("Pa", "Drop over the compensator of the {} section", 1e7)
    head_valve_flow: Scalar = Quantity("m3/s", "Flow from the valve into the head hose of the {}", 1e-3)
    rod_valve_flow: Scalar = Quantity("m3/s", "Flow from the valve into the rod hose of the {}", 1e-3)
    relief_flow: Scalar = Quantity("m3/s", "Flow of both relief valves of the {}", 1e-3)
    anti_cavitation_flow: Scalar = Quantity("m3/s", "Flow of both anti-cavitation valves of the {}", 1e-3)


class Outputs(BoomStickOutputs, boom=AxisOutputs, stick=AxisOutputs):
    """Outputs of every variant, and signals of sections and valves."""


@dataclass(frozen=True)
class Side:
    """Head or rod side of a cylinder at one instant.

    pressure, line, opening   states: pressures of chamber and hose [Pa], opening of the counterbalance valve
    pilot_ratio               of the counterbalance valve
    port                      of the section
    flow                      through the counterbalance valve into the chamber [m3/s]
    relief, anti_cavitation   flows of the valves at the port [m3/s]
    """

    pressure: Scalar
    line: Scalar
    opening: Scalar
    pilot_ratio: Scalar
    port: SectionPort
    flow: Scalar
    relief: Scalar
    anti_cavitation: Scalar


@dataclass(frozen=True)
class CompensatedDrive:
    """One drive at one instant: parameters, state, inputs and both sides, the head side first."""

    cylinder: Cylinder
    hose: VolumeHose
    section: Section
    counterbalance: Counterbalance
    oil: AeratedOil
    x: AxisState
    u: AxisInputs
    sides: tuple[Side, Side]

    @property
    def volumes(self) -> Pair:
        """Volumes [m3] of both chambers."""
        return self.cylinder.volumes(self.u.position)

    @property
    def hose_volume(self) -> Scalar:
        """Volume [m3] of each hose."""
        return hose.area(self.hose.bore) * self.hose.length

    def rates(self) -> AxisState:
        """Time derivative of the state."""
        (head, rod), c, result = self.cylinder.areas, self.counterbalance, {}
        swept = (-head * self.u.velocity, rod * self.u.velocity)
        sides = zip(SIDES, self.sides, self.sides[::-1], swept, self.volumes, strict=True)
        for name, s, opposite, displaced, volume in sides:
            result[f"{name}_pressure"] = chamber.pressure_rate(
                s.pressure, s.flow + displaced, volume * chamber.compliance(self.oil, s.pressure)
            )
            result[f"{name}_valve_pressure"] = chamber.pressure_rate(
                s.line,
                s.port.edges.line - s.flow - s.relief + s.anti_cavitation,
                self.hose.capacitance + self.hose_volume * chamber.air_compliance(self.oil, s.line),
            )
            balance = counterbalance_valve.balance(
                c, s.pilot_ratio, s.pressure, opposite.line, s.line, self.u.tank_pressure
            )
            result[f"{name}_counterbalance_opening"] = (balance - s.opening) / c.lag
        return AxisState(**result)

    def observe(self) -> dict[str, Any]:
        """Outputs by name without prefix, for `drive.joint_outputs`."""
        (head, rod), rates = self.cylinder.areas, self.rates()
        chambers, lines = self.x.pair("pressure"), self.x.pair("valve_pressure")
        supply, tank = self.u.supply_pressure, self.u.tank_pressure
        ports = (self.sides[0].port, self.sides[1].port)
        meter_in, metering_drop, compensator_drop = compensator.shown(self.section, ports, self.u.command)
        edges = sum(spool_valve.throttling_loss(port.edges, supply, tank) for port in ports)
        relieved = [s.relief - s.anti_cavitation for s in self.sides]
        heat = edges + sum(
            s.flow * (s.line - s.pressure) + out * (s.line - tank)
            for s, out in zip(self.sides, relieved, strict=True)
        )
        densities = tuple(chamber.energy_density(self.oil, p) for p in chambers)
        compression = sum(
            v * e + chamber.stored_energy(p, 0.0)
            for v, e, p in zip(self.volumes, densities, chambers, strict=True)
        ) + sum(
            chamber.stored_energy(p, self.hose.capacitance)
            + self.hose_volume * chamber.air_energy_density(self.oil, p)
            for p in lines
        )
        return {
            **vars(self.x),
            "force": cylinder.force(head, rod, *chambers),
            "force_rate": cylinder.force(head, rod, *rates.pair("pressure")),
            "void_volume": sum(map(chamber.cavity_volume, (*chambers, *lines))),
            "meter_in_flow": meter_in,
            "metering_drop": metering_drop,
            "compensator_drop": compensator_drop,
            "relief_flow": sum(s.relief for s in self.sides),
            "anti_cavitation_flow": sum(s.anti_cavitation for s in self.sides),
            "supply_flow": meter_in,
            "return_flow": sum(port.edges.tank for port in ports) + sum(relieved),
            "stored_energy": compression,
            "dissipated_power": heat,
            "convected_power": (head * densities[0] - rod * densities[1]) * self.u.velocity,
            drive.LOAD: load_sensing.load_pressure(
                *(self.u.command, self.u.command_rate),
                *(self.section.dead_bands(), self.section.valve.full_command),
                *(lines, rates.pair("valve_pressure")),
                self.u,
            ),
            **{f"{name}_flow": s.flow for name, s in zip(SIDES, self.sides, strict=True)},
            **{f"{name}_valve_flow": s.port.edges.line for name, s in zip(SIDES, self.sides, strict=True)},
        }


def section(p: Parameters, axis: str) -> Section:
    """Parameters of the section of a drive."""
    return Section(
        SectionValve.of(p, "valve"),
        Compensator.of(p, "compensator"),
        getattr(p, f"{axis}_section_flow"),
        (getattr(p, f"{axis}_head_return_area"), getattr(p, f"{axis}_rod_return_area")),
        p.neutral_area,
        p.density,
    )


def _drives(x: State, u: BoomStickInputs, p: Parameters) -> Iterator[CompensatedDrive]:
    """Boom and stick drive from the variables of the subsystem."""
    counterbalance = Counterbalance.of(p, "counterbalance")
    relief, anti = PressureValve.of(p, "port_relief"), PressureValve.of(p, "anti_cavitation")
    for axis, inputs in zip(AXES, drive.inputs(u), strict=True):
        state, line, own = AxisState.of(x, axis), VolumeHose.of(p, f"{axis}_hose"), section(p, axis)
        tank = inputs.tank_pressure
        around = Restriction(
            own.valve.discharge_coefficient, p.density, line.resistance, own.valve.transition_flow
        )
        ports = compensator.section_ports(
            *(own, inputs.command, state.pair("valve_pressure")),
            *(inputs.supply_pressure, u.load_sensing_pressure, tank),
        )
        head, rod = (
            Side(
                *(pressure, valve_pressure, opening),
                getattr(p, f"{axis}_{name}_pilot_ratio"),
                port,
                flow=counterbalance_valve.flow(counterbalance, opening, valve_pressure, pressure, around),
                relief=orifice.relief_flow(relief, valve_pressure - tank),
                anti_cavitation=orifice.relief_flow(anti, tank - valve_pressure),
            )
            for name, port, pressure, valve_pressure, opening in zip(
                *(SIDES, ports, state.pair("pressure"), state.pair("valve_pressure")),
                state.pair("counterbalance_opening"),
                strict=True,
            )
        )
        yield CompensatedDrive(
            *(Cylinder.of(p, axis), line, own, counterbalance),
            *(AeratedOil.of(p), state, inputs),
            (head, rod),
        )


def initial(x: State, u: BoomStickInputs, p: Parameters) -> dict[str, Scalar]:
    """Initial state: chambers in balance with the holding forces, hoses drained by the neutral position."""
    state = drive.holding_pressures(u, p)
    for prefix in (f"{axis}_{side}" for axis in AXES for side in SIDES):
        state |= {f"{prefix}_valve_pressure": u.tank_pressure, f"{prefix}_counterbalance_opening": 0.0}
    return state


def require(x: State, u: BoomStickInputs, p: Parameters) -> dict[str, Scalar]:
    """Requirements of cylinders, valves, compensators and counterbalance valves."""
    return {
        **compensator.requirements(SectionValve.of(p, "valve"), Compensator.of(p, "compensator")),
        **drive.require_cylinders(u, p),
    }


BOOM_STICK = drive.variant(
    _drives,
    VolumeHose,
    text="Hydraulic drives of boom and stick with compensated sections and counterbalance valves",
    parameters=Parameters,
    states=State,
    outputs=Outputs,
    initial=initial,
    require=require,
    validity="motions slow compared with compensators and the oil in the hoses, below about 10 Hz;"
    " no spool dynamics",
)
