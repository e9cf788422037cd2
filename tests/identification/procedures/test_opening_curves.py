"""Opening curves of the valve from recordings of `benchmarks.openings`, which has equations of its own."""

from dataclasses import replace
from functools import partial
from itertools import product
from types import SimpleNamespace

import numpy as np
import pytest
from identification.procedures.bench import changed, named, opening
from kit import shards
from scipy import stats

from benchmarks import openings as bench
from fmus.components import opening_curve
from fmus.identification import results
from fmus.identification.procedures import valve
from orchestrator.data.recording import Sensor

QUICK = ("line^1", "line^1.05", "asymmetric 2")  # a line, nearly one, and two other shapes
ALL = pytest.param(tuple(bench.VALVES), marks=shards.machine)


@pytest.fixture(scope="module", params=[QUICK, ALL], ids=["some", "all"])
def trials(request):
    """Valves with one seed of noise and zeros; `make coverage` has 100 seeds."""
    return [t for name in request.param for t in bench.trials(name, 0)]


def likely(count, wrong):
    """Most misses of `count` intervals of 95 %, but for a probability of `wrong`."""
    return stats.binom.isf(wrong, count, 0.05)


def test_areas_and_tables_follow_the_opening(trials):
    """95 % intervals of the areas at single commands, and the machine's curve through nine of them."""
    # zeros are common to a valve: its areas miss together, so a valve counts as one; of 8 at most two
    wrong = [t for t in trials if t.inside < 0.8]
    assert len({t.valve for t in wrong}) <= likely(len({t.valve for t in trials}), 0.01), wrong
    # intervals are no excuse: 0.25 % of the area is the noise with zeros of 0.5 bar
    assert max(t.half for t in trials) < 0.005
    assert max(t.table for t in trials) < 0.033


def test_areas_at_full_command_and_starts_are_right(trials):
    """Areas within 1 %, zeros as declared, starts within their uncertainty; exactly the line is one."""
    assert max(abs(t.area) for t in trials) < 0.01
    assert max(t.zero for t in trials) <= 1.0
    curved = [t for t in trials if not t.straight]
    # of 14 intervals at most three
    assert sum(not t.start for t in curved) <= likely(len(curved), 0.005)
    assert {t.valve for t in trials if t.straight} == {"line^1"}
    assert all(t.straight for t in trials if t.valve == "line^1")


def found(share, seed=3, zeros=(0.0, 0.0)):
    """The result for one edge; zeros of its transducers in bar."""
    recording = bench.edge("P-A", share, np.array(zeros) * bench.BAR, [seed])
    return valve.identify([recording], bench.KNOWN)


def faults(result):
    """Faults that the data show."""
    return [f.fault for f in results.named(result.findings)]


LINE, BENT = bench.power(1.0), bench.power(1.2)
ZEROS = [(0.5, 0.0), (0.0, 0.5), (-0.5, 0.0), (0.0, -0.5)]  # bar


def test_two_percent_in_the_exponent_are_no_zero_of_a_transducer():
    """line^1.02 once was an area of 25.6 instead of 27.0 mm2 with a zero of -16 bar."""
    result = found(bench.power(1.02))
    estimates = named(result)
    # 1 %: the bar of the project
    assert estimates["valve_area"].value == pytest.approx(bench.AREA, rel=0.01)
    assert abs(estimates["pressures without flow"].value) <= 2 * bench.ZERO_ERROR
    assert any("does not suffice" in r for r in result.remarks)
    assert faults(result) == []


def table_of(result, edge):
    """Commands and openings of the table of an edge."""
    values = {e.name: e.value for e in result.listed}
    for kind in ("command", "opening"):
        names = (f"valve_{edge}_{kind}_{k}" for k in range(1, 11))
        yield np.array([values[name] for name in names if name in values])


