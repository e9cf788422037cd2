"""Swing drive: hydraulics of the swing motor.

`VARIANTS` are its models by fidelity (dynamics of lines and valve spool); `SWING` is the default, lumped.
"""

from fmus.contract import family
from fmus.swing import compensated, detailed, lumped, quasistatic

VARIANTS = family(
    "swing",
    lumped=lumped.SWING,
    quasistatic=quasistatic.SWING,
    detailed=detailed.SWING,
    compensated=compensated.SWING,
)
SWING = VARIANTS["lumped"]

__all__ = ["SWING", "VARIANTS"]
