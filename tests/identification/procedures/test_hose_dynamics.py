"""Hose dynamics procedure: inertance and capacitance from a hose whose signals are sums of sines."""

import dataclasses

import numpy as np
import pytest
from identification.procedures import bench

from fmus.identification.procedures import hose_dynamics
from fmus.identification.procedures.hose_dynamics import fits, inertance_start
from orchestrator.base.errors import Problem

SEEDS = 24


@pytest.fixture(scope="module")
def results():
    """The procedure over noise seeds."""
    return [hose_dynamics.identify(bench.moving_hose(seed), bench.KNOWN) for seed in range(SEEDS)]


def test_both_are_right_and_scaled(results):
    """I and C within 2 %; I ~ l/A and C ~ A l for the boom's 3 m and the swing's 1 m of the same bore."""
    found = bench.named(results[0])
    for name, truth in (
        ("boom_stick.stick_hose_inertance", bench.INERTANCE),
        ("boom_stick.boom_hose_inertance", bench.INERTANCE * 3 / 4),
        ("swing.line_inertance", bench.INERTANCE / 4),
        ("boom_stick.stick_hose_capacitance", bench.CAPACITANCE),
        ("boom_stick.boom_hose_capacitance", bench.CAPACITANCE * 3 / 4),
    ):
        assert found[name].value == pytest.approx(truth, rel=0.02, abs=0)
    # the paper's method within 5 %: the filter attenuates 4.7 Hz by 1 %, and noise biases it
    assert found["I by definition"].value == pytest.approx(bench.INERTANCE, rel=0.05)
    assert found["C by definition"].value == pytest.approx(bench.CAPACITANCE, rel=0.05, abs=0)


@pytest.mark.parametrize(("name", "truth"), [("I", bench.INERTANCE), ("C", bench.CAPACITANCE)])
def test_intervals_have_their_coverage(results, name, truth):
    """Over noise seeds, 95 % intervals hold the truth, and errors are as large as the standard deviations."""
    bench.assert_coverage(truth, [bench.named(result)[name] for result in results])


@pytest.mark.parametrize("name", ["inertance", "capacitance"])
def test_whitened_residuals_are_white(name):
    """At the true parameters the whitened residuals have variance 1 and neighbours no correlation."""
    theta = {"I": bench.INERTANCE, "C_R": bench.RESISTANCE, "R": 0.0, "p_0": 0.0}
    theta |= {"C": bench.CAPACITANCE, "q_0": 0.0, "s": 0.0}
    every = []
    for group in bench.moving_hose(0, groups=6):
        cut = hose_dynamics.good_windows(group, 0.08)
        more = (bench.TRANSITION,) if name == "inertance" else ()
        every.append(getattr(hose_dynamics, name)(group, cut, *more).whitened_residual(theta))
    white = np.concatenate(every)
    # 4 standard deviations of n normal numbers' mean square and lag products
    assert np.mean(white**2) == pytest.approx(1, abs=4 * np.sqrt(2 / white.size))
    for lag in (1, 2, 3):
        assert np.mean(white[lag:] * white[:-lag]) == pytest.approx(0, abs=4 / np.sqrt(white.size))


def least_squares(equation):
    """I by plain least squares of the same equation at s = 0, as if its regressors had no noise."""
    names = ("I", "R", "C_R", "p_0")
    matrix = np.column_stack([equation.regressors[n] for n in names])
    size = np.linalg.norm(matrix, axis=0)
    return (np.linalg.lstsq(matrix / size, equation.y)[0] / size)[0]


def test_noisy_regressors_do_not_bias_it_towards_zero():
    """With a noisy meter and short windows I is right, but plain least squares is 2 % too low."""
    wild = dataclasses.replace(bench.FLOW, noise=8 * bench.FLOW.noise)
    start = inertance_start(bench.INERTANCE, bench.RESISTANCE, 1e-3)
    errors, plain = [], []
    for seed in range(12):
        group = noisier(bench.moving_hose(seed, groups=1)[0], wild, seed)
        cut = hose_dynamics.good_windows(group, 0.03)
        equation = hose_dynamics.inertance(group, cut, bench.TRANSITION)
        found = fits("I", [equation], start, ["x"]).pooled
        plain.append(least_squares(equation))
        errors.append((found["I"] - bench.INERTANCE) / found.sd("I"))
    # the mean of 12 standard normal errors, 4 standard deviations
    assert abs(np.mean(errors)) < 4 / np.sqrt(12)
    assert np.mean(plain) < bench.INERTANCE * 0.98


def noisier(group, sensor, seed):
    """A recording whose flow at the inlet has the noise of another meter."""
    extra = np.sqrt(sensor.noise**2 - bench.FLOW.noise**2)
    noise = np.random.default_rng([seed, 99]).normal(0.0, extra, group.time.size)
    sensors = {**group.sensors, "flow_in": sensor}
    return dataclasses.replace(bench.changed(group, {"flow_in": group["flow_in"] + noise}), sensors=sensors)


def test_a_distributed_hose_does_not_bias_the_inertance():
    """A hose whose inertance sees the mean flow of its ends: I is right, and so is the position s."""
    result = hose_dynamics.identify(bench.moving_hose(0, share=0.5), bench.KNOWN)
    found = bench.named(result)
    assert abs(found["I"].value - bench.INERTANCE) < 4 * found["I"].sd
    assert abs(found["C"].value - bench.CAPACITANCE) < 4 * found["C"].sd
    assert abs(found["weight of the outlet's flow"].value - 0.5) < 4 * found["weight of the outlet's flow"].sd


def test_groups_that_differ_widen_the_interval():
    """Two hoses whose capacitances differ by 10 %: a remark says so, and the interval covers both."""
    groups = bench.moving_hose(0)
    other = groups[1]
    stored = other["flow_in"] - other["flow_out"]
    more = bench.changed(other, {"flow_out": other["flow_in"] - 1.1 * stored})
    result = hose_dynamics.identify([groups[0], more], bench.KNOWN)
    estimate = bench.named(result)["C"]
    assert any("capacitance differs between the groups" in r for r in result.remarks)
    assert estimate.low < bench.CAPACITANCE * 1.005
    assert estimate.high > bench.CAPACITANCE * 1.095


def test_samples_in_the_dead_zone_are_in_no_window():
    """Windows with a flow below 10 L/min are left out; a recording without other windows is refused."""
    group = bench.moving_hose(0, groups=1)[0]
    flow = group["flow_out"].copy()
    flow[500:900] = 0.0
    cut = hose_dynamics.good_windows(bench.changed(group, {"flow_out": flow}), 0.08)
    touched = cut.bump[:, 500:900].sum(axis=1)
    assert cut.bump.shape[0] > 100
    assert not touched.any()
    still = bench.changed(group, {"flow_out": 0 * flow})
    with pytest.raises(Problem, match=r"^hose_dynamics.csv: 0 windows[^\n]*$"):
        hose_dynamics.identify([still], bench.KNOWN)
