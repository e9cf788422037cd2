"""Hydraulic supply: ideal pressure source, pumps at constant pressure, or a load-sensing pump, on an engine.

`VARIANTS` are these three models; `SUPPLY` is the default, the ideal source. `supply` makes them for the
drives of another machine.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

from fmus.components.additions import Addition
from fmus.contract import Subsystem, family, make_group
from fmus.supply import engine_pump, ideal, load_sensing
from fmus.supply.rail import with_heats
from fmus.supply.variables import CONSUMERS, inputs, terminals

NONE: Mapping[str, type[Addition]] = {}


def supply(
    drives: Sequence[str], name: str = "supply", additions: Mapping[str, type[Addition]] = NONE
) -> dict[str, Subsystem]:
    """The variants of a supply of these drives; those with a supply line have the additions, by name."""
    variants = {
        "ideal": ideal.IDEAL,
        "engine_pump": engine_pump.ENGINE_PUMP,
        "load_sensing": load_sensing.LOAD_SENSING,
    }
    u, t = inputs(drives), terminals(drives)
    made = {v: replace(sub, inputs=u, terminals=t) for v, sub in variants.items()}
    for v in ("engine_pump", "load_sensing"):
        sub, states = made[v], {n: a.states for n, a in additions.items() if a.states}
        if additions:
            parameters = make_group("Parameters", {}, sub.parameters, **additions)
            own, shown = (make_group(of.__name__, {}, of, **states) for of in (sub.states, sub.outputs))
            sub = replace(sub, parameters=parameters, states=own, outputs=shown)
        made[v] = with_heats(sub)
    return family(name, **made)


VARIANTS = supply(CONSUMERS)
SUPPLY = VARIANTS["ideal"]

__all__ = ["SUPPLY", "VARIANTS", "supply"]
