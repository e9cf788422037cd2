"""Swing drive, boom and stick drives and manipulator joined: commands in, motion out.

Nothing is declared here but what a user of the one block sees otherwise than a user of the parts.

The whole machine as one block.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from fmus.components.ports import lever, return_line, supply_line
from fmus.composition import compose
from fmus.contract import Subsystem
from fmus.machine.parts import CONNECTIONS, HOLDING, INPUTS, RATES, SUBSYSTEMS

# wires inside the block; accelerations stay, somebody may have measured them
HIDDEN = tuple(source for source, _ in RATES + HOLDING if not source.endswith("acceleration"))

TEXTS = {
    "supply_flow": "Flow taken from the supply line by all three drives",
    "return_flow": "Flow given to the return line by all three drives, with the case drain",
    "stored_energy": "Energy of compression and of the moving oil columns of all three drives",
    "dissipated_power": "Heat of metering edges, hoses, lines and leakage, and of joint and piston friction",
    "swing_acceleration": "Acceleration of the swing column",
    "boom_acceleration": "Acceleration of the boom piston",
    "stick_acceleration": "Acceleration of the stick piston",
}
TOTALS = ("supply_flow", "return_flow", "stored_energy", "dissipated_power")


def whole(parts: Mapping[str, Subsystem]) -> Subsystem:
    """The machine of swing, boom_stick and manipulator, with their numbers."""
    return compose(
        name="harvester",
        text="Forestry harvester: swing, boom and stick drives and the manipulator as one block",
        subsystems=parts,
        connections=CONNECTIONS,
        inputs=INPUTS,
        folder=Path(__file__).parent / "harvester",
        hidden=HIDDEN,
        totals=TOTALS,
        texts=TEXTS,
        terminals=(*(lever(axis) for axis in ("swing", "boom", "stick")), supply_line(), return_line()),
    )


HARVESTER = whole(SUBSYSTEMS)

__all__ = ["HARVESTER", "whole"]