# a curve that nine points can follow, and two that they cannot; largest distance at a measured command
@pytest.mark.parametrize(
    ("share", "follows", "most"),
    [(bench.power(1.1), True, 1e-3), (bench.FINE, False, 8e-3), (bench.KINKED, False, 8e-3)],
)
def test_a_table_follows_all_measured_areas_or_tells_how_far_it_is_off(share, follows, most):
    """Areas with a noise of 0.02 %; a curve through nine of them was up to 1.6 % off at the others."""
    command = np.unique([v for v in bench.STEPS if v >= 1.5])
    true = bench.AREA * share(command)
    sd = 2e-4 * true
    areas = true + sd * np.random.default_rng(1).standard_normal(true.size)
    start = results.Estimate.normal("", bench.start_of(share), "V", 0.1, "")
    curve = valve.Opening(command, areas, np.diag(sd**2), sd, start, (0.0, 0.0), bench.FULL).table
    assert (curve.p > 1e-3) == follows
    # of the areas: three standard deviations of the noise, 0.06 %, and what nine points leave of the shapes
    off = np.abs(curve.drawn(command) / true - 1)
    assert off.max() < most
    told = np.abs(curve.drawn(command) - areas).max() / areas[-1]
    assert curve.off[0] == pytest.approx(told, rel=1e-6)
    # intervals cover the distance, too: of nine points at most two miss in 99 %
    at = bench.AREA * share(curve.command)
    assert sum(not e.low <= x <= e.high for e, x in zip(curve.areas, at, strict=True)) <= 2


def shaken(share, lag=0.0, noise=1e-3, seed=4, falling_flow=1.0):
    """An edge whose spool lags [V], whose command has a noise [V], and whose flow changes on the way down."""
    volts = np.array(bench.STEPS)
    moved = volts - lag / 2 * np.sign(np.diff(volts, prepend=0.0))
    recording = bench.edge("P-A", lambda v: share(moved if v.size == volts.size else v), np.zeros(2), [seed])
    command = recording["command"] + np.random.default_rng(seed).normal(0.0, noise, recording.time.size)
    falling = np.arange(recording.time.size) > recording.time.size / 2
    flow = np.where(falling, falling_flow, 1.0) * recording["flow"]
    sensors = {"command": Sensor("converter", noise)} if noise else {}
    read = changed(recording, {"flow": flow, "command": command})
    return replace(read, sensors=recording.sensors | sensors)


@pytest.mark.parametrize(
    ("share", "noise"),
    shards.few(
        [(BENT, 0.0), (bench.FINE, 1e-3)], product((LINE, BENT, bench.FINE), (0.0, 1e-3)), shards.search
    ),
)
def test_hysteresis_is_named_and_taken_out(share, noise):
    """A spool that lags by 0.1 V; also if noise lets no two steps have exactly one command."""
    result = valve.identify([shaken(share, 0.1, noise)], bench.KNOWN)
    # between two commands of a bent curve the slope is not known to the noise, which is a lack of the model
    assert {*faults(result)} - {"model"} == {"hysteresis"}
    lag = named(result)["hysteresis"]
    assert lag.value == pytest.approx(0.1, abs=4 * lag.sd)
    # the area of the bench is between those of both ways, which is 0.1 V of 9.4 V apart, 1 %
    assert result.estimates[0].value == pytest.approx(bench.AREA, rel=0.01)


def test_flows_that_differ_on_the_way_down_are_no_zero_and_are_told():
    """Flows 10 % smaller when the command falls are no lag of a spool: the residuals say so."""
    told = faults(valve.identify([shaken(bench.power(1.02), falling_flow=0.9, noise=0.0)], bench.KNOWN))
    assert "model" in told
    assert "zero of a pressure sensor" not in told


# one curve; the noise is the same for the others
@pytest.mark.parametrize("share", shards.few([BENT], [BENT, bench.FINE, bench.KINKED], shards.search))
def test_noise_of_the_command_is_no_hysteresis(share):
    """Steps with nearly one command scatter as their noise says."""
    assert faults(valve.identify([shaken(share)], bench.KNOWN)) == []


def test_oil_that_warms_is_named():
    """An area that grows by 1 % over the experiment is one of the oil, and no hysteresis."""
    recording = bench.edge("P-A", bench.power(1.3), np.zeros(2), [5])
    warm = 1 + 0.01 * recording.time / recording.time[-1]
    result = valve.identify([changed(recording, {"flow": warm * recording["flow"]})], bench.KNOWN)
    assert faults(result) == ["oil temperature"]
    (sentence,) = (f.sentence for f in result.findings if f.fault == "oil temperature")
    # from the middle of the first step to that of the last, 70.5 of 72 s: 0.97 % of the mean
    assert float(sentence.split("time by ")[1].split()[0]) == pytest.approx(0.97, abs=0.05)
    # which temperature is that of the machine is not known: the interval has both ends
    area = named(result)["valve_area"]
    assert area.low < bench.AREA * warm[0]
    assert bench.AREA * warm[-1] < area.high


