"""Variables of the boom and stick drives: parameters, states, inputs, outputs; signs as in model.py."""

from __future__ import annotations

from fmus.components import chamber
from fmus.components.spool_valve import ValveParameters
from fmus.contract import Group, Quantity, Scalar


class CylinderParameters(Group):
    """What every variant knows of oil, cylinders and hoses."""

    bulk_modulus: Scalar = Quantity("Pa", "Bulk modulus of the oil", 1e9, minimum=1e7, group="Oil")
    initial_preload: Scalar = Quantity(
        "Pa", "Pressure of the unloaded side of a cylinder at the start", 1e6, minimum=1e3, group="Start"
    )
    boom_bore: Scalar = Quantity("m", "Bore of the boom cylinder", 0.1, minimum=1e-3, group="Boom cylinder")
    boom_rod: Scalar = Quantity("m", "Rod diameter of the boom cylinder", 0.1, minimum=0.0)
    boom_stroke: Scalar = Quantity("m", "Stroke of the boom cylinder", minimum=1e-3)
    boom_dead_volume: Scalar = Quantity(
        "m3", "Dead volume of each chamber of the boom cylinder", 1e-4, minimum=1e-9
    )
    boom_hose_resistance: Scalar = Quantity(
        "Pa.s2/m6", "Turbulent resistance C_R of each boom hose", 1e10, minimum=0.0, group="Boom hoses"
    )
    stick_bore: Scalar = Quantity(
        "m", "Bore of the stick cylinder", 0.1, minimum=1e-3, group="Stick cylinder"
    )
    stick_rod: Scalar = Quantity("m", "Rod diameter of the stick cylinder", 0.1, minimum=0.0)
    stick_stroke: Scalar = Quantity("m", "Stroke of the stick cylinder", minimum=1e-3)
    stick_dead_volume: Scalar = Quantity(
        "m3", "Dead volume of each chamber of the stick cylinder", 1e-4, minimum=1e-9
    )
    stick_hose_resistance: Scalar = Quantity(
        "Pa.s2/m6", "Turbulent resistance C_R of each stick hose", 1e10, minimum=0.0, group="Stick hoses"
    )


class VolumeParameters(Group):
    """The hoses as volumes."""

    boom_hose_capacitance: Scalar = Quantity(
        "m3/Pa", "Capacitance of each boom hose", 1e-12, minimum=0.0, group="Boom hoses"
    )
    stick_hose_capacitance: Scalar = Quantity(
        "m3/Pa", "Capacitance of each stick hose", 1e-12, minimum=0.0, group="Stick hoses"
    )


class QuasistaticParameters(VolumeParameters, CylinderParameters, ValveParameters):
    """Constants of the quasistatic drives; their numbers and sources are in parameters.toml."""


class BoomStickParameters(QuasistaticParameters):
    """Constants of the lumped drives; their numbers and sources are in parameters.toml."""

    boom_hose_inertance: Scalar = Quantity(
        "kg/m4", "Inertance of each boom hose", 1e7, minimum=1.0, group="Boom hoses"
    )
    stick_hose_inertance: Scalar = Quantity(
        "kg/m4", "Inertance of each stick hose", 1e7, minimum=1.0, group="Stick hoses"
    )


class BoomStickState(Group):
    """State of the lumped drives: pressures and line flows, which every variant shows."""

    boom_head_pressure: Scalar = chamber.pressure("Pressure at the head side of the boom cylinder")
    boom_rod_pressure: Scalar = chamber.pressure("Pressure at the rod side of the boom cylinder")
    boom_head_flow: Scalar = Quantity("m3/s", "Flow into the head side of the boom cylinder", 1e-3)
    boom_rod_flow: Scalar = Quantity("m3/s", "Flow into the rod side of the boom cylinder", 1e-3)
    stick_head_pressure: Scalar = chamber.pressure("Pressure at the head side of the stick cylinder")
    stick_rod_pressure: Scalar = chamber.pressure("Pressure at the rod side of the stick cylinder")
    stick_head_flow: Scalar = Quantity("m3/s", "Flow into the head side of the stick cylinder", 1e-3)
    stick_rod_flow: Scalar = Quantity("m3/s", "Flow into the rod side of the stick cylinder", 1e-3)


