"""Momentum balance: the equation, its filters, the effect of noise and of known parameters."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from identification.procedures.bench import changed
from identification.procedures.lumped_machine import P, V, recording

from fmus.contract import quantities, symbolic
from fmus.identification.procedures.momentum_balance import (
    PARAMETERS,
    equation_of_motion,
    filters,
    smoothed_recording,
)
from fmus.identification.procedures.momentum_fit import solve
from fmus.manipulator import MANIPULATOR
from orchestrator.data.recording import Sensor


def hydraulics(pressures, speed):
    """Swing torque and cylinder forces by hand: the 2x2 node system of the motor, areas times pressures."""
    g, g_in, g_ex = (
        1 / V[n] for n in ("line_resistance", "internal_leakage_resistance", "external_leakage_resistance")
    )
    d = V["motor_displacement"] * V["gear_ratio"]
    a, b, *cylinders = pressures
    nodes = [[g + g_in + g_ex, -g_in], [-g_in, g + g_in + g_ex]]
    p1, p2 = np.linalg.solve(nodes, [g * a - d * speed, g * b + d * speed])
    forces = []
    for name, head, rod in (("boom", *cylinders[:2]), ("stick", *cylinders[2:])):
        area = np.pi / 4 * V[f"{name}_bore"] ** 2
        forces.append(area * head - (area - np.pi / 4 * V[f"{name}_rod"] ** 2) * rod)
    return d * (p1 - p2), *forces


def test_the_balance_is_the_machine_s_equation_of_motion():
    """With the accelerations of the manipulator's own dynamics f - dh/dt is zero at any state."""
    model, random = symbolic(MANIPULATOR).function(), np.random.default_rng(1)
    own = [V[n] for n in quantities(MANIPULATOR.parameters)]
    for _ in range(50):
        q = random.uniform([-3.0, -0.4, -2.1], [3.0, 1.0, -0.7])
        w, pressures = random.uniform(-1.0, 1.0, 3), random.uniform(0.0, 2e7, 6)
        torque, boom, stick = hydraulics(pressures, w[0])
        u = dict.fromkeys(quantities(MANIPULATOR.inputs), 0.0)
        u |= {"swing_torque": torque, "boom_force": boom, "stick_force": stick}
        dx, _ = model([*q, *w, 0.0, 0.0], list(u.values()), own)  # without a payload
        left = equation_of_motion(()).printed(q, w, dx.full()[3:6, 0], pressures, 0.0, P)[0].full()
        # rounding of torques up to 1e5 N.m, times the condition of M, below 1e3
        assert np.abs(left).max() < 1e-6


@given(st.floats(0.2, 3.0), st.floats(0.0, 6.0), st.sampled_from([1, 3]))
def test_the_bump_and_its_slope_are_one_filter(frequency, phase, every):
    """phi' * sin equals phi * its derivative: the time derivative is moved to the kernel."""
    kernels = filters(200.0, every=every)
    t = np.arange(400) * kernels.step
    x = 2 * np.pi * frequency * t + phase
    left = np.convolve(np.sin(x), kernels.slope, "valid")
    right = np.convolve(2 * np.pi * frequency * np.cos(x), kernels.bump, "valid")
    # sums in the place of integrals: 1.0e-5 of the amplitude at 1 Hz with 21 points, growing with its square
    assert np.abs(left - right).max() < 1.5e-5 * max(frequency, 1.0) ** 2 * 2 * np.pi * frequency


@given(st.integers(0, 10**6), st.sampled_from([1, 2, 3]))
def test_the_transposed_filters_are_the_transpose(seed, every):
    """For any signals and weights, filtered signals times weights equal signals times transposed weights."""
    random, kernels = np.random.default_rng(seed), filters(200.0, every=every)
    n = 60 * every + kernels.smooth.size
    raw = random.standard_normal((2, n))
    value, slope = kernels.values(raw), kernels.rates(raw)
    a, b = random.standard_normal((2, *value.shape))
    back = kernels.transposed(a, b)
    forward = np.sum(a * value) + np.sum(b * slope)
    # exact identity: rounding of slopes up to 1e2
    assert np.sum(back * raw[:, : back.shape[1]]) == pytest.approx(forward, abs=1e-9)


DAMPING = {"boom": "manipulator.boom_piston_damping", "stick": "manipulator.stick_piston_damping"}


def found(record, joint, p=P):
    """B of a piston."""
    return solve([smoothed_recording(record, [joint], p)], [joint], (DAMPING[joint],), p)


# the joint's own encoder: attenuation; the swing's: centrifugal torque of its noise squared
@pytest.mark.parametrize(
    ("joint", "noisy", "pairs", "length"), [("boom", "boom", 6, 16.0), ("stick", "swing", 12, 10.0)]
)
def test_bias_by_an_encoder_s_noise(joint, noisy, pairs, length):
    """Pairs of opposite noise leave its even part, which equals the subtracted bias and is not zero."""
    sd, name = 1e-3, f"manipulator.{noisy}_angle"
    perfect = recording(joint, length=length)
    told = replace(
        perfect, sensors={n: Sensor("coarse", sd if n == name else 1e-12) for n in perfect.signals}
    )
    random, said, start = np.random.default_rng(3), found(told, joint).bias[0], found(told, joint)
    even = []
    for _ in range(pairs):
        noise = sd * random.standard_normal(told.time.size)
        ends = [found(changed(told, {name: told[name] + sign * noise}), joint) for sign in (1, -1)]
        plain = [(e.values + e.bias)[0] for e in (*ends, start)]
        even.append((plain[0] + plain[1]) / 2 - plain[2])
    error = np.std(even, ddof=1) / np.sqrt(pairs)
    # four standard errors: 1 in 1e4 by chance, and the seed is fixed; terms of the angle's noise: 5 %
    assert np.mean(even) == pytest.approx(said, abs=4 * error, rel=0.05)
    assert abs(said) > 4 * error


@pytest.mark.parametrize("name", ["boom_stick.boom_bore", "manipulator.head_mass", "manipulator.boom_pin_x"])
def test_sensitivity_to_a_known_parameter_is_that_of_two_estimates(name):
    """Sensitivity of B against estimates with the parameter changed in both directions."""
    boom, index = recording("boom"), PARAMETERS.index(name)
    step = 1e-4 * P[index]
    ends = []
    for sign in (1, -1):
        p = P.copy()
        p[index] += sign * step
        ends.append(found(boom, "boom", p).values[0])
    # central difference, its error of second order in 1e-4; rounding 1e-9 of B over 1e-4
    difference = (ends[0] - ends[1]) / (2 * step)
    assert found(boom, "boom").sensitivity[0, index] == pytest.approx(difference, rel=1e-4)
