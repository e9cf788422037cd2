"""Boom and stick drives: hydraulics of the two cylinders.

`VARIANTS` are their models by fidelity (dynamics of hoses and valve spools); `BOOM_STICK` is the default,
lumped.
"""

from functools import partial
from pathlib import Path

from fmus import ports
from fmus.contract import Scalar
from fmus.drives import cylinder
from fmus.drives.cylinder import CYLINDER
from fmus.drives.drive import Axis
from fmus.drives.variants import variants as variants_of


class BoomInputs(cylinder.Inputs):
    """Command and motion of the boom's piston."""

    command: Scalar = ports.command("boom", "raises the boom", "command_rate")


class StickInputs(cylinder.Inputs):
    """Command and motion of the stick's piston."""

    command: Scalar = ports.command("stick", "folds the stick in", "command_rate")


VALUES = Path(__file__).with_name("parameters.toml")
AXES = (Axis("boom", CYLINDER, BoomInputs), Axis("stick", CYLINDER, StickInputs))
TEXTS = {
    "lumped": (
        "Hydraulic drives of boom and stick: spool valves, hoses, cylinders",
        "below 51 Hz, eq. (3) for the longest hose; spool faster than the motion",
    ),
    "quasistatic": (
        "Hydraulic drives of boom and stick without line dynamics: spool valves, cylinders",
        "motions slow compared with the oil in the hoses, below about 10 Hz; spool faster than the motion",
    ),
    "detailed": (
        "Detailed hydraulic drives of boom and stick: spool dynamics, lines, air, relief valves",
        "modes of the hoses up to 75 Hz within 5 %; no flow forces on spools, one temperature",
    ),
    "compensated": (
        "Hydraulic drives of boom and stick with compensated sections and counterbalance valves",
        "motions slow compared with compensators and the oil in the hoses, below about 10 Hz; no spool "
        "dynamics",
    ),
}
variants = partial(variants_of, "boom_stick", AXES, VALUES, TEXTS)
VARIANTS = variants()
BOOM_STICK = VARIANTS["lumped"]

__all__ = ["BOOM_STICK", "VARIANTS"]
