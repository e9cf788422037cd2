"""Boom and stick drives: hydraulics of the two cylinders.

`VARIANTS` are their models by fidelity (dynamics of hoses and valve spools); `BOOM_STICK` is the default,
lumped.
"""

from fmus.boom_stick import compensated, detailed, lumped, quasistatic
from fmus.contract import family

VARIANTS = family(
    "boom_stick",
    lumped=lumped.BOOM_STICK,
    quasistatic=quasistatic.BOOM_STICK,
    detailed=detailed.BOOM_STICK,
    compensated=compensated.BOOM_STICK,
)
BOOM_STICK = VARIANTS["lumped"]

__all__ = ["BOOM_STICK", "VARIANTS"]
