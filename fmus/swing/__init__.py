"""Hydraulics of the swing motor."""

from fmus.contract import family
from fmus.swing import lumped

VARIANTS = family("swing", lumped=lumped.SWING)
SWING = VARIANTS["lumped"]

__all__ = ["SWING", "VARIANTS"]
