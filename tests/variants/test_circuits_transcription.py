"""Compensated drives and load-sensing pump obey docs/equations.md: a second writing of its sections."""

import numpy as np
import pytest
from equations import circuits_transcription as printed
from kit.equations import EDGES, random_curve

from fmus.contract import quantities, symbolic
from fmus.machine.parts import FAMILIES
from fmus.parameters import values

CASES = {
    "swing": ("compensated", printed.swing),
    "boom_stick": ("compensated", printed.boom_stick),
    "supply": ("load_sensing", printed.supply),
}
# numbers that are zero by choice get a size in every second case, so that a wrong term with them shows
ZEROS = {"line_turbulent_resistance": 1e10, "counterbalance_back_pressure_share": 1.0}
ZEROS |= {"reservoir_pressure": 3e5}


def random_numbers(rng, own):
    """All parameters, each moved by up to 20 %, and curves of the edges."""
    p = {n: v * rng.uniform(0.8, 1.2) for n, v in own.items()}
    p |= {n: size * rng.random() * rng.integers(0, 2) for n, size in ZEROS.items() if n in p}
    if "anti_cavitation_rounding" in p:  # the default range is too short to meet
        p["anti_cavitation_rounding"] *= rng.choice([1.0, 300.0])
    for edge in EDGES:
        p |= {n: v for n, v in random_curve(rng, f"valve_{edge}").items() if n in own}
    return p


def drawn(rng, name, nominal):
    """A state or an input: in and beyond the working range, voids, open reliefs, broken supply."""
    ranges = {"opening": (0, 1), "applied": (0, 1), "stroke": (0, 1), "position": (0, 0.6)}
    ranges |= {"temperature": (200, 450)} | ({"speed": (0, 300)} if name == "engine_speed" else {})
    kind = name.rpartition("_")[2]
    if name == "tank_pressure":
        return rng.uniform(-1e5, 1e6)
    if kind == "command":
        return rng.choice([rng.uniform(-11.0, 11.0), rng.uniform(-0.7, 0.7)])
    if kind == "pressure" or ("_pressure_" in name and kind in "ab"):
        return rng.uniform(-3e5, 1e5) if rng.random() < 0.2 else rng.uniform(0.0, 3e7)
    return rng.uniform(*ranges[kind]) if kind in ranges else rng.normal() * nominal


@pytest.mark.parametrize("part", CASES)
def test_right_hand_sides_and_observables_are_those_of_the_document(part):
    """At random parameters, states and inputs both writings give the same rates, flows, loads and forces."""
    variant, writing = CASES[part]
    sub = FAMILIES[part][variant]
    own, f, rng = values(sub).p, symbolic(sub).function(), np.random.default_rng(46)
    states, inputs, outputs = (quantities(g) for g in (sub.states, sub.inputs, sub.outputs))
    for _ in range(200):
        p = random_numbers(rng, own)
        x, u = ({n: drawn(rng, n, q.nominal) for n, q in group.items()} for group in (states, inputs))
        if part != "supply" and rng.random() < 0.4:  # where setting, saturation and check valve meet
            most = max(v for n, v in x.items() if "pressure" in n)
            u |= {n: most * rng.uniform(0.95, 1.1) for n in ("supply_pressure", "load_sensing_pressure")}
        dx, y = (v.full()[:, 0] for v in f(list(x.values()), list(u.values()), list(p.values())))
        rates, seen = writing(p, x, u)
        assert set(rates) == set(states)
        for ours, column, group in ((rates, dx, states), (seen, y, outputs)):
            found = dict(zip(group, column, strict=True))
            for name, value in ours.items():
                # same equations, other order of rounding; differences of flows that nearly cancel
                assert value == pytest.approx(found[name], rel=1e-9, abs=1e-9 * group[name].nominal), name
