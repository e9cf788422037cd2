"""Variables of the boom and stick drives: groups of one drive, and the groups of both with prefixes.

Signs: flows are positive into the cylinder; positions are measured from the closed end; velocities and forces
are positive if they extend the rod; a positive command extends the rod.
"""

from fmus import ports
from fmus.components import chamber, spool_valve
from fmus.components.chamber import Fluid, Oil
from fmus.components.cylinder import Cylinder
from fmus.components.hose import Hose, HoseWall, LumpedHose, ReferenceHose, VolumeHose
from fmus.components.oil import OilTemperature
from fmus.components.orifice import ReliefParameters
from fmus.components.spool_valve import CurvedEdges, CurvedValve, Spool
from fmus.contract import Group, Quantity, Scalar
from fmus.ports import LineInputs

AXES = ("boom", "stick")
SIDES = ("head", "rod")


class Preload(OilTemperature):
    """Initial pressure of the drives, and temperature of their oil."""

    initial_preload: Scalar = Quantity(
        "Pa", "Initial pressure of the unloaded side of a cylinder", 1e6, minimum=1e3, group="Start"
    )


class QuasistaticDriveParameters(Cylinder, hose=(VolumeHose, "{} hose")):
    """Cylinder and hoses of one drive without line dynamics."""


class LumpedDriveParameters(Cylinder, hose=(LumpedHose, "{} hose")):
    """Cylinder and hoses of one drive, each hose one lump."""


class DetailedDriveParameters(Cylinder, hose=(Hose, "{} hose")):
    """Cylinder and hoses of one drive, each hose a line."""


class BoomStickParameters(
    Oil, Preload, ReferenceHose, valve=CurvedValve, boom=LumpedDriveParameters, stick=LumpedDriveParameters
):
    """Parameters of the lumped drives; values and sources are in parameters.toml."""


class Pressures(Group):
    """Pressures of a cylinder."""

    head_pressure: Scalar = chamber.pressure("Pressure at the head side of the {} cylinder")
    rod_pressure: Scalar = chamber.pressure("Pressure at the rod side of the {} cylinder")


class OilState(Pressures):
    """Pressures and line flows of a drive."""

    head_flow: Scalar = Quantity("m3/s", "Flow into the head side of the {} cylinder", 1e-3)
    rod_flow: Scalar = Quantity("m3/s", "Flow into the rod side of the {} cylinder", 1e-3)


class BoomStickState(Group, boom=OilState, stick=OilState):
    """State of the lumped drives: pressures and line flows, which are outputs of every variant."""


class DriveInputs(Group):
    """Command and motion of the piston of one drive; the rate inputs carry exact time derivatives."""

    command: Scalar = ports.command("{}", "extends the rod", "command_rate")
    command_rate: Scalar = ports.rate_input("{}_command", "V/s", 10.0)
    position: Scalar = Quantity(
        "m", "Piston position of the {} cylinder from its closed end", rate="velocity"
    )
    velocity: Scalar = Quantity("m/s", "Piston velocity of the {} cylinder", 0.1, rate="acceleration")
    acceleration: Scalar = ports.rate_input("{}_velocity", "m/s2")
    holding_force: Scalar = Quantity(
        "N", "Force that holds the {} at the start; only used for initialisation", 1e5
    )


class AxisInputs(LineInputs, DriveInputs):
    """All inputs of one drive."""


class _BothDriveInputs(Group, boom=DriveInputs, stick=DriveInputs):
    """Inputs of both drives."""


class BoomStickInputs(LineInputs, _BothDriveInputs):
    """Commands, motion of the pistons, and supply."""

    boom_command: Scalar = ports.command("boom", "raises the boom", "boom_command_rate")
    stick_command: Scalar = ports.command("stick", "folds the stick in", "stick_command_rate")


class DriveOutputs(Group):
    """Force and its rate (to the mechanics), and monitoring outputs."""

    force: Scalar = Quantity("N", "Hydraulic force of the {} cylinder", 1e5)
    force_rate: Scalar = ports.rate_output("{}_force", "N/s", 1e6)
    void_volume: Scalar = chamber.cavity("the {} cylinder")


class BoomStickOutputs(BoomStickState, boom=DriveOutputs, stick=DriveOutputs):
    """States, forces (to the mechanics), flows (to the supply), and energies of both drives."""

    supply_flow: Scalar = Quantity("m3/s", "Flow from the supply line", 1e-3)
    return_flow: Scalar = Quantity("m3/s", "Flow into the return line", 1e-3)
    boom_stick_load_pressure: Scalar = Quantity(
        "Pa", "Higher load pressure of boom and stick, to the load-sensing line", 1e7
    )
    boom_stick_load_pressure_rate: Scalar = ports.rate_output("boom_stick_load_pressure", "Pa/s", 1e8)
    stored_energy: Scalar = Quantity("J", "Energy of oil compression and of the moving oil columns", 1e3)
    dissipated_power: Scalar = Quantity("W", "Power dissipated by metering edges and hoses", 1e4)
    convected_power: Scalar = Quantity(
        "W", "Compression energy convected by oil into growing volumes, minus that out of shrinking ones", 1e3
    )


class DetailedBoomStickParameters(
    Fluid,
    Preload,
    ReferenceHose,
    HoseWall,
    ReliefParameters,
    valve=CurvedEdges,
    spool=Spool,
    boom=DetailedDriveParameters,
    stick=DetailedDriveParameters,
):
    """Parameters of the detailed drives; values and sources are in parameters.toml."""


class DetailedAxisOutputs(Group):
    """Signals at the valve, where a machine has its sensors, and of the relief valves."""

    spool_position: Scalar = spool_valve.position("Spool position of the {} valve")
    head_valve_flow: Scalar = Quantity("m3/s", "Flow from the valve into the head hose of the {}", 1e-3)
    rod_valve_flow: Scalar = Quantity("m3/s", "Flow from the valve into the rod hose of the {}", 1e-3)
    head_valve_pressure: Scalar = chamber.port_pressure("Pressure at port A of the {} valve")
    rod_valve_pressure: Scalar = chamber.port_pressure("Pressure at port B of the {} valve")
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
    """Outputs of every variant, and signals of spools, valves and relief valves."""
