"""Hydraulic supply: ideal pressure source, pumps at constant pressure, or a load-sensing pump, on an engine.

`VARIANTS` are these three models; `SUPPLY` is the default, the ideal source.
"""

from fmus.contract import family
from fmus.supply import engine_pump, ideal, load_sensing

VARIANTS = family(
    "supply",
    ideal=ideal.IDEAL,
    engine_pump=engine_pump.ENGINE_PUMP,
    load_sensing=load_sensing.LOAD_SENSING,
)
SUPPLY = VARIANTS["ideal"]

__all__ = ["SUPPLY", "VARIANTS"]
