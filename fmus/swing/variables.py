"""Variables of the swing drive: parameters, states, inputs, outputs; signs as in model.py."""

from __future__ import annotations

from fmus.components import chamber
from fmus.components.spool_valve import ValveParameters
from fmus.contract import Group, Quantity, Scalar


class LineParameters(Group):
    """What every variant knows of the lines."""

    initial_preload: Scalar = Quantity(
        "Pa", "Pressure of both swing lines at the start", 1e6, minimum=1e3, group="Start"
    )
    line_turbulent_resistance: Scalar = Quantity(
        "Pa.s2/m6", "Turbulent resistance C_R of each swing line", 1e10, minimum=0.0, group="Swing lines"
    )


class VolumeParameters(Group):
    """The lines as volumes."""

    line_capacitance: Scalar = Quantity(
        "m3/Pa", "Capacitance C of each line with its motor side", 1e-12, minimum=1e-18, group="Swing lines"
    )


class MotorParameters(Group):
    """The motor and its gear."""

    motor_displacement: Scalar = Quantity(
        "m3/rad", "Displacement D_m of the swing motor", 1e-5, minimum=1e-9, group="Swing motor and gear"
    )
    gear_ratio: Scalar = Quantity("1", "Gear ratio N: motor speed over swing speed", 10.0, minimum=0.1)
    internal_leakage_resistance: Scalar = Quantity(
        "Pa.s/m3", "Cross-port leakage resistance R_in of the swing motor", 1e12, minimum=1e6
    )
    external_leakage_resistance: Scalar = Quantity(
        "Pa.s/m3", "Case leakage resistance R_ex of each port of the swing motor", 1e12, minimum=1e6
    )


class QuasistaticParameters(MotorParameters, VolumeParameters, LineParameters, ValveParameters):
    """Constants of the quasistatic drive; their numbers and sources are in parameters.toml."""


class SwingParameters(QuasistaticParameters):
    """Constants of the lumped drive; their numbers and sources are in parameters.toml."""

    line_inertance: Scalar = Quantity(
        "kg/m4", "Inertance I of each swing line", 1e6, minimum=1.0, group="Swing lines"
    )
    line_resistance: Scalar = Quantity(
        "Pa.s/m3", "Laminar resistance R_1 = R_2 of each swing line", 1e6, minimum=1.0
    )


class SwingState(Group):
    """State of the lumped drive: pressures and flows of both lines, which every variant shows."""

    swing_pressure_a: Scalar = chamber.pressure("Pressure of swing line A")
    swing_pressure_b: Scalar = chamber.pressure("Pressure of swing line B")
    swing_flow_a: Scalar = Quantity("m3/s", "Flow into swing line A", 1e-3)
    swing_flow_b: Scalar = Quantity("m3/s", "Flow into swing line B", 1e-3)


class SwingInputs(Group):
    """Command, supply and the motion of the column; the rate inputs carry exact time derivatives."""

    swing_command: Scalar = Quantity(
        "V",
        "Command to the swing valve, positive turns left",
        10.0,
        rate="swing_command_rate",
        warn_above=10.0,
    )
    swing_command_rate: Scalar = Quantity(
        "V/s", "Rate port: time derivative of swing_command, may stay unconnected", 10.0
    )
    supply_pressure: Scalar = Quantity("Pa", "Pressure of the supply line", 1e7, rate="supply_pressure_rate")
    supply_pressure_rate: Scalar = Quantity(
        "Pa/s", "Rate port: time derivative of supply_pressure, may stay unconnected", 1e8
    )
    tank_pressure: Scalar = Quantity("Pa", "Pressure of the return line", 1e5)
    swing_speed: Scalar = Quantity("rad/s", "Swing speed", 1.0, rate="swing_acceleration")
    swing_acceleration: Scalar = Quantity(
        "rad/s2", "Rate port: time derivative of swing_speed, may stay unconnected"
    )


class SwingOutputs(SwingState):
    """The state; torque and its rate for the mechanics; flows for the supply; and what a user looks at."""

    swing_torque: Scalar = Quantity("N.m", "Hydraulic torque on the swing column", 1e4)
    swing_torque_rate: Scalar = Quantity("N.m/s", "Rate port: exact time derivative of swing_torque", 1e5)
    supply_flow: Scalar = Quantity("m3/s", "Flow taken from the supply line", 1e-3)
    return_flow: Scalar = Quantity("m3/s", "Flow given to the return line, with the case drain", 1e-3)
    swing_motor_pressure_a: Scalar = Quantity("Pa", "Pressure P_1 at motor port A", 1e7)
    swing_motor_pressure_b: Scalar = Quantity("Pa", "Pressure P_2 at motor port B", 1e7)
    swing_drain_flow: Scalar = Quantity("m3/s", "External leakage of the motor to the drain", 1e-5)
    swing_void_volume: Scalar = Quantity(
        "m3", "Void in the swing lines: above 1e-7 the oil has torn", 1e-6, warn_above=1e-7
    )
    stored_energy: Scalar = Quantity("J", "Energy of compression and of the moving oil columns", 1e3)
    dissipated_power: Scalar = Quantity("W", "Heat of metering edges, lines and leakage", 1e4)
