"""A run against its reference: alignment, units, limits."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from kit.mistakes import problem, table
from validation.conftest import Edit

from orchestrator import Result
from orchestrator.data.description import Tolerance
from orchestrator.data.recording import Criterion, Recording, read_recording
from orchestrator.data.trace import Trace
from orchestrator.engine.result import Card
from orchestrator.fmi.description import FmuVariable
from orchestrator.fmi.interface import FmuInterface
from orchestrator.monolithic.reference import SOLVER
from orchestrator.results.validate_system import LIMIT, monolithic_recording
from orchestrator.results.validation import Validation, by_variable, validate
from orchestrator.ssp.system import Component, System


def made(time: np.ndarray, values: np.ndarray, unit: str = "m", limit: Tolerance | None = None, **more):
    """A reference of the one signal `a.x`."""
    criteria = {"a.x": Criterion(tolerance=limit)}
    return Recording(time, {"a.x": values}, {"a.x": unit}, Path("ref.csv"), criteria=criteria, **more)


def metres(time: np.ndarray, values: np.ndarray) -> Trace:
    """A run of the one signal `a.x`."""
    return Trace(time, {"a.x": values}, {"a.x": "m"})


def test_units_are_converted_to_those_of_the_run(outcome: Validation) -> None:
    """Degrees and bar of the file meet rad and Pa of the run: no error but the 1 bar put in."""
    # 12 digits in the CSV
    assert outcome["shaft.angle"].metrics.maximum_error == pytest.approx(0, abs=1e-11)
    assert outcome["pump.pressure"].metrics.maximum_error == pytest.approx(1e5, rel=1e-6)
    assert outcome["pump.pressure"].unit == "Pa"


def test_limit_in_the_files_unit(outcome: Validation, edited: Edit, trace: Trace) -> None:
    """A limit of 2 bar holds for 1 bar of error, a limit of 0.9 bar does not, and the whole run fails."""
    assert outcome.passed
    assert outcome["pump.pressure"].tolerance == Tolerance("maximum", 2e5)
    strict = validate(trace, read_recording(edited("limit = 2.0", "limit = 0.9")))
    assert not strict.passed
    assert [row.signal for row in strict.failed] == ["pump.pressure"]
    assert strict.verdict == "fail: 1 of 2 signals within their limits"


def test_compares_at_the_coarser_samples(outcome: Validation) -> None:
    """The 10 ms of the reference, not the 1 ms of the run; a coarser run is compared at its own samples."""
    assert len(outcome["shaft.angle"].time) == 201
    assert outcome.notes == ("compared at the 201 samples of the reference, 0 to 2 s",)
    fine = np.linspace(0, 1, 101)
    found = validate(metres(fine[::20], fine[::20]), made(fine, fine))
    assert len(found["a.x"].time) == 6
    assert found["a.x"].metrics.maximum_error < 1e-15  # a straight line is interpolated exactly


def test_time_offset_aligns_a_shifted_recording(edited: Edit, trace: Trace) -> None:
    """A recording that started 0.25 s late fits after its offset, and the window is what both share."""
    folder = edited("[reference]", "[time]\noffset = 0.25\n[reference]").parent
    t = trace.time[250::10]
    angle = np.degrees(trace["shaft.angle"][250::10])
    table = pd.DataFrame({"time": t - 0.25, "shaft.angle": angle, "pump.pressure": 100.0})
    table.to_csv(folder / "ref.csv", float_format="%.12g", index=False)
    found = validate(trace, read_recording(folder / "ref.csv"))
    assert found["shaft.angle"].metrics.maximum_error < 1e-11  # 12 digits in the CSV
    assert found.window == pytest.approx((0.25, 2.0))
    told = "only a part was compared: the run covers 0 to 2 s; the reference covers 0.25 to 2 s"
    assert found.notes[1] == told


def test_window_narrows_the_comparison() -> None:
    """Outside nothing counts, so a wild start does no harm; a last time that is rounded is inside."""
    t = np.linspace(0, 10, 101)
    run = metres(t, np.where(t < 2, 99.0, t))
    found = validate(run, made(t, t, start=2.0, stop=8.0))
    assert found.window == (2.0, 8.0)
    assert found["a.x"].metrics.maximum_error == 0
    assert "only a part was compared" in found.notes[1]
    run, rounded = metres(np.arange(4) * 0.1, np.arange(4.0)), np.array([0.0, 0.1, 0.2, 0.3])
    found = validate(run, made(rounded, np.arange(4.0)))
    assert (len(found["a.x"].time), len(found.notes)) == (4, 1)


def test_interpolation_is_said() -> None:
    """A 50 Hz reference meets a 200 Hz record as it is; of others a note says how many lie between."""
    run_time, time = np.arange(2101) * 5e-3, np.array([float(f"{k * 0.02:.9g}") for k in range(526)])
    rough = np.random.default_rng(0).standard_normal(len(run_time))
    found = validate(metres(run_time, rough), made(time, rough[::4]))
    # times of the file are rounded in their last bit: an ulp of time times the slope of the noise
    assert found["a.x"].metrics.maximum_error < 1e-11
    assert len(found.notes) == 1
    t = np.linspace(0, 1, 101)
    found = validate(metres(t, t), made(np.array([0.0, 0.25, 0.333, 1.0]), np.zeros(4)))
    assert found.notes[1] == "1 of them are between samples of the run: interpolated linearly"


def test_nrmse_is_over_the_range_of_the_whole_reference() -> None:
    """Not of a run that ends early, nor of what the file cuts off as no part of the measurement."""
    t = np.linspace(0, 10, 1001)
    moves = np.where(t < 5, 0.0, t - 5)
    row = validate(metres(t[:200], moves[:200] + 1e-15), made(t, moves))["a.x"]
    assert row.metrics.normalised_by == 5.0
    assert row.metrics.nrmse == pytest.approx(2e-16)  # 1e-15 m over 5 m
    assert (row.metrics.fit, row.metrics.vaf) == (None, None)
    assert row.notes == ("the reference is constant in this window: no fit or VAF",)
    t = np.linspace(0, 10, 101)
    wild = np.where(t < 2, 99.0, t)
    row = validate(metres(t[:50], t[:50]), made(t, wild, start=2.0))["a.x"]
    assert row.metrics.normalised_by == 8.0


def test_what_cannot_be_compared_is_refused(trace: Trace) -> None:
    """Recordings that do not overlap, by their spans and the window asked for; a pressure and a length."""
    run = metres(np.array([0.0, 1.0]), np.zeros(2))
    expected = r"ref.csv: expected two or more .* got 0; the run covers 0 to 1 s; the reference"
    problem(lambda: validate(run, made(np.array([5.0, 6.0]), np.zeros(2))), expected)
    late = made(run.time, np.zeros(2), start=3.0)
    problem(lambda: validate(run, late), "the requested window begins at 3 s")
    expected = "ref.csv: a.x: unit 'bar' cannot be converted, expected a unit like 'm'"
    problem(lambda: validate(run, made(run.time, np.zeros(2), "bar")), expected)
    # a signal that the run does not have is named, with those that it could be
    reference = Recording(trace.time, {"shaft.angel": trace.time}, {"shaft.angel": "rad"}, Path("ref.csv"))
    expected = r"ref.csv: no signal shaft.angel in .*; did you mean shaft.angle\?"
    problem(lambda: validate(trace, reference), expected)


def test_a_row_is_found_by_its_name_with_or_without_component(trace: Trace) -> None:
    """An unknown name is told with a similar one, and a name that two components have with both."""
    found = validate(trace, trace)
    assert found["angle"] is found["shaft.angle"]
    problem(lambda: found["angel"], r"^no signal angel in the validation; did you mean shaft\.angle\?$")
    two = Trace(trace.time, {"a.x": trace.time, "b.x": trace.time})
    with pytest.raises(KeyError, match=r"^x is in 2 components: a\.x, b\.x$"):
        validate(two, two)["x"]


def test_missing_unit_of_the_run_is_said() -> None:
    """A run without unit is taken in the unit of the reference, and a note says so."""
    run = Trace(np.array([0.0, 1.0]), {"a.x": np.array([0.0, 2.0])})
    row = validate(run, made(run.time, run["a.x"], "bar"))["a.x"]
    assert row.notes == ("the run has no unit, 'bar' of the reference is assumed",)
    assert row.metrics.maximum_error == 0


def test_nan_in_the_run_is_refused(trace: Trace, folder: Path) -> None:
    """A run that went wrong is refused with signal and time, not compared."""
    broken = trace["shaft.angle"].copy()
    broken[1234] = np.nan
    run = replace(trace, signals={**trace.signals, "shaft.angle": broken})
    told = problem(lambda: validate(run, read_recording(folder / "ref.csv")))
    assert "run: shaft.angle: expected finite numbers, got nan at 1.234 s" in told


@table(__file__, "metrics", "metric, good, bad")
def test_every_metric_can_be_a_limit(metric: str, good: float, bad: float) -> None:
    """Errors have an upper limit; fit and VAF a lower one."""
    t = np.linspace(0, 6, 300)
    run = metres(t, np.sin(t) + 0.05)
    for limit, passed in ((good, True), (bad, False)):
        found = validate(run, made(t, np.sin(t), limit=Tolerance(metric, limit)))
        assert found.passed is passed


def test_relative_limit_needs_a_reference_off_zero() -> None:
    """A relative error of 1 % passes a limit of 2 %; where the reference crosses zero the limit is missed."""
    t = np.linspace(0, 1, 50)
    for base, passed in ((2.0, True), (0.0, False)):
        y = base + t
        run, limit = metres(t, y * 1.01 + (0 if base else 0.01)), Tolerance("maximum_relative", 0.02)
        assert validate(run, made(t, y, limit=limit)).passed is passed


def test_gaps_of_the_reference_are_left_out() -> None:
    """Missing samples are not compared, whether the samples are the reference's or those of a coarser run."""
    t = np.linspace(0, 1, 101)
    values = np.where((t > 0.305) & (t < 0.395), np.nan, t)  # nine samples, 0.31 to 0.39 s
    fine = metres(np.linspace(0, 1, 1001), np.linspace(0, 1, 1001) + 0.5)
    row = validate(fine, made(t, values))["a.x"]
    assert (len(row.time), row.notes[0]) == (92, "9 of 101 samples are in gaps of the reference, left out")
    # a straight line is interpolated exactly, but for rounding
    assert row.metrics.rmse == pytest.approx(0.5, rel=1e-12)
    coarse = metres(t[::5], t[::5])
    row = validate(coarse, made(t, values))["a.x"]
    assert set(t[::5]) - set(row.time) == {t[35]}  # 0.30 s and 0.40 s have their samples
    assert row.metrics.maximum_error < 1e-15
    nothing = made(t, np.full(101, np.nan))
    problem(lambda: validate(coarse, nothing), r"ref.csv: a.x: expected two or more samples .* got 0")


