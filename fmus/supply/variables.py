"""Variables of the supply that every variant has: parameters, inputs, outputs; signs as in ideal.py."""

from __future__ import annotations

from fmus.components import ports
from fmus.contract import Group, Quantity, Scalar

CONSUMERS = ("swing", "boom_stick")


class ReservoirParameters(Group):
    """What every variant knows of the tank."""

    reservoir_pressure: Scalar = Quantity(
        "Pa", "Pressure in the tank and in the return lines", 1e5, group="Tank"
    )


class SupplyInputs(Group):
    """Flows of the drives: what they take from the supply line, what they give back to the tank."""

    supply_flow_swing: Scalar = Quantity("m3/s", "Flow that the swing drive takes from the supply line", 1e-3)
    return_flow_swing: Scalar = Quantity("m3/s", "Flow that the swing drive gives to the return line", 1e-3)
    supply_flow_boom_stick: Scalar = Quantity(
        "m3/s", "Flow that the boom and stick drives take from the supply line", 1e-3
    )
    return_flow_boom_stick: Scalar = Quantity(
        "m3/s", "Flow that the boom and stick drives give to the return line", 1e-3
    )


class SupplyOutputs(Group):
    """Pressures for the drives, and the power that goes into them."""

    supply_pressure: Scalar = Quantity("Pa", "Pressure of the supply line", 1e7)
    supply_pressure_rate: Scalar = Quantity(
        "Pa/s", "Rate port: exact time derivative of supply_pressure", 1e8
    )
    tank_pressure: Scalar = Quantity("Pa", "Pressure of the return lines", 1e5)
    supply_flow: Scalar = Quantity("m3/s", "Flow taken from the supply line by all drives", 1e-3)
    return_flow: Scalar = Quantity("m3/s", "Flow given back by all drives", 1e-3)
    hydraulic_power: Scalar = Quantity(
        "W", "Power into the drives: supply less return, pressure times flow", 1e4
    )
    engine_power: Scalar = Quantity("W", "Power put in: by the combustion, or by the ideal source", 1e4)
    stored_energy: Scalar = Quantity("J", "Energy of the oil and of what turns", 1e3)
    dissipated_power: Scalar = Quantity("W", "Heat of friction, leakage and throttling", 1e4)


def supply_flow(u: SupplyInputs) -> Scalar:
    """Flow [m3/s] that all drives take."""
    return u.supply_flow_swing + u.supply_flow_boom_stick


def return_flow(u: SupplyInputs) -> Scalar:
    """Flow [m3/s] that all drives give back."""
    return u.return_flow_swing + u.return_flow_boom_stick


TERMINALS = tuple(line(name) for name in CONSUMERS for line in (ports.supply_line_to, ports.return_line_from))
