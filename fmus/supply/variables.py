"""Common variables of all variants of the supply: parameters, inputs, outputs; signs as in ideal.py."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial, reduce
from pathlib import Path
from typing import Any

import casadi as ca

from fmus import ports
from fmus.components.chamber import ATMOSPHERE
from fmus.components.circuit import GROUND, Branch, Kind
from fmus.components.load_sensing import LoadPressure, highest, relieved
from fmus.components.oil import Grade
from fmus.contract import Group, Quantity, Scalar, Subsystem, Terminal, make_group

CONSUMERS = ("swing", "boom_stick")


class CommonParameters(Grade):
    """Parameters of every variant: tank, oil, relief valve of the load-sensing line."""

    reservoir_pressure: Scalar = Quantity(
        "Pa", "Pressure in the tank and in the return lines", 1e5, minimum=-ATMOSPHERE, group="Tank"
    )
    oil_temperature_start: Scalar = Quantity(
        "K", "Initial temperature of the oil", 300.0, minimum=243.15, maximum=373.15, group="Oil"
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


class DriveInputs(Group):
    """Load pressure of a drive with its exact time derivative, and its flows."""

    load_pressure: Scalar = Quantity(
        "Pa",
        "Highest load pressure of {}",
        1e7,
        rate="load_pressure_rate",
        optional="the load of {} is not sensed",
    )
    load_pressure_rate: Scalar = ports.rate_input("{}_load_pressure", "Pa/s", 1e8)
    supply_flow: Scalar = Quantity("m3/s", "Flow from the supply line into {}", 1e-3)
    return_flow: Scalar = Quantity("m3/s", "Flow from {} into the return line", 1e-3)


def inputs(drives: Sequence[str]) -> type[Any]:
    """Inputs of a supply of these drives."""

    def named(drive: str) -> Callable[[str], str]:
        return lambda n: f"{drive}_{n}" if n.startswith("load") else f"{n}_{drive}"

    return make_group("SupplyInputs", {}, **{d: (DriveInputs, d, named(d)) for d in drives})


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
    oil_temperature: Scalar = replace(
        ports.oil_temperature("Temperature of the oil in the tank"), warn_below=253.15
    )


def supply_flow(u: Any) -> Scalar:
    """Flow [m3/s] from the supply line into all drives."""
    return sum(drive.supply_flow for drive in vars(u).values())


def consumers(u: Any) -> dict[str, Branch]:
    """The drives, in the circuit of a supply."""
    returned = sum(drive.return_flow for drive in vars(u).values())
    return {
        "supply_flow": Branch("supply_pressure", GROUND, Kind.CONSUMER, supply_flow(u), "Q"),
        "return_flow": Branch(GROUND, "tank_pressure", Kind.CONSUMER, returned, "Q_return"),
    }


def line_pressure(u: Any, p: CommonParameters, setting: Scalar) -> LoadPressure:
    """Pressure of the load-sensing line without lag: the highest load pressure of all drives, limited."""
    loads = (LoadPressure(drive.load_pressure, drive.load_pressure_rate) for drive in vars(u).values())
    return limited(reduce(highest, loads), p, setting)


def limited(load: LoadPressure, p: CommonParameters, setting: Scalar) -> LoadPressure:
    """Limited by the relief valve of the load-sensing line.

    setting   highest pressure of the supply without its main relief valve [Pa]
    """
    limit = ca.fmax(setting - p.load_sensing_relief_difference, p.reservoir_pressure)
    return relieved(load, limit, p.load_sensing_relief_rounding)


def terminals(drives: Sequence[str]) -> tuple[Terminal, ...]:
    """Lines to these drives."""
    return tuple(
        terminal
        for name in drives
        for terminal in (
            ports.supply_line(to=name),
            ports.return_line(of=name),
            ports.load_sensing_line(name, supply=True),
        )
    )


# a variant with its own equations and groups, for the drives of the machine
variant = partial(
    Subsystem,
    name="supply",
    inputs=inputs(CONSUMERS),
    values=Path(__file__).with_name("parameters.toml"),
    terminals=terminals(CONSUMERS),
)
