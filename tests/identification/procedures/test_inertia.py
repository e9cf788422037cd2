"""Inertial parameters: true values come back, what the motion does not determine keeps its value."""

from dataclasses import replace

import numpy as np
import pytest
from identification.procedures.lumped_machine import KNOWN, PRESSURE, V, recording
from kit.equations import JOINTS
from kit.mistakes import problem

from fmus.identification.procedures.inertia import FREE, identify


def test_masses_and_inertias_are_within_their_intervals():
    """All joints at once, six seeds: each value within 10 %, errors match the standard deviations."""
    z = []
    for seed in range(6):
        result = identify([recording(*JOINTS, seed=seed)], KNOWN)
        assert [e.name for e in result.estimates] == list(FREE)
        z.append([(e.value - V[e.name]) / e.sd for e in result.estimates])
        for e in result.estimates:
            assert e.value == pytest.approx(V[e.name], rel=0.1)
    # those of one seed are correlated; 3.9 standard deviations are 1 in 1e4, seeds are fixed
    assert np.abs(z).max() < 3.9
    # mean square of 24: chance is wider than chi-square for correlated ones
    assert 0.3 < np.mean(np.square(z)) < 2.2


def test_an_error_of_a_damping_does_not_bias_the_inertia():
    """Dampings known as nearly zero are estimated as well; the head's mass hardly changes."""
    record = recording(*JOINTS, seed=1)
    found = ("swing_damping", "boom_piston_damping", "stick_piston_damping")
    wrong = {f"manipulator.{n}": replace(KNOWN[f"manipulator.{n}"], value=1.0) for n in found}
    right, other = (identify([record], known).estimates for known in (KNOWN, KNOWN | wrong))
    for a, b in zip(right, other, strict=True):
        assert b.value == pytest.approx(a.value, rel=1e-3)  # weights of the joints: second order


def test_undetermined_parameters_keep_their_value():
    """With much more noise gravity determines only the head's mass; remarks list the other parameters."""
    rough = replace(PRESSURE, noise=100 * PRESSURE.noise, low=-np.inf, high=np.inf)
    result = identify([recording(*JOINTS, seed=1, pressure=rough)], KNOWN)
    names = {e.name for e in result.estimates}
    assert "head_mass" in names
    assert "stick_inertia" not in names
    for name in set(FREE) - names:
        assert any(text.startswith(f"{name}: this motion does not determine") for text in result.remarks)


def test_without_a_motion_it_is_refused():
    """One line with the procedures of the recordings."""
    bench = replace(recording("boom"), procedure="valve")
    problem(lambda: identify([bench], KNOWN), 'with use = "train", got valve')
