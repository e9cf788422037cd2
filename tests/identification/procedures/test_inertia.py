"""Inertial parameters: the regressor against Pinocchio, base parameters, true values come back."""

from dataclasses import replace

import numpy as np
import pytest
from equations.test_rigid_body import arm
from identification.procedures.lumped_machine import KNOWN, PRESSURE, P, V, gravity, recording
from kit.equations import JOINTS
from kit.mistakes import problem

from fmus.identification.procedures.inertia import FREE, STANDARD, grouping, identify, regressor, standard


def states(count=30):
    """Angles, speeds, accelerations (3,)."""
    random = np.random.default_rng(7)
    for _ in range(count):
        yield random.uniform(-np.pi, np.pi, 3), random.uniform(-1, 1, 3), random.uniform(-1, 1, 3)


def by_pinocchio(pin, q, w, a):
    """Torques by our standard parameters from Pinocchio's regressor of a tree with the same joints."""
    tree, data = arm(pin, V)
    y = pin.computeJointTorqueRegressor(tree, data, q, w, a)
    column, boom, stick = (y[:, 10 * k : 10 * k + 10] for k in range(3))
    # theirs: m, m x, m y, m z, I_xx, I_xy, I_yy, I_xz, I_yz, I_zz about the joint
    found = [column[:, 9]]
    for link in (boom, stick):
        found += [link[:, 0], link[:, 1], link[:, 3]]  # m, m x, m z
        found += [link[:, 6] + link[:, 9], -link[:, 7], link[:, 4] + link[:, 6]]  # S_xx, S_xz, S_zz
    return np.column_stack(found)


def test_the_regressor_is_pinocchio_s():
    """Derivatives of the manipulator's equations against an independent algorithm."""
    pin = pytest.importorskip("pinocchio", reason="Pinocchio is installed on Linux only")
    for q, w, a in states():
        ours = regressor()(q, w, a, P)[2].full()
        # exact identity; rounding of terms up to 1e2
        np.testing.assert_allclose(ours, by_pinocchio(pin, q, w, a), rtol=1e-9, atol=1e-10)


def test_base_parameters_give_the_same_torques_as_the_standard_ones():
    """11 of 13: the mass of the boom acts as inertia of the column, that of the stick on boom and column."""
    group = grouping(P)
    assert [STANDARD[k] for k in group.others] == ["boom m", "stick m"]
    assert len(group.kept) == 11
    pi = np.random.default_rng(8).uniform(1.0, 1e3, len(STANDARD))
    for q, w, a in states():
        y = regressor()(q, w, a, P)[2].full()
        # exact identity; rounding of torques up to 1e5
        np.testing.assert_allclose(y[:, list(group.kept)] @ group.values(pi), y @ pi, rtol=1e-9, atol=1e-6)


def test_standard_parameters_give_the_manipulator_s_torques():
    """Regressor times standard parameters: at rest the torques of gravity, by hand."""
    for q, _, _ in states():
        zero = np.zeros(3)
        torque = regressor()(q, zero, zero, P)[2].full() @ standard(P)
        # exact identity; rounding of torques up to 4e4
        np.testing.assert_allclose(torque, [0.0, *gravity(q[1], q[2])], rtol=1e-10, atol=1e-8)


def test_masses_and_inertias_are_within_their_intervals():
    """All joints at once, six seeds: each value within 10 %, errors match the standard deviations."""
    z, base = [], []
    group = grouping(P)
    true = group.values(standard(P))
    for seed in range(6):
        result = identify([recording(*JOINTS, seed=seed)], KNOWN)
        assert [e.name for e in result.estimates] == list(FREE)
        z.append([(e.value - V[e.name]) / e.sd for e in result.estimates])
        for e in result.estimates:
            assert e.value == pytest.approx(V[e.name], rel=0.1)
        found = [e for e in result.others if "base parameter" in e.note]
        assert len(found) == len(true)
        base.append([(e.value - x) / e.sd for e, x in zip(found, true, strict=True)])
    # those of one seed are correlated; 3.9 standard deviations are 1 in 1e4, seeds are fixed
    assert np.abs(z).max() < 3.9
    assert np.abs(base).max() < 3.9
    # mean squares of 24 and 66: chance is wider than chi-square for correlated ones
    assert 0.3 < np.mean(np.square(z)) < 2.2
    assert 0.4 < np.mean(np.square(base)) < 1.9


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
