"""Hoses: C_R, laminar flow and viscosity from steady flows, inertance and capacitance from sums of sines."""

import numpy as np
import pytest
from identification.procedures import bench
from kit import shards
from kit.mistakes import problem

from fmus.identification.procedures import hoses
from fmus.identification.procedures.hoses import HOSE_DYNAMICS, HOSE_RESISTANCE
from fmus.identification.results import named


@pytest.fixture(scope="module")
def every():
    """The procedure over noise seeds, on a hose that is laminar, then turbulent."""
    return [HOSE_RESISTANCE.identify(bench.steady_hose(s, bench.friction), bench.KNOWN) for s in range(30)]


def test_resistance_comes_back_and_is_scaled(every):
    """The stick's C_R within 2 %, the boom's 3/4 of it, eq. (10); over noise seeds intervals hold it."""
    found = bench.named(every[0])
    assert found["boom_stick.stick_hose_resistance"].value == pytest.approx(bench.RESISTANCE, rel=0.02)
    ratio = found["boom_stick.boom_hose_resistance"].value / found["boom_stick.stick_hose_resistance"].value
    assert ratio == pytest.approx(0.75, rel=1e-12)  # exact: 3 m of 4 m, the same bore
    bench.assert_coverage(bench.RESISTANCE, [bench.named(result)["C_R"] for result in every])
    masked = next(c for c in every[0].panels[0].curves if c.kind == "masked")
    assert masked.x.size == 1  # the only step below 10 L/min, which is not fitted
    assert every[0].remarks[1].startswith("Left out of 24 steps: 1 in the dead zone")


def test_the_law_falls_with_the_flow_and_eq_1_contradicts_it(every):
    """That of the machine, whose C_R falls with the flow; data of eq. (1) contradict it."""
    assert named(every[0].findings) == []
    found = bench.named(every[0])
    # above Re 5000, 100 L/min, the drop over Q^2 by the factor 0.3164 Re^-0.25 of Darcy's law
    for litres in (100.0, 200.0, 300.0):
        q = litres * bench.LITRES
        expected = bench.friction(q) / q**2
        assert found["C_R"].value * (170 / litres) ** 0.25 == pytest.approx(expected, rel=0.005)
    square = HOSE_RESISTANCE.identify(bench.steady_hose(0, lambda q: bench.RESISTANCE * q**2), bench.KNOWN)
    assert any(r.startswith("The hose's law leaves residuals") for r in square.remarks)
    told = [f.sentence for f in named(square.findings) if f.fault == "model"]
    assert any("times the noise of the sensors" in sentence for sentence in told)


@pytest.mark.parametrize("thicker", [2.0, 5.0])
def test_another_viscosity_is_estimated(thicker):
    """Oil of 45 and of 25 degC in place of 60: its viscosity, and C_R of the machine's oil."""
    recordings = bench.steady_hose(0, lambda q: bench.friction(q, thicker * bench.VISCOSITY))
    result = HOSE_RESISTANCE.identify(recordings, bench.KNOWN)
    found = bench.named(result)
    for name, truth in (("viscosity ratio", thicker), ("C_R", bench.RESISTANCE)):
        assert abs(found[name].value - truth) < 4 * found[name].sd
        assert found[name].sd < 0.02 * truth
    assert any("small flows are those of" in remark for remark in result.remarks)
    assert named(result.findings) == []


def test_too_few_steps_are_refused():
    """Three flows are not enough to compare the laws: one line says so."""
    few = bench.steady_hose(0, bench.friction, (50.0, 100.0, 200.0))
    told = "expected 4 or more stretches of 0.75 s with steady flow, got 3; left out of 3: none"
    problem(lambda: HOSE_RESISTANCE.identify(few, bench.KNOWN), told)


# ---- dynamics


@pytest.fixture(scope="module")
def results():
    """The procedure over noise seeds."""
    return [HOSE_DYNAMICS.identify(bench.moving_hose(seed), bench.KNOWN) for seed in range(12)]


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
DELAYS = [(OUTLET, 0.002), pytest.param(OUTLET, 0.03, marks=shards.search), (FLOWS, 0.012), (ONE, 0.002)]


@pytest.mark.parametrize(("late", "delay"), DELAYS)
def test_the_delay_of_a_logger_is_taken_out_and_named(late, delay):
    """0.4, 2.4 and 6 samples late, both intervals hold the truth; from half a sample on only it is named."""
    result = HOSE_DYNAMICS.identify(bench.moving_hose(1, length=6.0, late=late, delay=delay), bench.KNOWN)
    assert [f.fault for f in named(result.findings)] == ["time shift"] * (delay > 0.0025)
    found = bench.named(result)
    for name, truth in TRUTHS:
        assert abs(found[name].value - truth) < 4 * found[name].sd
        assert found[name].sd < 0.05 * truth
