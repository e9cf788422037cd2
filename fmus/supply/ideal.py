"""Ideal supply, as in section 3(a) of the paper: a pressure source.

    supply_pressure = pressure_setting        tank_pressure = reservoir_pressure

for every flow. There is no state. The outputs of power are valid for any flow of the drives.

Signs: supply flows are positive out of the supply line, return flows into the tank.
"""

from typing import Any

from fmus.components.chamber import ATMOSPHERE
from fmus.components.circuit import GROUND, Branch, Circuit, Kind, Node
from fmus.contract import Group, Quantity, Scalar
from fmus.supply.variables import (
    CommonParameters,
    SupplyOutputs,
    consumers,
    line_pressure,
    supply_flow,
    variant,
)


class IdealParameters(CommonParameters):
    """The two pressures, and the load-sensing line; values and sources are in parameters.toml."""

    pressure_setting: Scalar = Quantity(
        "Pa", "Pressure of the supply line at any flow", 1e7, minimum=-ATMOSPHERE, group="Source"
    )


class IdealState(Group):
    """No states."""


def dynamics(x: IdealState, u: Any, p: IdealParameters) -> IdealState:
    """No states, no derivatives."""
    return IdealState()


def circuit(x: IdealState, u: Any, p: IdealParameters) -> Circuit:
    """The source between the lines."""
    nodes = {
        "supply_pressure": Node(p.pressure_setting),
        "tank_pressure": Node(p.reservoir_pressure, "P_t"),
        GROUND: Node(0),
    }
    source = Branch("tank_pressure", "supply_pressure", Kind.SOURCE, supply_flow(u), "P_s")
    return Circuit(nodes, {"source": source, **consumers(u)})


def observe(x: IdealState, u: Any, p: IdealParameters) -> SupplyOutputs:
    """Outputs."""
    whole, load = circuit(x, u, p), line_pressure(u, p, p.pressure_setting)
    power = whole.work(Kind.CONSUMER)
    return SupplyOutputs(
        supply_pressure=p.pressure_setting,
        supply_pressure_rate=0,
        tank_pressure=p.reservoir_pressure,
        tank_pressure_rate=0,
        load_sensing_pressure=load.value,
        load_sensing_pressure_rate=load.rate,
        supply_flow=whole.flows["supply_flow"],
        return_flow=whole.flows["return_flow"],
        hydraulic_power=power,
        engine_power=power,
        stored_energy=0,
        dissipated_power=0,
        oil_temperature=p.oil_temperature_start,
    )


def require(x: IdealState, u: Any, p: IdealParameters) -> dict[str, Scalar]:
    """Requirement: order of the pressures; 1 Pa allows equal ones, of a supply that is switched off."""
    return {"pressure_setting is not below reservoir_pressure": p.pressure_setting - p.reservoir_pressure + 1}


IDEAL = variant(
    text="Hydraulic supply: an ideal pressure source",
    parameters=IdealParameters,
    states=IdealState,
    outputs=SupplyOutputs,
    dynamics=dynamics,
    observe=observe,
    circuits=lambda x, u, p: {"supply": circuit(x, u, p)},
    require=require,
    validity="while pumps and engine have flow and power to spare; no pressure ripple, no sag",
)
