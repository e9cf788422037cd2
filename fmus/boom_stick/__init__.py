"""Boom and stick drives: hydraulics of the two cylinders.

`VARIANTS` are their models by fidelity (dynamics of hoses and valve spools); `BOOM_STICK` is the default,
lumped.
"""

from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path

from fmus import ports
from fmus.contract import Scalar, Subsystem, family
from fmus.drives import cylinder
from fmus.drives.compensated import COMPENSATED
from fmus.drives.cylinder import CYLINDER
from fmus.drives.detailed import detailed, lumps_of
from fmus.drives.drive import Additions, Axis, part
from fmus.drives.lumped import LUMPED
from fmus.drives.quasistatic import QUASISTATIC


class BoomInputs(cylinder.Inputs):
    """Command and motion of the boom's piston."""

    command: Scalar = ports.command("boom", "raises the boom", "command_rate")


class StickInputs(cylinder.Inputs):
    """Command and motion of the stick's piston."""

    command: Scalar = ports.command("stick", "folds the stick in", "command_rate")


VALUES = Path(__file__).with_name("parameters.toml")
AXES = (Axis("boom", CYLINDER, BoomInputs), Axis("stick", CYLINDER, StickInputs))
Lumps = int | Mapping[str, int] | None


def variants(additions: Additions = (), lumps: Lumps = None) -> dict[str, Subsystem]:
    """Models by fidelity.

    additions   of each axis
    lumps       of each hose of the detailed drives, one number or by axis; default: as many as it needs below
                75 Hz
    """
    axes = [replace(axis, additions=additions) for axis in AXES]
    make = partial(part, "boom_stick", axes, values=VALUES)
    by_axis = dict.fromkeys((axis.name for axis in axes), lumps) if isinstance(lumps, int) else lumps
    return family(
        "boom_stick",
        lumped=make(
            LUMPED,
            text="Hydraulic drives of boom and stick: spool valves, hoses, cylinders",
            validity="below 51 Hz, eq. (3) for the longest hose; spool faster than the motion",
        ),
        quasistatic=make(
            QUASISTATIC,
            text="Hydraulic drives of boom and stick without line dynamics: spool valves, cylinders",
            validity="motions slow compared with the oil in the hoses, below about 10 Hz;"
            " spool faster than the motion",
            stiff=False,
        ),
        detailed=make(
            detailed(lumps_of(VALUES) if by_axis is None else lambda axis: by_axis[axis.name]),
            text="Detailed hydraulic drives of boom and stick: spool dynamics, lines, air, relief valves",
            validity="modes of the hoses up to 75 Hz within 5 %; no flow forces on spools, one temperature",
        ),
        compensated=make(
            COMPENSATED,
            text="Hydraulic drives of boom and stick with compensated sections and counterbalance valves",
            validity="motions slow compared with compensators and the oil in the hoses, below about 10 Hz;"
            " no spool dynamics",
        ),
    )


VARIANTS = variants()
BOOM_STICK = VARIANTS["lumped"]


def with_lumps(lumps: int | Mapping[str, int]) -> Subsystem:
    """The detailed drives with so many lumps per hose."""
    return variants(lumps=lumps)["detailed"]


__all__ = ["BOOM_STICK", "VARIANTS", "with_lumps"]
