"""Swing drive of a load-sensing machine: compensated section, crossover reliefs with make-up, holding brake.

    C dP_a/dt = Q_a - D w - (P_a - P_b)/R_in - (P_a - P_t)/R_ex - Q_cross + Q_anti,a
    C dP_b/dt = Q_b + D w + (P_a - P_b)/R_in - (P_b - P_t)/R_ex + Q_cross + Q_anti,b
    torque    = D (P_a - P_b) - T             D = D_m N                   eqs. (8), (11), (12)

with the flows Q_a, Q_b of the ports of `pressure_compensator`, the crossover reliefs and anti-cavitation
valves (make-up from the return line) of `orifice`, which are mounted at the motor, and the torque T of the
brake of `motor`. A closed valve blocks the ports, which have no counterbalance valves. The brake is released
as soon as the command leaves the dead band and the supply has pressure. Lines as in `quasistatic`: volumes,
no oil columns. C has elastic walls and the air of `chamber`. The torque depends only on states.
"""

from fmus.components import circuit, hose, motor, spool_valve
from fmus.components import pressure_compensator as compensator
from fmus.components.chamber import AeratedOil, Air
from fmus.components.circuit import Circuit, Node
from fmus.components.hose import HoseWall
from fmus.components.load_sensing import sensed
from fmus.components.motor import Brake
from fmus.components.orifice import ReliefParameters
from fmus.components.pressure_compensator import Compensator, Section, SectionValve
from fmus.contract import Group, Quantity, Scalar, quantities
from fmus.swing import drive
from fmus.swing.drive import LINES, Drive
from fmus.swing.variables import (
    DriveParameters,
    LinePressures,
    QuasistaticSwingParameters,
    SwingInputs,
    SwingOutputs,
)


class Parameters(
    DriveParameters,
    ReliefParameters,
    HoseWall,
    AeratedOil,
    valve=SectionValve,
    compensator=Compensator,
    brake=(Brake, "swing"),
):
    """Parameters of the compensated drive; values and sources are in parameters.toml."""

    line_capacitance: Scalar = quantities(QuasistaticSwingParameters)["line_capacitance"]
    swing_section_flow: Scalar = Quantity(
        "m3/s", "Flow of the swing section at full command", 1e-3, minimum=1e-6, group="Swing section"
    )
    swing_return_area: Scalar = Quantity(
        "m2", "Area of each meter-out edge of the swing at full command", 1e-4, minimum=1e-9
    )


class BrakeState(Group):
    """State of the brake."""

    swing_brake_torque: Scalar = Quantity("N.m", "Torque of the swing brake, against the motion", 1e4)
    swing_brake_applied: Scalar = Quantity("1", "Part of its torque that the swing brake can hold")


class State(LinePressures, BrakeState):
    """State of the compensated drive: pressures at the motor, brake."""


class Outputs(BrakeState, SwingOutputs):
    """Outputs of every variant, and signals of section, relief valves and brake."""

    swing_meter_in_flow: Scalar = Quantity("m3/s", "Flow of the swing section from the supply line", 1e-3)
    swing_metering_drop: Scalar = Quantity("Pa", "Drop over the open meter-in edge of the swing section", 1e6)
    swing_compensator_drop: Scalar = Quantity("Pa", "Drop over the compensator of the swing section", 1e7)
    swing_relief_flow: Scalar = Quantity(
        "m3/s", "Flow of the crossover relief valves from line A to line B", 1e-3
    )
    swing_anti_cavitation_flow: Scalar = Quantity(
        "m3/s", "Flow of both anti-cavitation valves of the swing motor", 1e-3
    )


def section(p: Parameters) -> Section:
    """Parameters of the section."""
    return Section(
        SectionValve.of(p, "valve"),
        Compensator.of(p, "compensator"),
        p.swing_section_flow,
        (p.swing_return_area, p.swing_return_area),
        neutral_area=0.0,
        density=p.density,
        resistance=p.line_turbulent_resistance,
    )


def _release(u: SwingInputs, p: Parameters) -> Scalar:
    """f of the brake."""
    in_use = 1 - section(p).neutral(u.swing_command)
    return Brake.of(p, "brake").released(in_use, u.supply_pressure - u.tank_pressure)


def _drive(x: State, u: SwingInputs, p: Parameters) -> Drive:
    own, pressures = section(p), (x.swing_pressure_a, x.swing_pressure_b)
    ports = compensator.section_ports(
        *(own, u.swing_command, pressures, u.supply_pressure, u.load_sensing_pressure, u.tank_pressure)
    )
    edges = (ports[0].edges, ports[1].edges)
    oil = (p.line_capacitance, hose.area(p.line_bore) * p.line_length + p.motor_volume, Air.of(p))
    whole = Circuit(
        {
            **circuit.lines(u),
            "swing_pressure_a": Node(x.swing_pressure_a, "C_1", *oil),
            "swing_pressure_b": Node(x.swing_pressure_b, "C_2", *oil),
        },
        {
            **spool_valve.branches(edges, *LINES),
            **motor.branches(LINES, *drive.motor(u, p)),
            **drive.reliefs(p),
        },
    )
    meter_in, metering_drop, compensator_drop = compensator.shown(own, ports, u.swing_command)
    brake = Brake.of(p, "brake")
    held = brake.hold(x.swing_brake_torque, x.swing_brake_applied, u.swing_speed)
    rates = {
        "swing_brake_torque": held.rate,
        "swing_brake_applied": brake.applied_rate(x.swing_brake_applied, _release(u, p)),
    }
    shown = {
        "swing_flow_a": edges[0].line,
        "swing_flow_b": edges[1].line,
        "swing_brake_torque": x.swing_brake_torque,
        "swing_brake_applied": x.swing_brake_applied,
        "swing_meter_in_flow": meter_in,
        "swing_metering_drop": metering_drop,
        "swing_compensator_drop": compensator_drop,
    }
    load = sensed(p, u.swing_command, u.swing_command_rate)
    return Drive(whole, load, rates, shown, brake=(x.swing_brake_torque, held))


def initial(x: State, u: SwingInputs, p: Parameters) -> dict[str, Scalar]:
    """Initial state: both lines at the preload, the brake as the command has it, without torque."""
    brake = {"swing_brake_torque": 0.0, "swing_brake_applied": 1 - _release(u, p)}
    return drive.initial_pressures(x, u, p) | brake


def require(x: State, u: SwingInputs, p: Parameters) -> dict[str, Scalar]:
    """Requirements of valve and compensator."""
    return compensator.requirements(SectionValve.of(p, "valve"), Compensator.of(p, "compensator"))


SWING = drive.variant(
    _drive,
    State,
    Outputs,
    text="Hydraulic swing drive with a compensated section, crossover reliefs and holding brake",
    parameters=Parameters,
    initial=initial,
    require=require,
    derive=drive.derive_capacitance,
    validity="motions slow compared with compensator and oil in the lines, below about 10 Hz;"
    " no spool dynamics",
)
