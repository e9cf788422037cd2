"""Boom and stick from a look-up table: what a test bench measured, in place of equations.

    flow = map(command, force / area)                    into the head side of the cylinder [m3/s]
    d force / dt = stiffness (flow / area - velocity)    the oil between valve and piston is a spring

Signs are those of the drives that it stands for: a positive command, force or velocity extends the cylinder.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
from scipy.interpolate import RectBivariateSpline

from fmus.boom_stick import BOOM_STICK
from fmus.contract import Quantity
from fmus.export.python import Model, subgroup
from fmus.parameters import values

TABLE = np.loadtxt(Path(__file__).with_name("valve_map.csv"), delimiter=",")
FLOW = RectBivariateSpline(TABLE[1:, 0], TABLE[0, 1:], TABLE[1:, 1:], kx=1, ky=1)  # straight lines between


@dataclass(frozen=True)
class Parameters:
    boom_area: Annotated[float, Quantity("m2", "Head side of the boom piston", 1e-2)] = 11.31e-3
    stick_area: Annotated[float, Quantity("m2", "Head side of the stick piston", 1e-2)] = 10.39e-3
    boom_stiffness: Annotated[float, Quantity("N/m", "Oil of the boom cylinder at mid-stroke", 1e8)] = 8.9e7
    stick_stiffness: Annotated[float, Quantity("N/m", "Oil of the stick cylinder at mid-stroke", 1e8)] = 6.8e7
    area_ratio: Annotated[float, Quantity("1", "Rod side over head side")] = 0.65


# Wires of the machine find what they look for: names and units are those of the drives.
FORCES = "boom_force", "stick_force"
State = subgroup("State", BOOM_STICK.outputs, *FORCES)
Outputs = subgroup(
    "Outputs", BOOM_STICK.outputs, *FORCES, *(f"{f}_rate" for f in FORCES), "supply_flow", "return_flow"
)


class MyActuator(Model):
    """Boom and stick from a look-up table"""

    Parameters, State, Inputs, Outputs = Parameters, State, BOOM_STICK.inputs, Outputs
    start = values(BOOM_STICK).u  # the inputs start as those of the drives that it stands for
    files = ("valve_map.csv",)
    inner_step = 2.5e-4
    depends = {
        **{f"{a}_force": [f"{a}_holding_force"] for a in ("boom", "stick")},
        **{f"{a}_force_rate": [f"{a}_command", f"{a}_velocity"] for a in ("boom", "stick")},
        **{f"{line}_flow": ["boom_command", "stick_command"] for line in ("supply", "return")},
    }

    def flows(self, x, u, p):
        return (
            FLOW.ev(u.boom.command, x.boom_force / p.boom_area),
            FLOW.ev(u.stick.command, x.stick_force / p.stick_area),
        )

    def rates(self, x, u, p):
        boom, stick = self.flows(x, u, p)
        return (
            p.boom_stiffness * (boom / p.boom_area - u.boom.velocity),
            p.stick_stiffness * (stick / p.stick_area - u.stick.velocity),
        )

    def initial(self, x, u, p):
        return {"boom_force": u.boom.holding_force, "stick_force": u.stick.holding_force}

    def step(self, x, u, p, t, h):
        boom_rate, stick_rate = self.rates(x, u, p)
        return State(x.boom_force + h * boom_rate, x.stick_force + h * stick_rate)

    def observe(self, x, u, p, t):
        flows = self.flows(x, u, p)
        extending, retracting = sum(max(q, 0.0) for q in flows), sum(max(-q, 0.0) for q in flows)
        supply = extending + p.area_ratio * retracting
        back = retracting + p.area_ratio * extending
        return Outputs(x.boom_force, x.stick_force, *self.rates(x, u, p), supply, back)
