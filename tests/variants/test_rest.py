"""Every variant in its machine: started at a pose with the levers at rest, it stands."""

import numpy as np
import pytest
from kit import shards
from kit.equations import in_pose, machine, piston_areas, played
from kit.every import MACHINES

from fmus.machine.parts import FAMILIES, FERIC
from fmus.parameters import values

STAND = 1.0  # s
POSES = ("nominal", "reach", "folded")
# each machine in one pose, each pose twice
CASES = [
    pytest.param(i, pose, marks=() if i % 3 == k else shards.machine)
    for i in range(len(MACHINES))
    for k, pose in enumerate(POSES)
]


def test_machines_hold_every_variant():
    """The machines of the suite leave no variant out."""
    met = {(part, m.get(part, next(iter(variants)))) for m in MACHINES for part, variants in FAMILIES.items()}
    assert met == {(part, v) for part, variants in FAMILIES.items() for v in variants}


@pytest.mark.parametrize(("index", "pose"), CASES)
def test_a_machine_of_any_variants_stands_still(index, pose):
    """No piston moves farther than the leakage of its edges allows; the swing, which has no load, not at all.

    Each chamber gains or loses at most G_leak P t through its edges, with P the highest pressure around.
    """
    model = machine(**MACHINES[index])
    shown = played(model, np.linspace(0.0, STAND, 21), {}, in_pose(model, pose), tolerance=1e-10)
    numbers = values(FERIC.chosen(**MACHINES[index])["boom_stick"]).p
    given = dict(zip(model.inputs, model.u, strict=True)).get("supply_pressure", 0.0)
    highest = max(given, *(np.max(v) for n, v in shown.items() if n.endswith("_pressure")))
    for joint in ("boom", "stick"):
        bound = STAND * numbers["valve_leakage"] * highest / piston_areas(numbers, joint)[1]
        assert bound < 0.1e-3  # m: small itself, so that this says something
        assert np.ptp(shown[f"manipulator.{joint}_position"]) < bound
    assert np.ptp(shown["manipulator.swing_angle"]) < 1e-9  # rad: rounding of gravity terms
