"""Pumps and engine that feed the supply line."""

from fmus.contract import family
from fmus.supply import ideal

VARIANTS = family("supply", ideal=ideal.IDEAL)
SUPPLY = VARIANTS["ideal"]

__all__ = ["SUPPLY", "VARIANTS"]
