"""Every variant in its machine: started at a pose with the levers at rest, it stands."""

from __future__ import annotations

import numpy as np
import pytest
from kit.every import MACHINES

from fmus.machine.parts import parts, wiring
from fmus.machine.poses import POSES, parameter
from fmus.monolith import join, simulate
from fmus.parameters import values

STAND = 3.0  # s


@pytest.mark.parametrize("pose", ["nominal", "reach", "folded"])
@pytest.mark.parametrize("index", range(len(MACHINES)))
def test_a_machine_of_any_variants_stands_still(index, pose):
    """No piston moves farther than the leakage of its edges allows; the swing, which has no load, not at all.

    Each chamber gains or loses at most G_leak P t through its edges, with P the highest pressure around.
    """
    chosen = parts(**MACHINES[index])
    model = join(chosen, *wiring(chosen))
    p = model.p.copy()
    for joint in ("boom", "stick", "swing"):
        at = model.parameters.index(f"manipulator.{parameter(joint)}")
        p[at] = getattr(POSES[pose], joint)
    time = np.linspace(0.0, STAND, 61)
    _, y = simulate(model, time, np.tile(model.u, (time.size, 1)), p, tolerance=1e-10)
    shown = dict(zip(model.output_names, y.T, strict=True))
    numbers = values(chosen["boom_stick"]).p
    given = dict(zip(model.inputs, model.u, strict=True)).get("supply_pressure", 0.0)
    highest = max(given, *(np.max(v) for n, v in shown.items() if n.endswith("_pressure")))
    for joint in ("boom", "stick"):
        area = np.pi / 4 * (numbers[f"{joint}_bore"] ** 2 - numbers[f"{joint}_rod"] ** 2)
        bound = STAND * numbers["valve_leakage"] * highest / area
        assert bound < 0.3e-3  # m: small itself, so that this says something
        assert np.ptp(shown[f"manipulator.{joint}_position"]) < bound
    assert np.ptp(shown["manipulator.swing_angle"]) < 1e-9  # rad: rounding of gravity terms
