"""Hose dynamics procedure: inertance and capacitance from a hose whose signals are sums of sines."""

import dataclasses

import numpy as np
import pytest
from identification.procedures import bench
from kit.mistakes import problem

from fmus.identification.balance import linearised, solve
from fmus.identification.procedures import hose_dynamics
from fmus.identification.results import named

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


TRUTHS = [("I", bench.INERTANCE), ("C", bench.CAPACITANCE)]


@pytest.mark.parametrize(("name", "truth"), TRUTHS)
def test_intervals_have_their_coverage(results, name, truth):
    """Over noise seeds, 95 % intervals hold the truth, and errors are as large as the standard deviations."""
    bench.assert_coverage(truth, [bench.named(result)[name] for result in results])


INERTANCE, CAPACITANCE = hose_dynamics.equations(bench.KNOWN, bench.LENGTH, bench.BORE)


def alone(group, equation, **fixed):
    """Samples of one group, and its fit; `fixed` unknowns keep their value."""
    samples = hose_dynamics.prepared(group, equation)
    return samples, solve([samples], {**equation.start, **fixed}, equation.name, tested=fixed)


@pytest.mark.parametrize("equation", [INERTANCE, CAPACITANCE])
def test_whitened_residuals_are_white(equation):
    """Close to the true parameters the whitened residuals have variance 1 and neighbours no correlation."""
    solutions = [alone(group, equation)[1] for group in bench.moving_hose(0, groups=6)]
    white = np.concatenate([solution.residual for solution in solutions])
    # 4 standard deviations of n normal numbers' mean square and lag products; the fits take 4 of 240
    assert np.mean(white**2) == pytest.approx(1, abs=4 * np.sqrt(2 / white.size))
    for lag in (1, 2, 3):
        assert np.mean(white[lag:] * white[:-lag]) == pytest.approx(0, abs=4 / np.sqrt(white.size))


def test_noisy_regressors_do_not_bias_it_towards_zero():
    """With a noisy meter and short windows I is right, but plain least squares is 2 % too low."""
    wild = dataclasses.replace(bench.FLOW, noise=8 * bench.FLOW.noise)
    extra = np.sqrt(wild.noise**2 - bench.FLOW.noise**2)
    errors, plain = [], []
    for seed in range(12):
        (group,) = bench.moving_hose(seed, groups=1)
        noise = np.random.default_rng([seed, 99]).normal(0.0, extra, group.time.size)
        group = bench.changed(group, {"flow_in": group["flow_in"] + noise})
        group = dataclasses.replace(group, sensors={**group.sensors, "flow_in": wild})
        samples, solution = alone(group, dataclasses.replace(INERTANCE, half_width=0.03), s=0.0)
        at = linearised(samples, samples.raw, np.array(list(INERTANCE.start.values())))
        matrix = at.by_theta[:3, 0].T
        size = np.linalg.norm(matrix, axis=0)
        plain.append(bench.INERTANCE - (np.linalg.lstsq(matrix / size, at.e[0])[0] / size)[0])
        errors.append((solution.fit["I"] - bench.INERTANCE) / solution.fit.sd("I"))
    # the mean of 12 standard normal errors, 4 standard deviations
    assert abs(np.mean(errors)) < 4 / np.sqrt(12)
    assert np.mean(plain) < bench.INERTANCE * 0.98


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
    samples = alone(bench.changed(group, {"flow_out": flow}), CAPACITANCE)[0]
    size = samples.bump.size
    assert samples.starts.size > 100
    assert not np.any((samples.starts + size > 500) & (samples.starts < 900))
    still = bench.changed(group, {"flow_out": 0 * flow})
    problem(lambda: hose_dynamics.identify([still], bench.KNOWN), r"^hose_dynamics.csv: 0 windows[^\n]*$")


@pytest.mark.parametrize("late", [("pressure_out", "flow_out"), ("flow_in", "flow_out"), ("flow_out",)])
def test_the_delay_of_a_logger_is_named_and_taken_out(late):
    """Signals that are 12 ms (2.4 samples) late: only this is named, and both intervals hold the truth."""
    result = hose_dynamics.identify(bench.moving_hose(1, late=late, delay=0.012), bench.KNOWN)
    (fault,) = named(result.findings)
    assert fault.fault == "time shift"
    found = bench.named(result)
    for name, truth in TRUTHS:
        assert abs(found[name].value - truth) < 4 * found[name].sd
        assert found[name].sd < 0.05 * truth
