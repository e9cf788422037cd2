"""Hydraulic supply: ideal pressure source, or pumps and engine.

`VARIANTS` are these two models; `SUPPLY` is the default, the ideal source.
"""

from fmus.contract import family
from fmus.supply import engine_pump, ideal

VARIANTS = family("supply", ideal=ideal.IDEAL, engine_pump=engine_pump.ENGINE_PUMP)
SUPPLY = VARIANTS["ideal"]

__all__ = ["SUPPLY", "VARIANTS"]