class BoomStickInputs(Group):
    """Commands, supply, and the motion of the pistons; the rate inputs carry exact time derivatives."""

    boom_command: Scalar = Quantity(
        "V",
        "Command to the boom valve, positive raises the boom",
        10.0,
        rate="boom_command_rate",
        warn_above=10.0,
    )
    boom_command_rate: Scalar = Quantity(
        "V/s", "Rate port: time derivative of boom_command, may stay unconnected", 10.0
    )
    stick_command: Scalar = Quantity(
        "V",
        "Command to the stick valve, positive folds the stick in",
        10.0,
        rate="stick_command_rate",
        warn_above=10.0,
    )
    stick_command_rate: Scalar = Quantity(
        "V/s", "Rate port: time derivative of stick_command, may stay unconnected", 10.0
    )
    supply_pressure: Scalar = Quantity("Pa", "Pressure of the supply line", 1e7, rate="supply_pressure_rate")
    supply_pressure_rate: Scalar = Quantity(
        "Pa/s", "Rate port: time derivative of supply_pressure, may stay unconnected", 1e8
    )
    tank_pressure: Scalar = Quantity("Pa", "Pressure of the return line", 1e5)
    boom_position: Scalar = Quantity(
        "m", "Piston position of the boom cylinder from its closed end", rate="boom_velocity"
    )
    boom_velocity: Scalar = Quantity(
        "m/s", "Piston velocity of the boom cylinder", 0.1, rate="boom_acceleration"
    )
    boom_acceleration: Scalar = Quantity(
        "m/s2", "Rate port: time derivative of boom_velocity, may stay unconnected"
    )
    stick_position: Scalar = Quantity(
        "m", "Piston position of the stick cylinder from its closed end", rate="stick_velocity"
    )
    stick_velocity: Scalar = Quantity(
        "m/s", "Piston velocity of the stick cylinder", 0.1, rate="stick_acceleration"
    )
    stick_acceleration: Scalar = Quantity(
        "m/s2", "Rate port: time derivative of stick_velocity, may stay unconnected"
    )
    boom_holding_force: Scalar = Quantity(
        "N", "Force that holds the boom at the start; used only to initialise", 1e5
    )
    stick_holding_force: Scalar = Quantity(
        "N", "Force that holds the stick at the start; used only to initialise", 1e5
    )


class BoomStickOutputs(BoomStickState):
    """The state; forces and their rates for the mechanics; flows for the supply; and what a user looks at."""

    boom_force: Scalar = Quantity("N", "Hydraulic force of the boom cylinder", 1e5)
    stick_force: Scalar = Quantity("N", "Hydraulic force of the stick cylinder", 1e5)
    boom_force_rate: Scalar = Quantity("N/s", "Rate port: exact time derivative of boom_force", 1e6)
    stick_force_rate: Scalar = Quantity("N/s", "Rate port: exact time derivative of stick_force", 1e6)
    supply_flow: Scalar = Quantity("m3/s", "Flow taken from the supply line", 1e-3)
    return_flow: Scalar = Quantity("m3/s", "Flow given to the return line", 1e-3)
    boom_void_volume: Scalar = Quantity(
        "m3", "Void in the boom cylinder: above 1e-7 the oil has torn", 1e-6, warn_above=1e-7
    )
    stick_void_volume: Scalar = Quantity(
        "m3", "Void in the stick cylinder: above 1e-7 the oil has torn", 1e-6, warn_above=1e-7
    )
    stored_energy: Scalar = Quantity("J", "Energy of compression and of the moving oil columns", 1e3)
    dissipated_power: Scalar = Quantity("W", "Heat of metering edges and hoses", 1e4)
    convected_power: Scalar = Quantity(
        "W", "Compression energy that oil brings along into volumes that grow, less what leaves others", 1e3
    )
