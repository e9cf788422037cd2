"""Common variables of all variants of the supply: parameters, inputs, outputs; signs as in ideal.py."""

from functools import partial
from pathlib import Path

import casadi as ca

from fmus import ports
from fmus.components.chamber import ATMOSPHERE
from fmus.components.circuit import GROUND, Branch, Kind
from fmus.components.load_sensing import LoadPressure, highest, relieved
from fmus.contract import Group, Quantity, Scalar, Subsystem

CONSUMERS = ("swing", "boom_stick")


class CommonParameters(Group):
    """Parameters of every variant: tank, relief valve of the load-sensing line."""

    reservoir_pressure: Scalar = Quantity(
        "Pa", "Pressure in the tank and in the return lines", 1e5, minimum=-ATMOSPHERE, group="Tank"
    )
    load_sensing_relief_difference: Scalar = Quantity(
        "Pa",
        "Pressure below the highest one of the supply to which the load-sensing line is limited",
        1e6,
        minimum=0.0,
        group="Load-sensing line",
    )
    load_sensing_relief_rounding: Scalar = Quantity(
        "Pa", "Pressure range over which the relief valve of that line opens", 1e5, minimum=1.0
    )


class LoadInputs(Group):
    """Load pressure of a drive; the rate input carries its exact time derivative."""

    load_pressure: Scalar = Quantity(
        "Pa",
        "Highest load pressure of {}",
        1e7,
        rate="load_pressure_rate",
        optional="the load of {} is not sensed",
    )
    load_pressure_rate: Scalar = ports.rate_input("{}_load_pressure", "Pa/s", 1e8)


class SupplyInputs(Group, swing=LoadInputs, boom_stick=LoadInputs):
    """Flows of the drives from the supply line and into the return line, and their load pressures."""

    supply_flow_swing: Scalar = Quantity("m3/s", "Flow from the supply line into the swing drive", 1e-3)
    return_flow_swing: Scalar = Quantity("m3/s", "Flow from the swing drive into the return line", 1e-3)
    supply_flow_boom_stick: Scalar = Quantity(
        "m3/s", "Flow from the supply line into the boom and stick drives", 1e-3
    )
    return_flow_boom_stick: Scalar = Quantity(
        "m3/s", "Flow from the boom and stick drives into the return line", 1e-3
    )


class SupplyOutputs(Group):
    """Pressures of supply and return lines, flows and power of the drives, energies."""

    supply_pressure: Scalar = Quantity("Pa", "Pressure of the supply line", 1e7)
    supply_pressure_rate: Scalar = ports.rate_output("supply_pressure", "Pa/s", 1e8)
    tank_pressure: Scalar = Quantity("Pa", "Pressure of the return lines", 1e5)
    tank_pressure_rate: Scalar = ports.rate_output("tank_pressure", "Pa/s", 1e7)
    load_sensing_pressure: Scalar = Quantity("Pa", "Pressure of the load-sensing line", 1e7)
    load_sensing_pressure_rate: Scalar = ports.rate_output("load_sensing_pressure", "Pa/s", 1e8)
    supply_flow: Scalar = Quantity("m3/s", "Flow from the supply line into all drives", 1e-3)
    return_flow: Scalar = Quantity("m3/s", "Flow into the return lines from all drives", 1e-3)
    hydraulic_power: Scalar = Quantity(
        "W", "Hydraulic power into the drives: pressure times flow, supply minus return", 1e4
    )
    engine_power: Scalar = Quantity("W", "Input power: from the combustion, or from the ideal source", 1e4)
    stored_energy: Scalar = Quantity("J", "Energy of oil compression, rotation and oil in the tank", 1e3)
    dissipated_power: Scalar = Quantity("W", "Power dissipated by friction, leakage and throttling", 1e4)


def supply_flow(u: SupplyInputs) -> Scalar:
    """Flow [m3/s] from the supply line into all drives."""
    return u.supply_flow_swing + u.supply_flow_boom_stick


def return_flow(u: SupplyInputs) -> Scalar:
    """Flow [m3/s] from all drives into the return line."""
    return u.return_flow_swing + u.return_flow_boom_stick


def consumers(u: SupplyInputs) -> dict[str, Branch]:
    """The drives, in the circuit of a supply."""
    return {
        "supply_flow": Branch("supply_pressure", GROUND, Kind.CONSUMER, supply_flow(u)),
        "return_flow": Branch(GROUND, "tank_pressure", Kind.CONSUMER, return_flow(u)),
    }


def line_pressure(u: SupplyInputs, p: CommonParameters, setting: Scalar) -> LoadPressure:
    """Pressure of the load-sensing line without lag: the highest load pressure of all drives, limited."""
    load = highest(
        LoadPressure(u.swing.load_pressure, u.swing.load_pressure_rate),
        LoadPressure(u.boom_stick.load_pressure, u.boom_stick.load_pressure_rate),
    )
    return limited(load, p, setting)


def limited(load: LoadPressure, p: CommonParameters, setting: Scalar) -> LoadPressure:
    """Limited by the relief valve of the load-sensing line.

    setting   highest pressure of the supply without its main relief valve [Pa]
    """
    limit = ca.fmax(setting - p.load_sensing_relief_difference, p.reservoir_pressure)
    return relieved(load, limit, p.load_sensing_relief_rounding)


TERMINALS = tuple(
    terminal
    for name in CONSUMERS
    for terminal in (
        ports.supply_line(to=name),
        ports.return_line(of=name),
        ports.load_sensing_line(name, supply=True),
    )
)

# a variant with its own equations and groups
variant = partial(
    Subsystem,
    name="supply",
    inputs=SupplyInputs,
    values=Path(__file__).with_name("parameters.toml"),
    terminals=TERMINALS,
)