def test_the_density_of_the_tested_oil_is_used():
    """A flow of another oil, stated with the recording, gives the same area."""
    recording = bench.edge("P-A", bench.power(1.0), np.zeros(2), [6])
    flow = recording["flow"] * np.sqrt(bench.DENSITY / 970.0)
    other = replace(changed(recording, {"flow": flow}), conditions={"edge": "P-A", "density": 970.0})
    result = valve.identify([other], bench.KNOWN)
    # five standard deviations, each 0.1 % with a zero of the pressures
    assert result.estimates[0].value == pytest.approx(bench.AREA, rel=5e-3)
    assert faults(result) == ["density"]
    assert any("density 970 kg/m3" in remark for remark in result.remarks)


@pytest.mark.parametrize("factor", [4.0, 0.25])
def test_a_wrong_noise_is_named_with_the_right_one(factor):
    """Noise that is declared four times too large or small is no reason to refuse samples."""
    recording = bench.edge("P-A", bench.power(1.0), np.zeros(2), [7])
    sensors = {n: replace(s, noise=factor * s.noise) for n, s in recording.sensors.items()}
    result = valve.identify([replace(recording, sensors=sensors)], bench.KNOWN)
    assert faults(result) == ["noise"]
    assert result.estimates[0].low <= bench.AREA <= result.estimates[0].high


def test_a_zero_of_the_flow_meter_is_seen_at_closed_edges(monkeypatch):
    """Readings that no command changes are subtracted, and named if they are not declared."""
    recording = bench.edge("P-A", bench.power(1.0), np.zeros(2), [8])
    shifted = changed(recording, {"flow": recording["flow"] + 0.3 * bench.LITRES})
    assert faults(valve.identify([recording], bench.KNOWN)) == []
    result = valve.identify([shifted], bench.KNOWN)
    assert faults(result) == ["zero of a flow meter"]
    start = named(result)["dead_band + rounding/2"]
    assert start.low <= bench.DEAD_BAND <= start.high
    # an opening from 0.3 V has one closed command of 0.25 V only: the steps at 0 V tell the zero, too
    monkeypatch.setattr(bench, "STEPS", (0.0, *bench.STEPS))
    recording = bench.edge("P-A", bench.power(1.0, 0.3), np.zeros(2), [10])
    shifted = changed(recording, {"flow": recording["flow"] + 0.3 * bench.LITRES})
    result = valve.identify([shifted], bench.KNOWN)
    assert "zero of a flow meter" in faults(result)
    assert all("0.3 L/min" in f.sentence for f in result.findings if f.fault == "zero of a flow meter")


@pytest.mark.parametrize("bar", [0.4, -2.0])
def test_a_zero_of_the_pressures_is_seen_at_two_supplies(monkeypatch, bar):
    """A curve has the same opening at 30 and 150 bar only without the zeros; 0.5 bar each is declared."""
    recordings = []
    for number, supply in enumerate((30.0, 150.0)):
        monkeypatch.setattr(bench, "SUPPLY", supply * bench.BAR)
        recordings.append(bench.edge("P-A", bench.FINE, bar * bench.BAR * np.array([1, -1]), [11, number]))
    result = valve.identify(recordings, bench.KNOWN)
    assert faults(result) == (["zero of a pressure sensor"] if abs(bar) > 0.5 else [])
    area, zero = (named(result)[n] for n in ("valve_area", "pressures without flow"))
    assert area.low <= bench.AREA <= area.high
    # 1 %, 0.04 bar: five standard deviations of 0.008 bar
    assert zero.value == pytest.approx(2 * bar * bench.BAR, abs=0.04 * bench.BAR)


def gear_meter(monkeypatch, step=0.25):
    """A bench whose meter has no dead zone, with steps of one height up and down."""
    meter = replace(bench.SENSORS["flow"], dead_zone=0.0, resolution=0.01 * bench.LITRES)
    monkeypatch.setitem(bench.SENSORS, "flow", meter)
    up = np.arange(0.0, 10.01, step)
    monkeypatch.setattr(bench, "STEPS", tuple(np.round([*up, *up[::-1]], 9)))


