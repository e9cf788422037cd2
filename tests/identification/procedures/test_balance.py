"""The balance of all procedures: its equation of motion, filters, noise and known parameters."""

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from equations import transcription
from hypothesis import given
from hypothesis import strategies as st
from identification.procedures.bench import changed
from identification.procedures.lumped_machine import P, V, recording

from fmus.contract import quantities, symbolic
from fmus.identification.balance import linearised, modulating_function, solve
from fmus.identification.procedures import momentum_balance
from fmus.identification.procedures.momentum_balance import DRY, OFFSET, PARAMETERS
from fmus.manipulator import MANIPULATOR
from orchestrator.data.recording import Sensor

MACHINE = transcription.Machine(transcription.numbers())


def hydraulics(pressures, speed):
    """Swing torque and cylinder forces by the second writing of the equations: areas times pressures."""
    p1, p2 = transcription.motor(MACHINE.swing, *pressures[:2], 0.0, speed)
    forces = []
    for p, head, rod in zip(MACHINE.hydraulic, pressures[2::2], pressures[3::2], strict=True):
        on_head, on_rod = transcription.areas(p)
        forces.append(on_head * head - on_rod * rod)
    return V["motor_displacement"] * V["gear_ratio"] * (p1 - p2), *forces


def test_the_balance_is_the_machine_s_equation_of_motion():
    """With the accelerations of the manipulator's own dynamics f - dh/dt is zero at any state."""
    e, a = momentum_balance.HARVESTER.equations, ca.SX.sym("a", 3)
    rate = ca.jtimes(e.momentum, e.q, e.w) + ca.jtimes(e.momentum, e.w, a)
    balance = ca.Function("balance", [e.q, e.w, a, e.pressures, e.tank, e.p], [e.force - rate])
    model, random = symbolic(MANIPULATOR).function(), np.random.default_rng(1)
    own = [V[n] for n in quantities(MANIPULATOR.parameters)]
    for _ in range(50):
        q = random.uniform([-3.0, -0.4, -2.1], [3.0, 1.0, -0.7])
        w, pressures = random.uniform(-1.0, 1.0, 3), random.uniform(0.0, 2e7, 6)
        torque, boom, stick = hydraulics(pressures, w[0])
        u = dict.fromkeys(quantities(MANIPULATOR.inputs), 0.0)
        u |= {"swing_torque": torque, "boom_force": boom, "stick_force": stick}
        dx, _ = model([*q, *w, 0.0, 0.0], list(u.values()), own)  # without a payload
        left = balance(q, w, dx.full()[3:6, 0], pressures, 0.0, P).full()
        # rounding of torques up to 1e5 N.m, times the condition of M, below 1e3
        assert np.abs(left).max() < 1e-6


@given(st.floats(0.2, 3.0), st.floats(0.0, 6.0))
def test_the_bump_and_its_slope_are_one_filter(frequency, phase):
    """-phi' * sin equals phi * its derivative: the time derivative is moved to the window."""
    bump, slope = modulating_function(31, 200.0)
    rate = 2 * np.pi * frequency
    x = rate * np.arange(61) / 200 + phase
    # sums in the place of integrals: 1e-5 of the amplitude at 1 Hz, growing with its square
    tolerance = 1.5e-5 * max(frequency, 1.0) ** 2 * rate
    assert slope @ np.sin(x) == pytest.approx(rate * bump @ np.cos(x), abs=tolerance)


DAMPING = {"boom": "manipulator.boom_piston_damping", "stick": "manipulator.stick_piston_damping"}


def prepared(record, joint, p=P):
    """A recording for the balance of a piston."""
    return momentum_balance.joint_samples(record, joint, (DAMPING[joint],), p)


def found(record, joint, p=P):
    """B of a piston."""
    start = {DAMPING[joint]: 1e4, DRY: 0.0, OFFSET: 0.0}
    return solve([prepared(record, joint, p)], start, joint, tested=(DRY, OFFSET))


def test_the_effect_of_noise_is_the_derivative_by_each_sample():
    """e at samples with a small change is e plus G times the change, over all sensors and filters."""
    s = prepared(recording("boom", length=4.0), "boom")
    theta, change = np.array([2e4, 0.0, 0.0]), np.random.default_rng(1).standard_normal(s.raw.shape)
    change *= np.array([1e-7] * 3 + [1.0] * 6)[:, None]  # rad, Pa
    up, middle, down = (linearised(s, s.raw + k * change, theta) for k in (1, 0, -1))
    by_g = middle.times(change)[None]
    # central difference: rounding 1e-16 of moments of 1e5 N.m over changes of a few N.m
    np.testing.assert_allclose((up.e - down.e) / 2, by_g, rtol=1e-5, atol=1e-7 * np.abs(by_g).max())


# the joint's own encoder: attenuation; the swing's: centrifugal torque of its noise squared
@pytest.mark.parametrize(("joint", "noisy"), [("boom", "boom"), ("stick", "swing")])
def test_noise_of_an_encoder_does_not_bias_the_damping(joint, noisy):
    """A noise of 1 mrad: errors are as large as their standard deviations, and have no common part."""
    sd, name, z = 1e-3, f"manipulator.{noisy}_angle", []
    for seed in range(8):
        plain = recording(joint, seed=seed, length=10.0)
        noise = sd * np.random.default_rng([seed, 3]).standard_normal(plain.time.size)
        sensors = {**plain.sensors, name: Sensor("coarse", sd)}
        fit = found(replace(changed(plain, {name: plain[name] + noise}), sensors=sensors), joint).fit
        z.append((fit.values[0] - V[DAMPING[joint].partition(".")[2]]) / fit.sd(DAMPING[joint]))
    # the mean and the mean square of 8 normal errors, four standard deviations; seeds are fixed
    assert abs(np.mean(z)) < 4 / np.sqrt(8)
    assert np.mean(np.square(z)) < 1 + 4 * np.sqrt(2 / 8)


@pytest.mark.parametrize("name", ["boom_stick.boom_bore", "manipulator.head_mass", "manipulator.boom_pin_x"])
def test_sensitivity_to_a_known_parameter_is_that_of_two_estimates(name):
    """Sensitivity of B against estimates with the parameter changed in both directions."""
    boom, index = recording("boom", seed=1), PARAMETERS.index(name)
    step = 1e-4 * P * (np.arange(P.size) == index)
    up, down = (found(boom, "boom", P + sign * step).fit.values[0] for sign in (1, -1))
    difference = (up - down) / (2 * step[index])
    # noise in the regressor has a share of 1 % of the estimate, whose change it does not know
    assert found(boom, "boom").by_known()[0, index] == pytest.approx(difference, rel=0.03)
