"""Opening curves of the valve from recordings of `benchmarks.openings`, which has equations of its own."""

from dataclasses import replace

import numpy as np
import pytest
from identification.procedures.bench import changed, named
from kit import shards
from scipy import stats

from benchmarks import openings as bench
from fmus.identification import finding
from fmus.identification.procedures import opening_fit, valve
from fmus.identification.procedures.valve_law import ValveConstants, valve_steps
from orchestrator.base.errors import Problem
from orchestrator.data.recording import Sensor

QUICK = ("line^1", "line^1.05", "asymmetric 1", "asymmetric 2")  # a line, nearly one, and four other shapes


@pytest.fixture(
    scope="module",
    params=[QUICK, pytest.param(tuple(bench.VALVES), marks=shards.machine)],
    ids=["some", "all"],
)
def trials(request):
    """Valves with one seed of noise and zeros; `make coverage` has 100 seeds."""
    return [t for name in request.param for t in bench.trials(name, 0)]


def likely(count, wrong):
    """Most misses of `count` intervals of 95 %, but for a probability of `wrong`."""
    return stats.binom.isf(wrong, count, 0.05)


def test_bands_hold_the_true_curve(trials):
    """The 95 % band holds the truth at nine of ten points, over the whole command and all shapes."""
    wrong = [t for t in trials if t.inside < 0.9]
    # a whole curve is inside with 95 %: of 16 at most two
    assert len(wrong) <= likely(len(trials), 0.05), wrong
    # bands are no excuse: 0.25 % of the area is the noise with zeros of 0.5 bar, tables have twice that
    assert max(t.half_band for t in trials) < 0.01


def test_areas_at_full_command_and_starts_are_right(trials):
    """Areas within 1 %, zeros as declared; starts, where no flow was measured, within their uncertainty."""
    assert max(abs(t.area) for t in trials) < 0.01
    assert max(t.zero for t in trials) <= 1.0
    curved = [t for t in trials if not t.straight]
    # of 14 intervals at most three
    assert sum(not t.start for t in curved) <= likely(len(curved), 0.005)


def test_a_straight_line_is_found_to_suffice(trials):
    """Exactly the line is one: a curve that is 1.05 instead of 1 in its exponent is not."""
    assert {t.valve for t in trials if t.straight} == {"line^1"}
    assert all(t.straight for t in trials if t.valve == "line^1")


def found(share, seed=3, zeros=(0.0, 0.0)):
    """The result for one edge; zeros of its transducers in bar."""
    recording = bench.edge("P-A", share, np.array(zeros) * bench.BAR, [seed])
    return valve.identify([recording], bench.KNOWN)


def faults(result):
    """Faults that the data show, but for the one edge."""
    return [f.fault for f in finding.named(result.findings) if f.fault != "one measured edge"]


def test_two_percent_in_the_exponent_are_no_zero_of_a_transducer():
    """line^1.02 once was an area of 25.6 instead of 27.0 mm2 with a zero of -16 bar."""
    result = found(bench.power(1.02))
    estimates = named(result)
    # 1 %: the bar of the project
    assert estimates["valve_area"].value == pytest.approx(bench.AREA, rel=0.01)
    assert abs(estimates["pressures without flow"].value) <= 2 * bench.ZERO_ERROR
    exponent = estimates["exponent[P-A]"]
    assert exponent.value == pytest.approx(1.02, abs=4 * exponent.sd)
    assert any("does not suffice" in r for r in result.remarks)
    assert any("ln C_R = " in r for r in result.remarks)
    assert result.warnings == ()


def test_tables_are_what_the_machine_reads():
    """Up to ten points per edge, from zero to one, ascending, the first of them at the start."""
    result = found(bench.FINE)
    values = {e.name: e.value for e in result.listed}
    assert {e.listed for e in result.listed} == {
        f"valve_{edge}_{kind}" for edge in ("pa", "at", "pb", "bt") for kind in ("commands", "openings")
    }
    for edge in ("pa", "at", "pb", "bt"):
        commands, openings = (
            [values[n] for k in range(1, 11) if (n := f"valve_{edge}_{kind}_{k}") in values]
            for kind in ("command", "opening")
        )
        assert 2 <= len(commands) == len(openings) <= 10
        assert np.all(np.diff(commands) > 0)
        assert np.all(np.diff(openings) >= 0)
        assert (openings[0], openings[-1], commands[-1]) == (0.0, 1.0, 10.0)


def shaken(share, falling_flow, noise=1e-3, seed=4):
    """An edge whose command was recorded with a noise [V], and whose flow changes on the way down."""
    recording = bench.edge("P-A", share, np.zeros(2), [seed])
    command = recording["command"] + np.random.default_rng(seed).normal(0.0, noise, recording.time.size)
    falling = np.arange(recording.time.size) > recording.time.size / 2
    flow = np.where(falling, falling_flow, 1.0) * recording["flow"]
    sensors = {"command": Sensor("converter", noise)} if noise else {}
    read = changed(recording, {"flow": flow, "command": command})
    return replace(read, sensors=recording.sensors | sensors)


