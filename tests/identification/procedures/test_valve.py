"""Valve procedure: area, dead band and C_R from test benches with known parameters."""

import re
from dataclasses import replace

import numpy as np
import pytest
from identification.procedures import bench
from kit import shards
from kit.mistakes import problem

from fmus.identification.procedures import valve
from fmus.identification.procedures.valve import LEAK_SD
from fmus.parameters import Number

ROUNDING = "boom_stick.valve_command_rounding"


def true_resistance(volts):
    """C_R of eq. (2) with the bench's opening."""
    area = bench.AREA * bench.opening(volts)
    return bench.DENSITY / (2 * bench.C_D**2 * area**2)


@pytest.fixture(scope="module", params=[4, pytest.param(30, marks=shards.search)])
def results(request):
    """The procedure over noise seeds: of few the four edges have independent noise, and own intervals.

    The leakage is assumed, not measured, so each seed has another one, drawn from what the procedure assumes.
    """
    leakages = bench.LEAKAGE * (1 + LEAK_SD * np.random.default_rng(7).standard_normal(request.param))
    return [valve.identify(bench.edges(n, leak), bench.KNOWN) for n, leak in enumerate(leakages)]


TRUTH = {
    "valve_area": bench.AREA,
    "dead_band + rounding/2": bench.DEAD_BAND + bench.ROUNDING / 2,
    **{f"C_R({volts:g} V)": true_resistance(volts) for volts in (1.5, 2.0, 3.0, 5.0, 8.0, 10.0)},
}


def test_intervals_have_their_coverage(results):
    """Over noise seeds, 95 % intervals hold the truth, and errors are as large as the standard deviations."""
    for name, truth in TRUTH.items():
        found = [bench.named(result)[name] for result in results]
        bench.assert_coverage(truth, found)
        # the bar of the project is 3 %; a resistance goes with the square of the area
        assert max(e.sd for e in found) < 0.01 * truth
    own = [e for f in results for n, e in bench.named(f).items() if n.startswith("valve_area[")]
    assert len(own) == 4 * len(results)
    bench.assert_coverage(bench.AREA, own)
    # no flow shows the foot: the dead band may be anywhere between two roundings, so all intervals hold it
    starts = [bench.named(result)["valve_dead_band"] for result in results]
    assert all(start.low <= bench.DEAD_BAND <= start.high for start in starts)
    # hardly any test of equal edges at 1 % is significant: three of 30, four or more in 2e-4
    wrong = sum(any("differ significantly (" in r and "not" not in r for r in f.remarks) for f in results)
    assert wrong <= len(results) / 10


def test_what_the_data_do_not_determine_is_told(results):
    """Steps in the dead zone are masked, and with them the rounding."""
    gain = results[0].panels[1]
    masked = next(curve for curve in gain.curves if curve.kind == "masked")
    assert set(masked.x) == {0.25, 0.5, 0.75, 1.0}  # 1.25 V lets 15 L/min through, 1 V 7 L/min
    assert "valve_command_rounding" not in bench.named(results[0])
    told = ("masked", "up to 1 V"), ("half the known rounding",), ("No reading",)
    for words in told:
        assert any(all(word in r for word in words) for r in results[0].remarks), words


def test_asymmetrical_edges_are_detected():
    """An edge that is 0.5 % wider differs significantly from the others, and its area is right."""
    wider = bench.AREA * 1.005
    result = valve.identify(bench.edges(1, **{"B-T": wider}), bench.KNOWN)
    assert any("edges differ significantly" in r for r in result.remarks)
    # 5 standard deviations, each 0.13 %, since an offset of the pressures is estimated as well
    own = bench.named(result)["valve_area[B-T]"]
    assert own.value == pytest.approx(wider, abs=5 * own.sd)
    assert own.sd < 2e-3 * wider


def test_rounding_is_fitted_if_the_data_determine_it():
    """With a meter that measures the foot of the opening, rounding and dead band are both estimated."""
    fine = replace(
        bench.FLOW, noise=0.01 * bench.LITRES, resolution=0.01 * bench.LITRES, dead_zone=0.05 * bench.LITRES
    )
    steps = (*np.round(np.arange(0.65, 2.0, 0.05), 2), 3.0, 5.0, 10.0)
    guess = bench.KNOWN | {ROUNDING: Number(0.2, "V", "assumed", "")}
    found = bench.named(valve.identify([bench.edge("P-A", 0, steps=steps, flow=fine)], guess))
    # 5 standard deviations
    for name, truth in (("valve_command_rounding", bench.ROUNDING), ("valve_dead_band", bench.DEAD_BAND)):
        assert abs(found[name].value - truth) < 5 * found[name].sd
        assert found[name].sd < 0.02 * truth


def test_uncertain_rounding_widens_the_dead_band():
    """A rounding known within 0.1 V leaves half of that, 0.05 V, to the dead band."""
    known = bench.KNOWN | {ROUNDING: Number(0.4, "V", "assumed", "", sd=0.1)}
    found = bench.named(valve.identify([bench.edge("P-A", 0)], known))
    assert found["valve_dead_band"].sd == pytest.approx(0.05, rel=0.02)  # next to 3e-4 V of the noise
    assert found["dead_band + rounding/2"].sd < 1e-3


def test_an_undeclared_dead_zone_in_a_slower_group_leaves_the_dead_band_open():
    """Every second flow is missing, and 0 below 10 L/min: the interval holds the truth."""
    log = bench.edge("P-A", 0)
    log = replace(log, sensors={"flow": replace(bench.FLOW, dead_zone=0.0)})
    flow = np.where(np.arange(log.time.size) % 2, np.nan, log["flow"])
    command = np.round(log["command"] * 4096 / 20) * 20 / 4096
    result = valve.identify([bench.changed(log, {"flow": flow, "command": command})], bench.KNOWN)
    found = bench.named(result)["valve_dead_band"]
    assert found.low <= bench.DEAD_BAND <= found.high


UNKNOWN = {n: v for n, v in bench.KNOWN.items() if n != "boom_stick.density"}


@pytest.mark.parametrize(
    ("steps", "known", "message"),
    [
        (bench.STEPS, UNKNOWN, r"^known parameters: expected boom_stick\.density"),
        ((), bench.KNOWN, "^valve: expected a recording"),
        ((0.5, 3.0, 5.0), bench.KNOWN, "^valve P-A: .*, got 2; "),
    ],
)
def test_mistakes_have_one_line(steps, known, message):
    """A missing parameter, no recording, too few voltages: one line that names it."""
    some = [bench.edge("P-A", 0, steps=steps)] if steps else []
    assert re.search(message, problem(lambda: valve.identify(some, known)))
