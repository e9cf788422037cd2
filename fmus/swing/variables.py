"""Variables of the swing drive: parameters, states, inputs, outputs.

Signs: flows are positive towards the motor; angle, speed and torque are positive counter-clockwise
seen from above; a positive command turns in the positive direction.
"""

from fmus import ports
from fmus.components import chamber, spool_valve
from fmus.components.chamber import Fluid, Oil
from fmus.components.hose import HoseSize, HoseWall
from fmus.components.oil import OilTemperature
from fmus.components.orifice import ReliefParameters
from fmus.components.spool_valve import CurvedEdges, CurvedValve, Spool
from fmus.contract import Group, Quantity, Scalar
from fmus.ports import LineInputs

SIDES = ("a", "b")


class DriveParameters(OilTemperature, line=(HoseSize, "swing line")):
    """Parameters of lines, motor and gear in every variant."""

    line_turbulent_resistance: Scalar = Quantity(
        "Pa.s2/m6", "Turbulent resistance C_R of each swing line; 0: laminar", 1e10, minimum=0.0
    )
    initial_preload: Scalar = Quantity(
        "Pa", "Initial pressure of both swing lines", 1e6, minimum=1e3, group="Start"
    )
    motor_displacement: Scalar = Quantity(
        "m3/rad", "Displacement D_m of the swing motor", 1e-5, minimum=1e-9, group="Swing motor and gear"
    )
    gear_ratio: Scalar = Quantity("1", "Gear ratio N: motor speed over swing speed", 10.0, minimum=0.1)
    motor_volume: Scalar = Quantity("m3", "Volume of each motor side, without the line", 1e-3, minimum=1e-9)
    internal_leakage_resistance: Scalar = Quantity(
        "Pa.s/m3", "Cross-port leakage resistance R_in of the swing motor", 1e12, minimum=1e6
    )
    external_leakage_resistance: Scalar = Quantity(
        "Pa.s/m3", "Case leakage resistance R_ex of each port of the swing motor", 1e12, minimum=1e6
    )


class QuasistaticSwingParameters(DriveParameters, Oil, valve=CurvedValve):
    """Parameters of the quasistatic drive; values and sources are in parameters.toml."""

    line_capacitance: Scalar = Quantity(
        "m3/Pa",
        "Capacitance C of each line with its motor side; 0: derived from both volumes and bulk modulus",
        1e-12,
        minimum=0.0,
        group="Swing lines",
    )


class SwingParameters(QuasistaticSwingParameters):
    """Parameters of the lumped drive; values and sources are in parameters.toml."""

    line_inertance: Scalar = Quantity(
        "kg/m4",
        "Inertance I of each swing line; 0: derived from length, bore and density",
        1e6,
        minimum=0.0,
        group="Swing lines",
    )
    line_resistance: Scalar = Quantity(
        "Pa.s/m3",
        "Laminar resistance R_1 = R_2 of each swing line; 0: derived from length, bore and viscosity",
        1e6,
        minimum=0.0,
    )
    viscosity: Scalar = Quantity("Pa.s", "Dynamic viscosity of the oil", 1e-2, minimum=1e-7, group="Oil")


class DetailedSwingParameters(
    DriveParameters, ReliefParameters, HoseWall, Fluid, valve=CurvedEdges, spool=Spool
):
    """Parameters of the detailed drive; values and sources are in parameters.toml."""


class LinePressures(Group):
    """Pressures of both lines: the state of the quasistatic drive."""

    swing_pressure_a: Scalar = chamber.pressure("Pressure of swing line A")
    swing_pressure_b: Scalar = chamber.pressure("Pressure of swing line B")


class SwingState(LinePressures):
    """State of the lumped drive: pressures and flows of both lines, which are outputs of every variant."""

    swing_flow_a: Scalar = Quantity("m3/s", "Flow into swing line A", 1e-3)
    swing_flow_b: Scalar = Quantity("m3/s", "Flow into swing line B", 1e-3)


class _CommandInputs(Group):
    """Command; the rate input is its exact time derivative."""

    swing_command: Scalar = ports.command("swing", "turns left", "swing_command_rate")
    swing_command_rate: Scalar = ports.rate_input("swing_command", "V/s", 10.0)


class SwingInputs(LineInputs, _CommandInputs):
    """Command, supply and motion of the column; the rate inputs are exact time derivatives."""

    swing_speed: Scalar = Quantity(
        "rad/s", "Swing speed, counter-clockwise from above", 1.0, rate="swing_acceleration"
    )
    swing_acceleration: Scalar = ports.rate_input("swing_speed", "rad/s2")


class SwingOutputs(SwingState):
    """States, torque and its rate (to the mechanics), flows (to the supply), and monitoring outputs."""

    swing_torque: Scalar = Quantity("N.m", "Hydraulic torque on the swing column", 1e4)
    swing_torque_rate: Scalar = ports.rate_output("swing_torque", "N.m/s", 1e5)
    supply_flow: Scalar = Quantity("m3/s", "Flow from the supply line", 1e-3)
    return_flow: Scalar = Quantity("m3/s", "Flow into the return line, with the case drain", 1e-3)
    swing_load_pressure: Scalar = Quantity("Pa", "Load pressure of the swing, to the load-sensing line", 1e7)
    swing_load_pressure_rate: Scalar = ports.rate_output("swing_load_pressure", "Pa/s", 1e8)
    swing_motor_pressure_a: Scalar = chamber.port_pressure("Pressure P_1 at motor port A")
    swing_motor_pressure_b: Scalar = chamber.port_pressure("Pressure P_2 at motor port B")
    swing_drain_flow: Scalar = Quantity("m3/s", "Case drain flow of the motor: external leakage", 1e-5)
    swing_void_volume: Scalar = chamber.cavity("the swing lines")
    stored_energy: Scalar = Quantity("J", "Energy of oil compression and of the moving oil columns", 1e3)
    dissipated_power: Scalar = Quantity("W", "Power dissipated by metering edges, lines and leakage", 1e4)


class DetailedSwingOutputs(SwingOutputs):
    """Outputs of every variant, and signals of spool, both ends of the lines and relief valves."""

    swing_spool_position: Scalar = spool_valve.position("Spool position of the swing valve")
    swing_motor_flow_a: Scalar = Quantity("m3/s", "Flow from swing line A to the motor", 1e-3)
    swing_motor_flow_b: Scalar = Quantity("m3/s", "Flow from swing line B to the motor", 1e-3)
    swing_valve_pressure_a: Scalar = chamber.port_pressure("Pressure at port A of the swing valve")
    swing_valve_pressure_b: Scalar = chamber.port_pressure("Pressure at port B of the swing valve")
    swing_relief_flow: Scalar = Quantity(
        "m3/s", "Flow of the cross-port relief valves from line A to line B", 1e-3
    )
    swing_anti_cavitation_flow: Scalar = Quantity(
        "m3/s", "Flow of both anti-cavitation valves of the swing motor", 1e-3
    )
    swing_bulk_modulus_a: Scalar = Quantity("Pa", "Effective bulk modulus of the oil at motor port A", 1e9)
    swing_bulk_modulus_b: Scalar = Quantity("Pa", "Effective bulk modulus of the oil at motor port B", 1e9)
