"""Parameters that every subsystem with spool valves declares: the valves are identical (section 3(b))."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from fmus.components.spool_valve import Valve
from fmus.contract import Quantity, Scalar


@dataclass(frozen=True)
class EdgeParameters:
    """The numbers of the metering edges and the density of the oil, to inherit from."""

    valve_area: Annotated[
        Scalar,
        Quantity(
            "m2", "Opening area of each metering edge at full command", 1e-5, minimum=0.0, group="Valve"
        ),
    ]
    valve_discharge_coefficient: Annotated[
        Scalar, Quantity("1", "Discharge coefficient of the metering edges", minimum=0.1, maximum=1.0)
    ]
    valve_full_command: Annotated[
        Scalar, Quantity("V", "Command at which the valve is fully open", minimum=0.1)
    ]
    valve_command_rounding: Annotated[
        Scalar, Quantity("V", "Width over which the foot of the opening curve is rounded", minimum=1e-3)
    ]
    valve_leakage: Annotated[
        Scalar, Quantity("m3/(s.Pa)", "Laminar leakage of each metering edge", 1e-14, minimum=1e-17)
    ]
    valve_transition_flow: Annotated[
        Scalar, Quantity("m3/s", "Flow below which edges, hoses and lines are laminar", 1e-5, minimum=1e-8)
    ]
    density: Annotated[Scalar, Quantity("kg/m3", "Density of the oil", 1e3, minimum=100.0, group="Oil")]


@dataclass(frozen=True)
class ValveParameters(EdgeParameters):
    """With the dead band of a spool without dynamics."""

    valve_dead_band: Annotated[
        Scalar,
        Quantity("V", "Dead band: command up to which the valve stays closed", minimum=0.0, group="Valve"),
    ]

    @property
    def valve(self) -> Valve:
        """The valve these numbers describe."""
        return Valve(
            self.valve_area,
            self.valve_discharge_coefficient,
            self.valve_dead_band,
            self.valve_full_command,
            self.valve_command_rounding,
            self.valve_leakage,
            self.valve_transition_flow,
        )
