"""Swing drive: hydraulics of the swing motor."""

from fmus.contract import family
from fmus.swing import detailed, lumped, quasistatic

VARIANTS = family("swing", lumped=lumped.SWING, quasistatic=quasistatic.SWING, detailed=detailed.SWING)
SWING = VARIANTS["lumped"]

__all__ = ["SWING", "VARIANTS"]