def test_a_sharp_start_that_is_not_seen_is_in_the_interval():
    """An opening from 0.7 V on, not rounded over the known 0.4 V, in the dead zone of the meter."""
    unseen = named(found(bench.power(1.0, 0.7)))["valve_dead_band"]
    assert unseen.low <= 0.7 <= unseen.high
    assert unseen.high < 0.8


@pytest.mark.parametrize(("start", "step"), [(0.8, 0.25), (0.5, 0.25), (0.7, 0.2)])
def test_a_sharp_start_is_found(monkeypatch, start, step):
    """A meter without a dead zone: no warning, although another rounding was known; within 0.03 V."""
    gear_meter(monkeypatch, step)
    result = found(bench.power(1.0, start))
    band, rounding = (named(result)[f"valve_{n}"] for n in ("dead_band", "command_rounding"))
    assert faults(result) == []
    # the step of the command leaves it open; a rounding that the data cannot tell is taken as none
    assert band.value == pytest.approx(start, abs=0.03)
    assert band.low <= start <= band.high
    # the step below the start has no flow: a rounding of 0.5 V would begin there
    assert band.high - band.low < 0.25
    assert rounding.low < 0.01 < rounding.high < 0.5


@pytest.mark.parametrize(("dead_band", "width"), [(0.7, 0.2), (0.5, 0.6), (0.6, 0.4)])
def test_a_rounded_start_is_in_the_interval(monkeypatch, dead_band, width):
    """Shorter, longer and equal to the known 0.4 V."""
    gear_meter(monkeypatch)
    estimates = named(found(partial(opening, dead_band=dead_band, rounding=width)))
    band = estimates["valve_dead_band"]
    assert band.low <= dead_band <= band.high
    assert band.high - band.low < 0.25
    told = estimates.get("valve_command_rounding")
    assert told is None or told.low <= width <= told.high


def test_an_edge_in_the_dead_zone_is_not_idle(monkeypatch):
    """Of two equal edges one meter reads nothing at 1.5 V, 3 % below its dead zone, where the other does."""
    at = bench.power(1.3)(np.array([1.5]))[0] * bench.C_D * bench.AREA * np.sqrt(2 / bench.DENSITY)
    flow = at * np.sqrt(bench.SUPPLY / (1 + bench.THROTTLE * at**2))
    recordings = []
    for edge, factor in (("P-A", 0.97), ("P-B", 1.03)):
        monkeypatch.setitem(bench.SENSORS, "flow", replace(bench.SENSORS["flow"], dead_zone=factor * flow))
        recordings.append(bench.edge(edge, bench.power(1.3), np.zeros(2), [12]))
        recordings[-1] = replace(recordings[-1], sensors=dict(bench.SENSORS))
    assert faults(valve.identify(recordings, bench.KNOWN)) == []


def test_an_idle_meter_is_named():
    """The straight line through the rest would have sixty litres per minute at 4.5 V."""
    result = found(lambda v: np.where(v < 5.0, 0.1, 0.8) * bench.power(1.0)(v))
    assert faults(result) == ["dead band"]
    assert any("reads nothing at 4.5 V" in f.sentence for f in result.findings)


def test_a_dead_band_is_not_below_zero():
    """A straight opening from 0.05 V has a shorter rounding than the known 0.4 V."""
    estimates = named(found(bench.power(1.0, 0.05)))
    # 1 % of the closed form of the bench, whose rounding is none
    assert estimates["valve_command_rounding"].value == pytest.approx(0.1, rel=0.01)
    assert estimates["valve_dead_band"].value == pytest.approx(0.0, abs=1e-6)


