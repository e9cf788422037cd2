"""docs/control.md is enough to write the controller: its transcription agrees with the project."""

from types import SimpleNamespace as Group

import numpy as np
import pytest
from equations.controller_transcription import AXES, Arm, written
from hypothesis import given
from hypothesis import strategies as st
from kit.properties import examples
from kit.steering import OUTPUTS, PART, STATES, V


def drawn(rng: np.random.Generator, wide: float) -> tuple[dict, dict, dict]:
    """States, inputs and parameters: around a pose in the strokes, `wide` times the usual spread."""
    p = {n: v * rng.uniform(0.9, 1.1) for n, v in V.p.items()} | {"feedback": rng.choice([0.0, 0.5, 1.0])}
    p["learning"] = rng.choice([0.0, 0.5, 1.0])
    p["hysteresis"] *= rng.choice([0.0, 1.0])
    p["singular_share"] = rng.uniform(0, 0.8)  # the strokes end far from the singularity of the usual 0.2
    p |= {f"{n}_section_flow": rng.choice([0.0, rng.uniform(1e-3, 4e-3)]) for n in AXES}
    p |= {f"{n}_rod_section_flow": rng.choice([0.0, rng.uniform(1e-3, 4e-3)]) for n in AXES[1:]}
    angles = {"swing": rng.uniform(-7, 7), "boom": rng.uniform(-0.4, 0.95), "stick": rng.uniform(-2.1, -0.6)}
    u = {n: rng.uniform(-wide, wide) for n in V.u}
    u |= {f"{n}_angle": a for n, a in angles.items()}
    u |= {n: rng.uniform(-0.1, 1.1) * 20e6 for n in u if "pressure" in n} | {"tank_pressure": 2e5}
    u |= {"engaged": rng.choice([-0.2, 0.0, 0.4, 1.0, 1.3]), "follow": rng.choice([-0.2, 0.0, 0.7, 1.0, 1.2])}
    x = {n: 0.3 * wide * rng.normal() for n in V.x}
    x |= {f"reference_{n}": a + 0.02 * wide * rng.normal() for n, a in angles.items()}
    x |= {f"{n}_load": 5e4 * rng.normal() for n in AXES} | {"coordination": rng.uniform()}
    arm = Arm(x["reference_boom"], x["reference_stick"], Group(**p))
    u |= {"path_radius": arm.tip.real + 0.1 * wide * rng.normal()}
    u |= {"path_height": arm.tip.imag + 0.1 * wide * rng.normal()}
    u |= {"path_angle": x["reference_swing"] + 0.1 * wide * rng.normal()}
    u |= {f"{n}_lever": 20 * rng.uniform(-wide, wide) for n in AXES}
    return x, u, p


@examples(100)
@given(st.integers(0, 2**32 - 1), st.sampled_from([0.01, 0.1, 1.0, 3.0]))
def test_the_document_gives_the_controller(seed, wide):
    """Rates and outputs from the document are those of the subsystem, at any state, input and number."""
    x, u, p = drawn(np.random.default_rng(seed), wide)
    found = PART.function(list(x.values()), list(u.values()), list(p.values()))
    document = written(Group(**x), Group(**u), Group(**p))
    for names, got, expected in zip((STATES, OUTPUTS), found, document, strict=False):
        for name, value in zip(names, got.full()[:, 0], strict=True):
            # rounding, and two steps of Halley's method in the inverse of the valve's curve, good to 1e-9
            room = 1e-8 * max(1.0, abs(x.get(name, 1.0)))
            assert value == pytest.approx(expected[name], rel=1e-8, abs=room), name
