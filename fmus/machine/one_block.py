"""The machine (swing drive, boom and stick drives, manipulator) as one subsystem and one FMU, `harvester`.

Inputs are commands, supply and payload. Only differences from the declarations of the parts are listed here.
"""

from collections.abc import Mapping
from pathlib import Path

from fmus.composition import compose
from fmus.contract import Subsystem
from fmus.machine.machine import wiring
from fmus.machine.parts import DRIVES, FERIC
from fmus.ports import grip, lever, return_line, supply_line

# signals of internal connections; accelerations stay visible, because they can be measured
HIDDEN = (
    *(source for source, _ in FERIC.rates + FERIC.holding if not source.endswith("acceleration")),
    *(f"{drive}.{drive}_load_pressure_rate" for drive in DRIVES),
)

TEXTS = {
    "supply_flow": "Flow from the supply line into all three drives",
    "return_flow": "Flow into the return line from all three drives, with the case drain",
    "stored_energy": "Energy of oil compression and of the moving oil columns of all three drives",
    "dissipated_power": "Power dissipated by edges, hoses, lines, leakage, friction and pick-up of payload",
    "swing_acceleration": "Acceleration of the swing column",
    "boom_acceleration": "Acceleration of the boom piston",
    "stick_acceleration": "Acceleration of the stick piston",
}
TOTALS = ("supply_flow", "return_flow", "stored_energy", "dissipated_power")


def composed_machine(parts: Mapping[str, Subsystem]) -> Subsystem:
    """The machine composed of swing, boom_stick and manipulator, with their parameter values."""
    return compose(
        name="harvester",
        text="Forestry harvester: swing, boom and stick drives and the manipulator as one block",
        subsystems=parts,
        connections=FERIC.connections,
        inputs=wiring(parts)[1],
        folder=Path(__file__).parent / "harvester",
        hidden=HIDDEN,
        totals=TOTALS,
        texts=TEXTS,
        terminals=(
            *(lever(axis) for axis in ("swing", "boom", "stick")),
            grip(),
            supply_line(),
            return_line(),
        ),
    )


HARVESTER = composed_machine(FERIC.subsystems)

__all__ = ["HARVESTER", "composed_machine"]
