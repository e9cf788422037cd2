"""Variables of the boom and stick drives: one drive, declared once, and both of them.

Signs: flows are positive into the cylinder; positions are measured from the closed end; velocities and forces
are positive when they extend the rod; a positive command extends.
"""

from __future__ import annotations

from fmus.components import chamber
from fmus.components.chamber import Fluid, Oil
from fmus.components.cylinder import Cylinder
from fmus.components.hose import Hose, HoseWall, LumpedHose, ReferenceHose, VolumeHose
from fmus.components.orifice import ReliefParameters
from fmus.components.spool_valve import Edges, Spool, Valve
from fmus.contract import Group, Quantity, Scalar

AXES = ("boom", "stick")
SIDES = ("head", "rod")


class Preload(Group):
    """How the drives start."""

    initial_preload: Scalar = Quantity(
        "Pa", "Pressure of the unloaded side of a cylinder at the start", 1e6, minimum=1e3, group="Start"
    )


class QuasistaticDriveParameters(Cylinder, hose=(VolumeHose, "{} hose")):
    """Cylinder and hoses of one drive without line dynamics."""


class LumpedDriveParameters(Cylinder, hose=(LumpedHose, "{} hose")):
    """Cylinder and hoses of one drive, each hose one lump."""


class DetailedDriveParameters(Cylinder, hose=(Hose, "{} hose")):
    """Cylinder and hoses of one drive, each hose a line."""


class QuasistaticBoomStickParameters(
    Oil,
    Preload,
    ReferenceHose,
    valve=Valve,
    boom=QuasistaticDriveParameters,
    stick=QuasistaticDriveParameters,
):
    """Constants of the quasistatic drives; their numbers and sources are in parameters.toml."""


class BoomStickParameters(
    Oil, Preload, ReferenceHose, valve=Valve, boom=LumpedDriveParameters, stick=LumpedDriveParameters
):
    """Constants of the lumped drives; their numbers and sources are in parameters.toml."""


class Pressures(Group):
    """Pressures of a cylinder."""

    head_pressure: Scalar = chamber.pressure("Pressure at the head side of the {} cylinder")
    rod_pressure: Scalar = chamber.pressure("Pressure at the rod side of the {} cylinder")


class OilState(Pressures):
    """Pressures and line flows of a drive."""

    head_flow: Scalar = Quantity("m3/s", "Flow into the head side of the {} cylinder", 1e-3)
    rod_flow: Scalar = Quantity("m3/s", "Flow into the rod side of the {} cylinder", 1e-3)


class QuasistaticBoomStickState(Group, boom=Pressures, stick=Pressures):
    """State of the quasistatic drives: pressures."""


class BoomStickState(Group, boom=OilState, stick=OilState):
    """State of the lumped drives: pressures and line flows, which every variant shows."""


class DriveInputs(Group):
    """Command and motion of the piston of one drive; the rate inputs carry exact time derivatives."""

    command: Scalar = Quantity(
        "V", "Command to the {} valve, positive extends the rod", 10.0, rate="command_rate", warn_above=10.0
    )
    command_rate: Scalar = Quantity(
        "V/s", "Rate port: time derivative of {}_command, may stay unconnected", 10.0
    )
    position: Scalar = Quantity(
        "m", "Piston position of the {} cylinder from its closed end", rate="velocity"
    )
    velocity: Scalar = Quantity("m/s", "Piston velocity of the {} cylinder", 0.1, rate="acceleration")
    acceleration: Scalar = Quantity("m/s2", "Rate port: time derivative of {}_velocity, may stay unconnected")
    holding_force: Scalar = Quantity(
        "N", "Force that holds the {} at the start; used only to initialise", 1e5
    )


class BoomStickInputs(Group, boom=DriveInputs, stick=DriveInputs):
    """Commands, motion of the pistons, and supply."""

    supply_pressure: Scalar = Quantity("Pa", "Pressure of the supply line", 1e7, rate="supply_pressure_rate")
    supply_pressure_rate: Scalar = Quantity(
        "Pa/s", "Rate port: time derivative of supply_pressure, may stay unconnected", 1e8
    )
    tank_pressure: Scalar = Quantity("Pa", "Pressure of the return line", 1e5)
    boom_command: Scalar = Quantity(
        "V",
        "Command to the boom valve, positive raises the boom",
        10.0,
        rate="boom_command_rate",
        warn_above=10.0,
    )
    stick_command: Scalar = Quantity(
        *("V", "Command to the stick valve, positive folds the stick in", 10.0),
        rate="stick_command_rate",
        warn_above=10.0,
    )


class DriveOutputs(Group):
    """Force and its rate for the mechanics, and what a user looks at."""

    force: Scalar = Quantity("N", "Hydraulic force of the {} cylinder", 1e5)
    force_rate: Scalar = Quantity("N/s", "Rate port: exact time derivative of {}_force", 1e6)
    void_volume: Scalar = chamber.cavity("the {} cylinder")


class BoomStickOutputs(BoomStickState, boom=DriveOutputs, stick=DriveOutputs):
    """The state; forces for the mechanics; flows for the supply; and what both drives have in common."""

    supply_flow: Scalar = Quantity("m3/s", "Flow taken from the supply line", 1e-3)
    return_flow: Scalar = Quantity("m3/s", "Flow given to the return line", 1e-3)
    stored_energy: Scalar = Quantity("J", "Energy of compression and of the moving oil columns", 1e3)
    dissipated_power: Scalar = Quantity("W", "Heat of metering edges and hoses", 1e4)
    convected_power: Scalar = Quantity(
        "W", "Compression energy that oil brings along into volumes that grow, less what leaves others", 1e3
    )


class DetailedBoomStickParameters(
    Fluid,
    Preload,
    ReferenceHose,
    HoseWall,
    ReliefParameters,
    valve=Edges,
    spool=Spool,
    boom=DetailedDriveParameters,
    stick=DetailedDriveParameters,
):
    """Constants of the detailed drives; their numbers and sources are in parameters.toml."""


class DetailedAxisOutputs(Group):
    """What happens at the valve, where a machine's sensors sit, and in the relief valves."""

    spool_position: Scalar = Quantity("1", "Spool position of the {} valve, share of its stroke")
    head_valve_flow: Scalar = Quantity("m3/s", "Flow from the valve into the head hose of the {}", 1e-3)
    rod_valve_flow: Scalar = Quantity("m3/s", "Flow from the valve into the rod hose of the {}", 1e-3)
    head_valve_pressure: Scalar = Quantity("Pa", "Pressure at port A of the {} valve", 1e7)
    rod_valve_pressure: Scalar = Quantity("Pa", "Pressure at port B of the {} valve", 1e7)
    relief_flow: Scalar = Quantity("m3/s", "Flow of both relief valves of the {} cylinder", 1e-3)
    anti_cavitation_flow: Scalar = Quantity(
        "m3/s", "Flow of both anti-cavitation valves of the {} cylinder", 1e-3
    )
    head_bulk_modulus: Scalar = Quantity(
        "Pa", "Effective bulk modulus of the oil at the head side of the {}", 1e9
    )
    rod_bulk_modulus: Scalar = Quantity(
        "Pa", "Effective bulk modulus of the oil at the rod side of the {}", 1e9
    )


class DetailedBoomStickOutputs(BoomStickOutputs, boom=DetailedAxisOutputs, stick=DetailedAxisOutputs):
    """With what happens at the valves and in the relief valves."""