def test_an_edge_that_is_open_at_zero_has_a_table():
    """An underlap is named, and the table begins at 0 V with the opening that it has there."""
    result = found(lambda v: 0.1 + 0.09 * v)
    assert faults(result) == ["dead band"]
    commands, openings_of = table_of(result, "pa")
    assert commands[0] == 0.0
    volts = np.arange(0.5, 10.01, 0.5)
    points = {f"{kind}_{k}": 0.0 for kind in ("command", "opening") for k in range(1, 11)}
    for k, point in enumerate(zip(commands, openings_of, strict=True), 1):
        points |= dict(zip((f"command_{k}", f"opening_{k}"), point, strict=True))
    machine = opening_curve.pieces(SimpleNamespace(**points))
    table = np.array([float(machine.opening(v)) for v in volts])
    # 1 % from the lowest measured command on: below it the table rises from zero
    area = table * named(result)["valve_area"].value
    true = bench.AREA * (0.1 + 0.09 * volts)
    assert area[volts >= commands[1]] == pytest.approx(true[volts >= commands[1]], rel=0.01)


@pytest.mark.parametrize("share", [LINE, bench.power(1.3)])
def test_the_area_at_a_command_that_was_not_reached_is_open(monkeypatch, share):
    """Up to 6 V only: the value is extrapolated, a remark says so, and the interval has no upper end."""
    monkeypatch.setattr(bench, "STEPS", tuple(v for v in bench.UP if v <= 6.0))
    result = found(share, 9)
    area = named(result)["valve_area"]
    assert area.high == np.inf
    # they are written to files, where NumPy's numbers have another form
    numbers = [x for e in (*result.estimates, *result.listed) for x in (e.value, e.sd, e.low, e.high)]
    assert {type(x) for x in numbers} == {float}
    assert area.low <= bench.AREA * share(np.array([6.0]))[0]
    assert any("no flow was measured above 6 V" in remark for remark in result.remarks)
    # where the last chord of 0.5 V leads in 4 V: its noise is eight times that of the areas, 0.02 % each
    last, before = share(np.array([6.0, 5.5]))
    assert area.value == pytest.approx(bench.AREA * (last + 8 * (last - before)), rel=0.01)


# at either transducer; the other sign is the other transducer
@pytest.mark.parametrize(("inlet", "outlet"), shards.few(ZEROS[:2], ZEROS, shards.search))
def test_a_zero_at_its_limit_has_its_uncertainty(inlet, outlet):
    """A zero as far off as declared: the interval of the area holds the truth and shows what it may do."""
    area = found(LINE, 1, (inlet, outlet)).estimates[0]
    assert area.low <= bench.AREA <= area.high
    # noise alone would be 0.02 %; 1 bar of 177 bar changes the area by 0.28 %
    assert area.high - area.low > 1e-3 * bench.AREA


# of either sign, and one that is none; the largest is more of the same
@pytest.mark.parametrize(
    ("zero", "is_one"),
    [(-2.0, True), (2.0, True), pytest.param(-3.0, True, marks=shards.search), (-9.0, False)],
)
def test_a_zero_outside_its_declaration_is_named(zero, is_one):
    """4 or 6 bar where 1 bar is declared: half of the prior once hid it; 18 bar have another cause."""
    told = faults(found(bench.power(1.0), zeros=(zero, -zero)))
    assert ("zero of a pressure sensor" in told) == is_one


# the line; of the others the curves below the fall are other ones
@pytest.mark.parametrize("share", shards.few([LINE], [LINE, bench.power(1.3), bench.FINE], shards.search))
def test_an_opening_that_falls_is_named(share):
    """4 % from 8 V to 10 V, once hidden by the curve that was made to rise; a rising one is not named."""

    def closing(v):
        return share(np.minimum(v, 8.0)) * (1 - 0.02 * np.maximum(v - 8.0, 0.0))

    assert "falling opening" in faults(found(closing, 1))
    assert "falling opening" not in faults(found(share, 1))


def test_resistances_between_two_steps_are_those_of_the_opening(monkeypatch):
    """C_R at 3 V of a line with steps at 2.75 and 3.5 V: the nearest point of a grid was up to 5 % off."""
    steps = (*np.arange(0.0, 2.01, 0.2), *np.arange(2.75, 10.0, 0.75), 10.0, 10.0)
    monkeypatch.setattr(bench, "STEPS", steps)
    estimates = named(found(bench.power(1.0, 0.7)))
    area = bench.AREA * bench.power(1.0, 0.7)(np.array([3.0]))[0]
    truth = bench.DENSITY / 2 / (bench.C_D * area) ** 2
    assert estimates["C_R(3 V)"].value == pytest.approx(truth, rel=5e-3)  # the noise, and zeros of 0.5 bar
