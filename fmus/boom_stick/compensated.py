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

from functools import partial

from fmus.boom_stick import drive
from fmus.boom_stick.drive import PORTS, Drive
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
from fmus.components import chamber, counterbalance_valve, load_sensing, spool_valve
from fmus.components import pressure_compensator as compensator
from fmus.components.chamber import AeratedOil, Air
from fmus.components.circuit import Branch, Circuit, Kind
from fmus.components.counterbalance_valve import Counterbalance, Restriction
from fmus.components.cylinder import Cylinder
from fmus.components.hose import HoseWall, ReferenceHose, VolumeHose
from fmus.components.orifice import AntiCavitationParameters, PressureValve
from fmus.components.pressure_compensator import Compensator, Section, SectionValve
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
    """State of one drive."""


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


def _drive(axis: str, x: State, u: AxisInputs, p: Parameters) -> Drive:
    state, size, hose = AxisState.of(x, axis), Cylinder.of(p, axis), VolumeHose.of(p, f"{axis}_hose")
    own, c, air = section(p, axis), Counterbalance.of(p, "counterbalance"), Air.of(p)
    ports = compensator.section_ports(
        *(own, u.command, (state.head_valve_pressure, state.rod_valve_pressure)),
        *(u.supply_pressure, u.load_sensing_pressure, u.tank_pressure),
    )
    edges = (ports[0].edges, ports[1].edges)
    around = Restriction(
        own.valve.discharge_coefficient, p.density, hose.resistance, own.valve.transition_flow
    )
    head = partial(counterbalance_valve.flow, c, state.head_counterbalance_opening, around)
    rod = partial(counterbalance_valve.flow, c, state.rod_counterbalance_opening, around)
    circuit = drive.cylinder_circuit(size, u, state, AeratedOil.of(p)) | Circuit(
        {
            "head_valve_pressure": hose.node(state.head_valve_pressure, air),
            "rod_valve_pressure": hose.node(state.rod_valve_pressure, air),
        },
        {
            **spool_valve.branches(edges, *PORTS),
            **drive.reliefs(p, "port_relief", PORTS),
            "head_flow": Branch("head_valve_pressure", "head_pressure", Kind.COUNTERBALANCE, head),
            "rod_flow": Branch("rod_valve_pressure", "rod_pressure", Kind.COUNTERBALANCE, rod),
        },
    )
    meter_in, metering_drop, compensator_drop = compensator.shown(own, ports, u.command)
    shown = {
        **vars(state),
        "meter_in_flow": meter_in,
        "metering_drop": metering_drop,
        "compensator_drop": compensator_drop,
        "head_valve_flow": edges[0].line,
        "rod_valve_flow": edges[1].line,
    }
    load = load_sensing.sensed(p, u.command, u.command_rate)
    return Drive(size, u, circuit, load, _opening_rates(axis, state, u, p), shown, at=PORTS)


def _opening_rates(axis: str, x: AxisState, u: AxisInputs, p: Parameters) -> dict[str, Scalar]:
    """Rates of the openings of the counterbalance valves, each piloted by the other side."""
    c, rates = Counterbalance.of(p, "counterbalance"), {}
    for side, pilot in (("head", "rod"), ("rod", "head")):
        name = f"{side}_counterbalance_opening"
        balance = counterbalance_valve.balance(
            *(c, getattr(p, f"{axis}_{side}_pilot_ratio"), getattr(x, f"{side}_pressure")),
            *(getattr(x, f"{pilot}_valve_pressure"), getattr(x, f"{side}_valve_pressure"), u.tank_pressure),
        )
        rates[name] = (balance - getattr(x, name)) / c.lag
    return rates


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
    _drive,
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
