"""The harvester's variables as one block, and as recordings and parameter files name them."""

from __future__ import annotations

from fmus.contract import quantities
from fmus.flat import declared, flat_names
from fmus.harvester import HARVESTER
from fmus.harvester.model import HIDDEN, TOTALS
from fmus.machine import INPUTS, SUBSYSTEMS
from fmus.parameters import numbers


def _flat() -> dict[str, str]:
    tables = {name: numbers(sub) for name, sub in SUBSYSTEMS.items()}
    return dict(flat_names(SUBSYSTEMS, tables, INPUTS, TOTALS, HIDDEN))


def signals() -> dict[str, str]:
    """Input or output of `HARVESTER` -> the signal of a recording, such as "swing.supply_pressure"."""
    found = {own: targets[0] for own, targets in INPUTS.items()}
    flat, outputs = _flat(), quantities(HARVESTER.outputs)
    for variable in declared(SUBSYSTEMS, "outputs"):
        if variable in flat and flat[variable] in outputs:
            found.setdefault(flat[variable], variable)
    return found


def parameters() -> dict[str, str]:
    """Parameter of `HARVESTER` -> its name in parameters.toml, `part.name` where parts differ."""
    flat, found = _flat(), {}
    for variable in declared(SUBSYSTEMS, "parameters"):
        own = variable.partition(".")[2]
        found[flat[variable]] = own if flat[variable] == own else variable
    return found
