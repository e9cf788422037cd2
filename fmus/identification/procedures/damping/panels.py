"""Figure 9: resistance over speed with the line, its residual, and B over the length of the filter."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from fmus.identification.finding import Curve, Panel
from fmus.identification.procedures.damping.joint import JointDamping
from fmus.identification.procedures.shared.regression import WIDTH

CLOUD = 1500  # points that are drawn


def panels(found: Sequence[JointDamping]) -> tuple[Panel, ...]:
    """Three for each joint."""
    return tuple(panel for one in found for panel in (*_line(one), _filters(one)))


def _line(one: JointDamping) -> tuple[Panel, Panel]:
    step = max(1, len(one.speed) // CLOUD)
    x, a = one.speed[::step], one.resistance[::step]
    ends = np.array([x.min(), x.max()])
    line = Panel(
        x_label=one.contact.speed,
        y_label=one.contact.resistance,
        curves=(Curve("a, measured", x, a), Curve("B x'", ends, one.value * ends, "fit", line=True)),
        title=one.contact.joint,
        x_unit=(one.contact.speed_unit, 1.0),
        y_unit=(one.contact.resistance_unit, 1.0),
    )
    residual = (Curve("a - B x'", x, a - one.value * x),)
    return line, replace(line, y_label="residual", curves=residual, title="")


def _filters(one: JointDamping) -> Panel:
    x = np.array([plain.window for plain in one.plain])
    ends = np.array([x[0], x[-1]])
    curves = (
        Curve("(13), a at every sample", x, np.array([p.value for p in one.plain]), "compared", line=True),
        Curve("(13), noise taken off", x, np.array([p.corrected for p in one.plain]), "corrected", line=True),
        Curve("this estimate", ends, np.full(2, one.value), "fit", True, np.full(2, WIDTH * one.sd)),
    )
    return Panel(
        x_label=f"length of the {one.contact.joint}'s derivative filter",
        y_label="B",
        curves=curves,
        x_unit=("s", 1.0),
        y_unit=(one.contact.unit, 1.0),
    )
