"""The benchmark M1 of examples/hydraulic_manipulator, with an FMU that plays its valve position."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from fmus.contract import Quantity, Scalar, Subsystem, make_group
from fmus.export.build import build_all
from fmus.parameters import with_parameters
from orchestrator import read_trace, run
from orchestrator.ssp.load import assemble
from orchestrator.ssp.write import write_ssp

EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "hydraulic_manipulator"
STOP = 10.0  # s


def build(folder: Path) -> Path:
    """Write m1.ssp: rate ports connected, pressures at the start as parameters, because not every tool
    exchanges signals before the first step."""
    if str(EXAMPLE) not in sys.path:
        sys.path.insert(0, str(EXAMPLE))  # the example is a script, not an installed package
    from machine import RATES, SIGNALS, SUBSYSTEMS
    from machine import build as build_example

    first = run(build_example(folder / "m1")["rates"], EXAMPLE / "m1.csv", step=1e-3, stop=1e-3)
    holding = {"hydraulics.holding_force": first["arm.holding_force"][0]}
    hydraulics = with_parameters(SUBSYSTEMS["hydraulics"], {}, holding)
    parts = [hydraulics, SUBSYSTEMS["arm"], _valve()]
    fmus = {p.name: f for p, f in zip(parts, build_all(parts, {2: folder}, stop=STOP)[2], strict=True)}
    wires = (*SIGNALS, *RATES, ("valve.kappa", "hydraulics.kappa"))
    return write_ssp(assemble(fmus, wires, stop=STOP, step=1e-3), folder / "m1.ssp")


def _valve() -> Subsystem:
    """Straight lines through the rows of m1.csv."""
    rows = read_trace(EXAMPLE / "m1.csv")
    time, kappa = rows.time, rows["kappa"]

    def observe(x: Any, _u: Any, _p: Any) -> Any:
        value: Scalar = kappa[0]
        for k in np.flatnonzero(np.diff(kappa)):
            share = ca.fmin(ca.fmax((x.clock - time[k]) / (time[k + 1] - time[k]), 0), 1)
            value = value + (kappa[k + 1] - kappa[k]) * share
        return outputs(kappa=value)

    def next_event(x: Any, _u: Any, _p: Any) -> Scalar:
        remaining: Scalar = np.inf
        for corner in time[1:-1][::-1]:
            remaining = ca.if_else(x.clock + 1e-9 < corner, corner - x.clock, remaining)
        return remaining

    none = {n: make_group(n, {}) for n in ("ValveParameters", "ValveInputs")}
    state = make_group("ValveState", {"clock": Quantity("s", "Time")})
    outputs = make_group("ValveOutputs", {"kappa": Quantity("1", "Valve position")})
    groups = (none["ValveParameters"], state, none["ValveInputs"], outputs)
    text = "Valve position of the manoeuvre M1"
    return Subsystem(
        "valve", text, *groups, lambda *_: state(clock=1), observe, next_event=next_event, stiff=False
    )
