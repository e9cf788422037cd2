"""A machine (its drives and its manipulator) as one subsystem and one FMU; the harvester's is `harvester`.

Inputs are commands, supply and payload. Only differences from the declarations of the parts are listed here.
"""

from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

from fmus.composition import compose
from fmus.contract import Subsystem, quantities
from fmus.machine.machine import Machine
from fmus.machine.parts import FERIC
from fmus.ports import grip, return_line, supply_line

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


def hidden(machine: Machine) -> list[str]:
    """Signals of internal connections; accelerations stay visible, because they can be measured."""
    found = [source for source, _ in machine.rates + machine.holding if not source.endswith("acceleration")]
    rates = ((n, f"{n}_load_pressure_rate", sub) for n, sub in machine.subsystems.items())
    return found + [f"{n}.{rate}" for n, rate, sub in rates if rate in quantities(sub.outputs)]


def one_block(
    machine: Machine, text: str, folder: Path | None = None, texts: Mapping[str, str] | None = None
) -> Subsystem:
    """The machine composed of the default variants of its parts; the rest is as in `compose`."""
    levers = [t for t in machine.operator.terminals if t.kind == "lever"] if machine.operator else []
    return compose(
        subsystems=machine.subsystems,
        connections=machine.connections,
        inputs=machine.inputs,
        hidden=hidden(machine),
        totals=TOTALS,
        terminals=(*levers, grip(), supply_line(), return_line()),
        name=machine.name,
        text=text,
        folder=folder,
        texts=texts,
    )


@cache
def harvester_block(machine: Machine = FERIC) -> Subsystem:
    """The harvester composed of swing, boom_stick and manipulator, with their parameter values."""
    text = "Forestry harvester: swing, boom and stick drives and the manipulator as one block"
    return one_block(machine, text, Path(__file__).parent / machine.name, TEXTS)


HIDDEN = tuple(hidden(FERIC))


def __getattr__(name: str) -> Any:
    """HARVESTER: that of the paper, composed when it is first used; a crane does without."""
    if name == "HARVESTER":
        return harvester_block()
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


__all__ = ["harvester_block", "one_block"]