def test_without_limits_nothing_is_judged() -> None:
    """No limit, no verdict: the run is not called good, and it does not fail either."""
    t = np.array([0.0, 1.0])
    found = validate(metres(t, t), made(t, t + 5))
    told = "not judged: the reference has no limits (keys tolerance, or group and [tolerances])"
    assert (found.passed, found.judged, found.verdict) == (True, (), told)


def test_the_run_of_one_fmu_under_the_names_of_a_system() -> None:
    """A signal, its values and its unit get the wanted name, whatever the component; others keep theirs.

    Two wanted names of one variable stay unknown: it is not compared with the flows of two components.
    """
    time = np.array([0.0, 1.0])
    run = Trace(time, {"all.angle": time, "all.flow": 2 * time, "all.own": 3 * time}, {"all.angle": "rad"})
    found = by_variable(run, ["arm.angle", "arm.angle"])
    assert set(found.signals) == {"arm.angle", "all.flow", "all.own"}
    np.testing.assert_array_equal(found["arm.angle"], time)
    assert found.units == {"arm.angle": "rad"}
    assert set(by_variable(run, ["pump.flow", "motor.flow"]).signals) == set(run.signals)


# ---- The monolithic solution as the reference of a run: compared signals, limits, constant outputs

TIME = np.linspace(0.0, 1.0, 11)
SHIPPED = Recording(
    TIME,
    {"arm.angle": TIME, "arm.command": TIME},
    {"arm.angle": "rad", "arm.command": "V"},
    Path("shipped.csv"),
    criteria={"arm.angle": Criterion("Angle", "angle", tolerance=Tolerance("nrmse", 0.001))},
)


