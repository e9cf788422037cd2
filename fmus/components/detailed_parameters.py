"""Parameters that the detailed drives share: oil with air, hose walls, a moving spool, relief valves."""

from __future__ import annotations

import math

from fmus.components.oil import Fluid
from fmus.components.orifice import PressureValve
from fmus.components.spool_dynamics import Edges, Spool
from fmus.components.spool_valve import EdgeParameters
from fmus.contract import Group, Quantity, Scalar

BANDWIDTH = 75.0  # Hz: modes of the lines up to here, which recordings at the paper's 200 Hz show, ...
ERROR = 0.05  # ... have frequencies within this share, unless the number of lumps is given

_OVERLAP = "Overlap of the edge {}: share of the stroke up to which it stays closed"


def _overlap(edge: str) -> Quantity:
    return Quantity("1", _OVERLAP.format(edge), 0.1, minimum=0.0, maximum=0.9)


class SpoolParameters(EdgeParameters):
    """A spool with dynamics and an overlap of its own for each edge."""

    spool_frequency: Scalar = Quantity(
        "Hz", "Natural frequency of the spool", 10.0, minimum=0.1, group="Spool"
    )
    spool_damping: Scalar = Quantity("1", "Damping ratio of the spool", minimum=0.1)
    spool_speed: Scalar = Quantity(
        "1/s", "Largest speed of the spool, in strokes from the centre", 10.0, minimum=0.1
    )
    spool_overlap_pa: Scalar = _overlap("P-A")
    spool_overlap_at: Scalar = _overlap("A-T")
    spool_overlap_pb: Scalar = _overlap("P-B")
    spool_overlap_bt: Scalar = _overlap("B-T")

    @property
    def spool(self) -> Spool:
        """The moving spool these numbers describe."""
        return Spool(2 * math.pi * self.spool_frequency, self.spool_damping, self.spool_speed)

    @property
    def edges(self) -> Edges:
        """Its edges."""
        return Edges(
            self.valve_area,
            self.valve_discharge_coefficient,
            self.spool_overlap_pa,
            self.spool_overlap_at,
            self.spool_overlap_pb,
            self.spool_overlap_bt,
            self.valve_command_rounding / self.valve_full_command,
            self.valve_leakage,
            self.valve_transition_flow,
        )


class ReliefParameters(Group):
    """Relief and anti-cavitation valves."""

    relief_pressure: Scalar = Quantity(
        "Pa", "Pressure at which a relief valve opens", 1e7, minimum=0.0, group="Relief valves"
    )
    relief_gain: Scalar = Quantity(
        "m3/(s.Pa)", "Flow of a relief valve per pressure above", 1e-9, minimum=0.0
    )
    relief_rounding: Scalar = Quantity(
        "Pa", "Width over which the foot of a relief valve is rounded", 1e5, minimum=1.0
    )
    anti_cavitation_pressure: Scalar = Quantity(
        "Pa",
        "Pressure below that of the return line at which an anti-cavitation valve opens",
        1e4,
        minimum=0.0,
    )
    anti_cavitation_gain: Scalar = Quantity(
        "m3/(s.Pa)", "Flow of an anti-cavitation valve per pressure below", 1e-7, minimum=0.0
    )
    anti_cavitation_rounding: Scalar = Quantity(
        "Pa", "Width over which the foot of an anti-cavitation valve is rounded", 1e3, minimum=1.0
    )

    @property
    def relief(self) -> PressureValve:
        """The relief valves."""
        return PressureValve(self.relief_pressure, self.relief_gain, self.relief_rounding)

    @property
    def anti_cavitation(self) -> PressureValve:
        """The anti-cavitation valves."""
        return PressureValve(
            self.anti_cavitation_pressure, self.anti_cavitation_gain, self.anti_cavitation_rounding
        )


class FluidParameters(Group):
    """Oil with air, and the walls of the hoses; density and bulk modulus stand elsewhere."""

    viscosity: Scalar = Quantity("Pa.s", "Dynamic viscosity of the oil", 1e-2, minimum=1e-7, group="Oil")
    air_share: Scalar = Quantity(
        "1", "Free air at atmospheric pressure, per volume of oil", 1e-2, minimum=0.0, maximum=0.2
    )
    air_exponent: Scalar = Quantity("1", "Polytropic exponent of the air", minimum=1.01, maximum=1.7)
    hose_wall_modulus: Scalar = Quantity(
        "Pa",
        "Pressure over relative growth of a hose's volume by its wall",
        1e9,
        minimum=1e7,
        group="Hose walls",
    )


def fluid(p: FluidParameters, density: Scalar, bulk_modulus: Scalar) -> Fluid:
    """The oil these numbers describe."""
    return Fluid(density, p.viscosity, bulk_modulus, p.air_share, p.air_exponent)
