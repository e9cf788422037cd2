"""Hose dynamics procedure: inertance and capacitance from a hose whose signals are sums of sines."""

import numpy as np
import pytest
from identification.procedures import bench
from kit.mistakes import problem

from fmus.identification.procedures import hoses
from fmus.identification.procedures.hoses import HOSE_DYNAMICS
from fmus.identification.results import named

SEEDS = 24


@pytest.fixture(scope="module")
def results():
    """The procedure over noise seeds."""
    return [HOSE_DYNAMICS.identify(bench.moving_hose(seed), bench.KNOWN) for seed in range(SEEDS)]


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


def test_a_distributed_hose_does_not_bias_the_inertance():
    """A hose whose inertance sees the mean flow of its ends: I is right, and so is the position s."""
    result = HOSE_DYNAMICS.identify(bench.moving_hose(0, share=0.5), bench.KNOWN)
    found = bench.named(result)
    for name, truth in (*TRUTHS, ("weight of the outlet's flow", 0.5)):
        assert abs(found[name].value - truth) < 4 * found[name].sd


def test_groups_that_differ_are_named():
    """Two hoses whose capacitances differ by 10 %: it is named, and the interval covers both."""
    one, other = bench.moving_hose(0)
    stored = other["flow_in"] - other["flow_out"]
    more = bench.changed(other, {"flow_out": other["flow_in"] - 1.1 * stored})
    result = HOSE_DYNAMICS.identify([one, more], bench.KNOWN)
    estimate = bench.named(result)["C"]
    assert estimate.low < bench.CAPACITANCE * 1.005
    assert estimate.high > bench.CAPACITANCE * 1.095
    assert any("C differs between the recordings: +10 %" in f.sentence for f in named(result.findings))


def test_samples_in_the_dead_zone_are_in_no_window():
    """Windows with a flow below 10 L/min are left out; a recording without other windows is refused."""
    group = bench.moving_hose(0, groups=1)[0]
    flow = group["flow_out"].copy()
    flow[500:900] = 0.0
    tested = hoses.TestedHose(*(bench.HOSE[n] for n in bench.HOSE), bench.VISCOSITY, bench.KNOWN)
    ((samples, _),) = HOSE_DYNAMICS.samples([bench.changed(group, {"flow_out": flow})], tested)
    size = samples.bump.size
    assert samples.starts.size > 100
    assert not np.any((samples.starts + size > 500) & (samples.starts < 900))
    still = bench.changed(group, {"flow_out": 0 * flow})
    problem(lambda: HOSE_DYNAMICS.identify([still], bench.KNOWN), r"^hose_dynamics.csv: 0 windows[^\n]*$")


OUTLET, FLOWS, ONE = ("pressure_out", "flow_out"), ("flow_in", "flow_out"), ("flow_out",)


@pytest.mark.parametrize(("late", "delay"), [(OUTLET, 0.002), (OUTLET, 0.03), (FLOWS, 0.012), (ONE, 0.002)])
def test_the_delay_of_a_logger_is_taken_out_and_named(late, delay):
    """0.4, 2.4 and 6 samples late, both intervals hold the truth; from half a sample on only it is named."""
    result = HOSE_DYNAMICS.identify(bench.moving_hose(1, length=6.0, late=late, delay=delay), bench.KNOWN)
    assert [f.fault for f in named(result.findings)] == ["time shift"] * (delay > 0.0025)
    found = bench.named(result)
    for name, truth in TRUTHS:
        assert abs(found[name].value - truth) < 4 * found[name].sd
        assert found[name].sd < 0.05 * truth
