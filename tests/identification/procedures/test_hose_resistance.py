"""Hose resistance procedure: C_R, laminar flow and viscosity from steady flows with a known drop."""

import pytest
from identification.procedures import bench
from kit.mistakes import problem

from fmus.identification import results
from fmus.identification.procedures.hoses import HOSE_RESISTANCE

SEEDS = 30


@pytest.fixture(scope="module")
def every():
    """The procedure over noise seeds, on a hose that is laminar, then turbulent."""
    return [HOSE_RESISTANCE.identify(bench.steady_hose(s, bench.friction), bench.KNOWN) for s in range(SEEDS)]


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
    assert results.named(every[0].findings) == []
    found = bench.named(every[0])
    # above Re 5000, 100 L/min, the drop over Q^2 by the factor 0.3164 Re^-0.25 of Darcy's law
    for litres in (100.0, 200.0, 300.0):
        q = litres * bench.LITRES
        expected = bench.friction(q) / q**2
        assert found["C_R"].value * (170 / litres) ** 0.25 == pytest.approx(expected, rel=0.005)
    square = HOSE_RESISTANCE.identify(bench.steady_hose(0, lambda q: bench.RESISTANCE * q**2), bench.KNOWN)
    assert any(r.startswith("The hose's law leaves residuals") for r in square.remarks)
    assert "model" in {f.fault for f in results.named(square.findings)}


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
    assert results.named(result.findings) == []


def test_too_few_steps_are_refused():
    """Three flows are not enough to compare the laws: one line says so."""
    few = bench.steady_hose(0, bench.friction, (50.0, 100.0, 200.0))
    told = "expected 4 or more stretches of 0.75 s with steady flow, got 3; left out of 3: none"
    problem(lambda: HOSE_RESISTANCE.identify(few, bench.KNOWN), told)
