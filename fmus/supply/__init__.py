"""Hydraulic supply: ideal pressure source, pumps at constant pressure, or a load-sensing pump, on an engine.

`VARIANTS` are these three models; `SUPPLY` is the default, the ideal source. `supply` makes them for the
drives of another machine.
"""

from collections.abc import Sequence
from dataclasses import replace

from fmus.contract import Subsystem, family
from fmus.supply import engine_pump, ideal, load_sensing
from fmus.supply.variables import CONSUMERS, inputs, terminals


def supply(drives: Sequence[str], name: str = "supply") -> dict[str, Subsystem]:
    """The variants of a supply of these drives."""
    variants = {
        "ideal": ideal.IDEAL,
        "engine_pump": engine_pump.ENGINE_PUMP,
        "load_sensing": load_sensing.LOAD_SENSING,
    }
    u, t = inputs(drives), terminals(drives)
    return family(name, **{v: replace(sub, inputs=u, terminals=t) for v, sub in variants.items()})


VARIANTS = supply(CONSUMERS)
SUPPLY = VARIANTS["ideal"]

__all__ = ["SUPPLY", "VARIANTS", "supply"]
