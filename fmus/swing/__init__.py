"""Swing drive: hydraulics of the swing motor.

`VARIANTS` are its models by fidelity (dynamics of lines and valve spool); `SWING` is the default, lumped.
"""

from dataclasses import replace
from functools import partial
from pathlib import Path

from fmus import ports
from fmus.contract import Quantity, Scalar, Subsystem, family
from fmus.drives import motor
from fmus.drives.compensated import COMPENSATED
from fmus.drives.detailed import detailed, lumps_of
from fmus.drives.drive import Additions, Axis, part
from fmus.drives.lumped import LUMPED
from fmus.drives.motor import MOTOR
from fmus.drives.quasistatic import QUASISTATIC


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


def variants(additions: Additions = (), lumps: int | None = None) -> dict[str, Subsystem]:
    """Models by fidelity.

    additions   of the axis
    lumps       of each line of the detailed drive; default: as many as it needs below 75 Hz
    """
    make = partial(part, "swing", [replace(axis, additions=additions) for axis in AXES], values=VALUES)
    return family(
        "swing",
        lumped=make(
            LUMPED,
            text="Hydraulic swing drive: spool valve, lines, motor and gear",
            validity="lines laminar and short against the wavelength, below 200 Hz;"
            " spool faster than the motion",
        ),
        quasistatic=make(
            QUASISTATIC,
            text="Hydraulic swing drive without line dynamics: spool valve, motor and gear",
            validity="motions slow compared with the oil in the lines, below 10 Hz;"
            " spool faster than the motion; lines laminar",
            stiff=False,
        ),
        detailed=make(
            detailed(lumps_of(VALUES) if lumps is None else lambda _: lumps),
            text="Detailed hydraulic swing drive: spool dynamics, lines, motor and gear, air, relief valves",
            validity="modes of the lines up to 75 Hz within 5 %; no flow forces on the spool;"
            " one temperature; lines laminar (43 L/min at 60 degC)",
        ),
        compensated=make(
            COMPENSATED,
            text="Hydraulic swing drive with a compensated section, crossover reliefs and holding brake",
            validity="motions slow compared with compensator and oil in the lines, below about 10 Hz;"
            " no spool dynamics; lines laminar",
        ),
    )


VARIANTS = variants()
SWING = VARIANTS["lumped"]


def with_lumps(lumps: int) -> Subsystem:
    """The detailed drive with so many lumps per line."""
    return variants(lumps=lumps)["detailed"]


__all__ = ["SWING", "VARIANTS", "with_lumps"]
