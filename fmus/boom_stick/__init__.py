"""Boom and stick drives: hydraulics of the two cylinders."""

from fmus.boom_stick import detailed, lumped, quasistatic
from fmus.contract import family

VARIANTS = family(
    "boom_stick", lumped=lumped.BOOM_STICK, quasistatic=quasistatic.BOOM_STICK, detailed=detailed.BOOM_STICK
)
BOOM_STICK = VARIANTS["lumped"]

__all__ = ["BOOM_STICK", "VARIANTS"]
