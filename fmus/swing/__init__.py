"""Swing drive: hydraulics of the swing motor.

`VARIANTS` are its models by fidelity (dynamics of lines and valve spool); `SWING` is the default, lumped.
"""

from functools import partial
from pathlib import Path

from fmus import ports
from fmus.contract import Quantity, Scalar
from fmus.drives import motor
from fmus.drives.drive import Axis
from fmus.drives.motor import MOTOR
from fmus.drives.variants import variants as variants_of


class Inputs(motor.Inputs):
    """Command and motion of the column; the rate inputs are exact time derivatives."""

    command: Scalar = ports.command("{}", "turns left", "command_rate")
    speed: Scalar = Quantity("rad/s", "Swing speed, counter-clockwise from above", 1.0, rate="acceleration")


def _named(parameter: str) -> str:
    """The parameters have no prefix, except two; that of the brake has a shorter name."""
    if parameter == "brake_holding_torque":
        return "brake_torque"
    return f"swing_{parameter}" if parameter in ("section_flow", "return_area") else parameter


VALUES = Path(__file__).with_name("parameters.toml")
AXES = (Axis("swing", MOTOR, Inputs, _named),)
TEXTS = {
    "lumped": (
        "Hydraulic swing drive: spool valve, lines, motor and gear",
        "lines laminar and short against the wavelength, below 200 Hz; spool faster than the motion",
    ),
    "quasistatic": (
        "Hydraulic swing drive without line dynamics: spool valve, motor and gear",
        "motions slow compared with the oil in the lines, below 10 Hz; spool faster than the motion; lines "
        "laminar",
    ),
    "detailed": (
        "Detailed hydraulic swing drive: spool dynamics, lines, motor and gear, air, relief valves",
        "modes of the lines up to 75 Hz within 5 %; no flow forces on the spool; one temperature; lines "
        "laminar (43 L/min at 60 degC)",
    ),
    "compensated": (
        "Hydraulic swing drive with a compensated section, crossover reliefs and holding brake",
        "motions slow compared with compensator and oil in the lines, below about 10 Hz; no spool dynamics; "
        "lines laminar",
    ),
}
variants = partial(variants_of, "swing", AXES, VALUES, TEXTS)
VARIANTS = variants()
SWING = VARIANTS["lumped"]

__all__ = ["SWING", "VARIANTS"]