def solved(name: str = "arm", master: str = SOLVER, **signals: float) -> Result:
    """A solution with outputs that grow at a rate each, or are constant if it is 0; `still` has a nominal."""
    variables = {n: FmuVariable(n, causality="output") for n in signals}
    if "still" in variables:
        variables["still"] = FmuVariable("still", causality="output", attributes={"nominal": "100"})
    system = System("s", {name: Component(name, FmuInterface(variables))})
    trace = Trace(TIME, {f"{name}.{n}": 3.0 + rate * TIME for n, rate in signals.items()})
    return Result(system, trace, Card(master=master, step=0.1, steps=10, simulated=1.0, wall=0.1))


def test_without_shipped_signals_all_outputs_are_compared():
    """With one limit, which an option changes."""
    recording = monolithic_recording(solved("other", x=1.0, y=2.0), SHIPPED)
    assert set(recording.criteria) == {"other.x", "other.y"}
    for limit in (None, 1e-4):
        found = monolithic_recording(solved("other", x=1.0), SHIPPED, limit=limit).criteria["other.x"]
        assert found == Criterion(tolerance=Tolerance("nrmse", limit or LIMIT))


@pytest.mark.parametrize("limit", [None, 1e-4])
def test_shipped_signals_keep_labels_and_limits(limit):
    """Others have 1 %, and an option changes the limit; also those of a single FMU with another name."""
    for name in ("arm", "whole"):
        recording = monolithic_recording(solved(name, angle=1.0, x=1.0), SHIPPED, limit=limit)
        tolerance, other = (Tolerance("nrmse", limit or usual) for usual in (0.001, 0.01))
        # over its range in the shipped reference; with a limit over its own
        angle = Criterion("Angle", "angle", None if limit else 1.0, tolerance, 1e-3 if limit else 0.0)
        assert recording.criteria == {"arm.angle": angle, f"{name}.x": Criterion(tolerance=other)}


def test_constant_outputs_are_judged_by_their_magnitude():
    """A run that leaves a constant fails, and rounding does not: range 0 would make it infinite."""
    truth = solved("other", still=0.0, plain=0.0)
    recording = monolithic_recording(truth, SHIPPED)
    assert {n: c.span for n, c in recording.criteria.items()} == {"other.still": 100.0, "other.plain": 3.0}
    for error, passed in ((1e-14, True), (1.1, False)):
        run = Trace(TIME, {n: v + error * np.sin(99 * TIME) for n, v in truth.trace.signals.items()})
        assert validate(run, recording).passed is passed


def test_the_title_and_the_signals_compared():
    """A co-simulation is told where an FMU has no Model Exchange; signals that the run lacks are left out."""
    titles = [monolithic_recording(solved(master=m, x=1.0), SHIPPED).heading for m in (SOLVER, "hermite")]
    assert titles == ["Monolithic solution of the FMUs", "Co-simulation with a small step"]
    truth = solved("other", x=1.0, state=2.0)
    run = truth.trace.select(["other.x"])
    assert [row.signal for row in validate(run, truth).rows] == ["other.x"]
