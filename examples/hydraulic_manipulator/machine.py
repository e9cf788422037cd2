"""The machine: the two subsystems, their wires, the FMUs made of them and the ODE they form together."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from arm import ARM
from hydraulics import HYDRAULICS
from numpy.typing import NDArray

from fmus.contract import Subsystem, quantities
from fmus.export.build import build_all
from fmus.monolith import join, merge_times, simulate
from orchestrator.data.trace import Trace
from orchestrator.ssp.load import assemble
from orchestrator.ssp.write import write_ssp

Array = NDArray[np.float64]
Wires = tuple[tuple[str, str], ...]

SUBSYSTEMS: Mapping[str, Subsystem] = {s.name: s for s in (HYDRAULICS, ARM)}

# the power port: force one way, motion the other
SIGNALS: Wires = (
    ("hydraulics.force", "arm.force"),
    ("arm.s1", "hydraulics.s1"),
    ("arm.s1_dot", "hydraulics.s1_dot"),
)

# rate ports: the exact time derivatives of force and velocity, optional
RATES: Wires = (
    ("hydraulics.force_rate", "arm.force_rate"),
    ("arm.s1_ddot", "hydraulics.s1_ddot"),
)

# used only to initialise: pressures that hold the arm
HOLDING: Wires = (("arm.holding_force", "hydraulics.holding_force"),)

INPUTS: Mapping[str, tuple[str, ...]] = {"kappa": ("hydraulics.kappa",)}


def build(folder: Path) -> dict[str, Path]:
    """Write both FMUs and two systems of them; returns the systems by name.

    rates   with the wires of `RATES`: force and velocity move inside a communication step
    held    without them: force and velocity stand still inside a communication step, as in most tools
    """
    fmus = dict(zip(SUBSYSTEMS, build_all(list(SUBSYSTEMS.values()), {2: folder})[2], strict=True))
    wires = {"rates": SIGNALS + RATES + HOLDING, "held": SIGNALS + HOLDING}
    return {
        name: write_ssp(
            assemble(fmus, w, name="hydraulic_manipulator", inputs=INPUTS, stop=10.0, step=1e-3),
            folder / f"hydraulic_manipulator_{name}.ssp",
        )
        for name, w in wires.items()
    }


def solve(manoeuvre: Trace, time: Array) -> Trace:
    """The joined ODE at times [s], shape (n,), to a tolerance of 1e-12: what a co-simulation should give.

    kappa is linear between the samples of the manoeuvre, which count as times of their own.
    """
    corners = manoeuvre.time[(manoeuvre.time > time[0]) & (manoeuvre.time < time[-1])]
    grid = merge_times(time, corners)
    model = join(SUBSYSTEMS, SIGNALS + RATES + HOLDING, INPUTS)
    _, outputs = simulate(model, grid, manoeuvre.at(grid)["kappa"][:, None])
    sampled = outputs[np.searchsorted(grid, time)].T
    units = {f"{n}.{v}": q.unit for n, s in SUBSYSTEMS.items() for v, q in quantities(s.outputs).items()}
    return Trace(time, dict(zip(model.output_names, sampled, strict=True)), units)