def test_hysteresis_is_a_warning():
    """Flows smaller when the command falls; also if noise lets no two steps have exactly one command."""
    (warning,) = valve.identify([shaken(bench.power(1.2), 0.98, noise=0.0)], bench.KNOWN).warnings
    assert "steps with one command" in warning
    result = valve.identify([shaken(bench.power(2.0), 0.9)], bench.KNOWN)
    assert any("steps with one command" in warning for warning in result.warnings)
    # the mean of both ways is 5 % below the way up, and the band is wide
    assert result.estimates[0].value == pytest.approx(0.95 * bench.AREA, rel=0.05)


def test_noise_of_the_command_is_no_hysteresis():
    """Steps with nearly one command scatter as their noise says, and far more with hysteresis."""

    def scatter(recording):
        constants = ValveConstants.of(bench.KNOWN)
        data = opening_fit.opening_data(valve_steps([recording]), constants, 2 * bench.ZERO_ERROR, 0.0)
        return opening_fit.scatter(data)

    for seed, share in enumerate((bench.power(1.2), bench.FINE, bench.KINKED)):
        assert scatter(shaken(share, 1.0, seed=seed)) == 1.0
        # 2 % between two steps with a noise of about 0.03 % each
        assert scatter(shaken(share, 0.98, seed=seed)) > 10


@pytest.mark.parametrize(
    ("share", "message"),
    [
        # the straight line through the rest would have sixty litres per minute at 4.5 V
        (lambda v: np.where(v < 5.0, 0.1, 0.8) * bench.power(1.0)(v), "reads zero at 4.5 V"),
        # less than half the known rounding of 0.4 V, so that the dead band is found below zero
        (bench.power(1.0, 0.05), "valve_command_rounding must be at most 0.1 V instead of 0.4 V"),
    ],
    ids=["idle meter", "below zero"],
)
def test_an_opening_that_no_result_can_describe_is_a_warning(share, message):
    """A flow that the meter must have read, a dead band that the machine refuses."""
    (warning,) = found(share).warnings
    assert message in warning


def test_an_edge_that_is_open_at_zero_is_refused():
    """A dead band below zero is no parameter of the machine: one line says what was expected and found."""
    with pytest.raises(
        Problem, match=r"valve \(P-A\): expected closed edges at 0 V, got .* starts at -1\.\d+ V"
    ):
        found(lambda v: 0.1 + 0.09 * v)


def test_a_band_holds_its_share_of_whole_curves():
    """95 of 100 independent random walks lie in it over their whole length; a pointwise band has fewer."""
    walks = np.cumsum(np.random.default_rng(0).normal(size=(4000, 40)), axis=1)
    low, high = opening_fit.simultaneous_band(walks[:2000])
    inside = np.all((low <= walks[2000:]) & (walks[2000:] <= high), axis=1).mean()
    # two standard deviations of 2000 curves, and of the band of as many: 1.4 %
    assert inside == pytest.approx(0.95, abs=0.02)


@pytest.mark.parametrize("zeros", [(0.5, -0.5), (-0.5, 0.5)])
def test_a_zero_at_its_limit_has_its_uncertainty(zeros):
    """Zeros as far off as declared: the interval of the area holds the truth and shows what they may do."""
    area = found(bench.power(1.0), 1, zeros).estimates[0]
    assert area.low <= bench.AREA <= area.high
    # noise alone would be 0.02 %; 1 bar of 177 bar changes the area by 0.28 %
    assert area.high - area.low > 1e-3 * bench.AREA


@pytest.mark.parametrize("zeros", [(-2.0, 2.0), (2.0, -2.0)])
def test_a_zero_outside_its_declaration_is_named(zeros):
    """4 bar where 1 bar is declared: half of the prior once hid it from the test."""
    assert "zero of a pressure sensor" in faults(found(bench.power(1.0), zeros=zeros))


@pytest.mark.parametrize("share", [bench.power(1.0), bench.power(1.3), bench.FINE])
def test_an_opening_that_falls_is_named(share):
    """4 % from 8 V to 10 V, once hidden by the curve that was made to rise; a rising one is not named."""

    def closing(v):
        return share(np.minimum(v, 8.0)) * (1 - 0.02 * np.maximum(v - 8.0, 0.0))

    assert "falling opening" in faults(found(closing, 1))
    assert "falling opening" not in faults(found(share, 1))


def test_the_start_of_a_straight_opening_is_as_uncertain_as_its_foot():
    """No flow was measured near 0.7 V: the interval holds a sharp start, unlike the known rounding."""
    dead_band = named(found(bench.power(1.0, 0.7)))["valve_dead_band"]
    assert dead_band.low <= 0.7 <= dead_band.high
    assert dead_band.high < 0.8
