"""Torque that the free parameters have to explain, measured and by the parameters found, for each joint."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from fmus.identification.finding import Curve, Panel
from fmus.identification.procedures.balance.motion import JOINTS
from fmus.identification.procedures.balance.samples import Samples
from fmus.identification.procedures.balance.solution import Solution

TORQUE = ("kN.m", 1e3)
STEP = 3  # samples from one drawn point to the next


def panels(records: Sequence[Samples], solution: Solution) -> tuple[Panel, ...]:
    """Two for each joint, over the time of the first recording."""
    s, e = records[0], solution.equations[0]
    asked = -np.einsum("mrt,m->rt", e.slope, solution.values + solution.mean_effect)
    found = []
    for row, joint in enumerate(JOINTS):
        t, model, left = (x[s.good][::STEP] for x in (s.time[s.middle], asked[row], e.error[row]))
        torque = Panel(
            x_label=f"time, {joint}",
            y_label="torque",
            curves=(
                Curve("measured, filtered, less what is known", t, model + left, line=True),
                Curve("by the parameters found", t, model, "fit", line=True),
            ),
            title=joint,
            x_unit=("s", 1.0),
            y_unit=TORQUE,
        )
        rest = (Curve("measured - model", t, left, line=True),)
        found += [torque, replace(torque, y_label="residual", curves=rest, title="", y_unit=("N.m", 1.0))]
    return tuple(found)
