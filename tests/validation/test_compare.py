"""A run against its reference: alignment, units, limits."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from orchestrator.base.errors import Problem
from orchestrator.data.description import Tolerance
from orchestrator.data.recording import Criterion, Recording, read_recording
from orchestrator.data.trace import Trace
from orchestrator.results.validation import Validation, validate

Edit = Callable[[str, str], Path]


def made(
    time: np.ndarray, values: np.ndarray, unit: str = "m", limit: Tolerance | None = None, **more: float
) -> Recording:
    """A reference of the one signal `a.x`."""
    criteria = {"a.x": Criterion(tolerance=limit)}
    return Recording(Path("ref.csv"), time, {"a.x": values}, {"a.x": unit}, criteria=criteria, **more)


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
    strict = validate(trace, read_recording(edited("limit = 2.0", "limit = 0.9")), rate=False)
    assert not strict.passed
    assert [row.signal for row in strict.failed] == ["pump.pressure"]
    assert strict.verdict == "fail: 1 of 2 signals within their limits"


def test_compares_at_the_coarser_samples(outcome: Validation) -> None:
    """The 10 ms of the reference are used, not the 1 ms of the run."""
    assert len(outcome["shaft.angle"].time) == 201
    assert outcome.notes == ("compared at the 201 samples of the reference, 0 to 2 s",)


def test_coarse_run_against_fine_reference() -> None:
    """A run coarser than its reference is compared at its own samples."""
    fine = np.linspace(0, 1, 101)
    run = Trace(fine[::20], {"a.x": fine[::20]}, {"a.x": "m"})
    found = validate(run, made(fine, fine), rate=False)
    assert len(found["a.x"].time) == 6
    assert found["a.x"].metrics.maximum_error < 1e-15  # a straight line is interpolated exactly


def test_time_offset_aligns_a_shifted_recording(edited: Edit, trace: Trace) -> None:
    """A recording that started 0.25 s late fits after its offset, and the window is what both share."""
    folder = edited("[reference]", "[time]\noffset = 0.25\n[reference]").parent
    t = trace.time[250::10]
    table = np.column_stack((t - 0.25, np.degrees(trace["shaft.angle"][250::10]), np.full(len(t), 100.0)))
    np.savetxt(folder / "ref.csv", table, "%.12g", ",", header="time,shaft.angle,pump.pressure", comments="")
    found = validate(trace, read_recording(folder / "ref.csv"), rate=False)
    assert found["shaft.angle"].metrics.maximum_error < 1e-11  # 12 digits in the CSV
    assert found.window == pytest.approx((0.25, 2.0))
    assert found.notes[1] == (
        "only a part was compared: the run covers 0 to 2 s; the reference covers 0.25 to 2 s"
    )


def test_window_narrows_the_comparison() -> None:
    """Outside start and stop nothing counts, so a wild start-up does no harm."""
    t = np.linspace(0, 10, 101)
    run = Trace(t, {"a.x": np.where(t < 2, 99.0, t)}, {"a.x": "m"})
    found = validate(run, made(t, t, start=2.0, stop=8.0), rate=False)
    assert found.window == (2.0, 8.0)
    assert found["a.x"].metrics.maximum_error == 0
    assert "only a part was compared" in found.notes[1]


def test_rounded_times_do_not_cut_the_last_sample() -> None:
    """A last time of 0.3 in the CSV and 0.30000000000000004 in the run are the same instant."""
    run = Trace(np.arange(4) * 0.1, {"a.x": np.arange(4.0)}, {"a.x": "m"})
    found = validate(run, made(np.array([0.0, 0.1, 0.2, 0.3]), np.arange(4.0)), rate=False)
    assert len(found["a.x"].time) == 4
    assert len(found.notes) == 1


def test_coincident_samples_are_compared_as_they_are() -> None:
    """A 50 Hz reference meets every fourth point of a 200 Hz record; nothing is interpolated."""
    run_time, time = np.arange(2101) * 5e-3, np.array([float(f"{k * 0.02:.9g}") for k in range(526)])
    rough = np.random.default_rng(0).standard_normal(len(run_time))
    found = validate(Trace(run_time, {"a.x": rough}, {"a.x": "m"}), made(time, rough[::4]), rate=False)
    # times of the file are rounded in their last bit: an ulp of time times the slope of the noise
    assert found["a.x"].metrics.maximum_error < 1e-11
    assert len(found.notes) == 1


def test_interpolation_is_said() -> None:
    """Where the samples of the two do not meet, a note says how many lie between."""
    t = np.linspace(0, 1, 101)
    found = validate(Trace(t, {"a.x": t}, {"a.x": "m"}), made(np.array([0.0, 0.25, 0.333, 1.0]), np.zeros(4)))
    assert found.notes[1] == "1 of them are between samples of the run: interpolated linearly"


def test_nrmse_is_over_the_range_of_the_whole_reference() -> None:
    """A run that ends before the signal changes is not judged by the range of its rounding errors."""
    t = np.linspace(0, 10, 1001)
    moves = np.where(t < 5, 0.0, t - 5)
    run = Trace(t[:200], {"a.x": moves[:200] + 1e-15}, {"a.x": "m"})
    row = validate(run, made(t, moves))["a.x"]
    assert row.metrics.normalised_by == 5.0
    assert row.metrics.nrmse == pytest.approx(2e-16)  # 1e-15 m over 5 m
    assert (row.metrics.fit, row.metrics.vaf, row.metrics.iso.overall) == (None, None, None)
    assert row.notes == ("the reference is constant in this window: no fit, VAF or ISO rating",)


def test_the_range_is_that_of_the_window_of_the_file() -> None:
    """What the file cuts off as no part of the measurement does not widen the range."""
    t = np.linspace(0, 10, 101)
    wild = np.where(t < 2, 99.0, t)
    run = Trace(t[:50], {"a.x": t[:50]}, {"a.x": "m"})
    assert validate(run, made(t, wild, start=2.0), rate=False)["a.x"].metrics.normalised_by == 8.0


def test_no_common_window_is_refused() -> None:
    """Recordings that do not overlap are named with their spans and the window asked for."""
    run = Trace(np.array([0.0, 1.0]), {"a.x": np.zeros(2)}, {"a.x": "m"})
    with pytest.raises(
        Problem, match=r"ref.csv: expected two or more .* got 0; the run covers 0 to 1 s; the reference"
    ):
        validate(run, made(np.array([5.0, 6.0]), np.zeros(2)))
    with pytest.raises(Problem, match="the requested window begins at 3 s"):
        validate(run, made(np.array([0.0, 1.0]), np.zeros(2), start=3.0))


def test_unknown_signal_is_refused(trace: Trace) -> None:
    """A signal that the run does not have is named, with those that it could be."""
    time = trace.time[::10]
    reference = Recording(Path("ref.csv"), time, {"shaft.angel": time}, {"shaft.angel": "rad"})
    with pytest.raises(Problem, match=r"ref.csv: no signal shaft.angel in .*; did you mean shaft.angle\?"):
        validate(trace, reference)


def test_wrong_quantity_is_refused() -> None:
    """A pressure cannot be compared with a length."""
    run = Trace(np.array([0.0, 1.0]), {"a.x": np.zeros(2)}, {"a.x": "m"})
    with pytest.raises(
        Problem, match=r"ref.csv: a.x: unit 'bar' cannot be converted, expected a unit like 'm'"
    ):
        validate(run, made(run.time, np.zeros(2), "bar"))


def test_missing_unit_of_the_run_is_said() -> None:
    """A run without unit is taken in the unit of the reference, and a note says so."""
    run = Trace(np.array([0.0, 1.0]), {"a.x": np.array([0.0, 2.0])})
    row = validate(run, made(run.time, run["a.x"], "bar"), rate=False)["a.x"]
    assert row.notes == ("the run has no unit, 'bar' of the reference is assumed",)
    assert row.metrics.maximum_error == 0


def test_nan_in_the_run_is_refused(trace: Trace, folder: Path) -> None:
    """A run that went wrong is refused with signal and time, not compared."""
    broken = trace["shaft.angle"].copy()
    broken[1234] = np.nan
    run = replace(trace, signals={**trace.signals, "shaft.angle": broken})
    with pytest.raises(Problem, match=r"run: shaft.angle: expected finite numbers, got nan at 1.234 s"):
        validate(run, read_recording(folder / "ref.csv"))


@pytest.mark.parametrize(
    ("metric", "good", "bad"),
    [
        ("nrmse", 0.03, 0.02),
        ("rmse", 0.06, 0.04),
        ("maximum", 0.06, 0.04),
        ("fit", 90, 95),
        ("vaf", 99.9, 100.1),
        ("iso", 0.9, 1.01),
    ],
)
def test_every_metric_can_be_a_limit(metric: str, good: float, bad: float) -> None:
    """Errors have an upper limit; fit, VAF and rating a lower one."""
    t = np.linspace(0, 6, 300)
    run = Trace(t, {"a.x": np.sin(t) + 0.05}, {"a.x": "m"})
    for limit, passed in ((good, True), (bad, False)):
        found = validate(run, made(t, np.sin(t), limit=Tolerance(metric, limit)), rate=metric == "iso")
        assert found.passed is passed


def test_relative_limit_needs_a_reference_off_zero() -> None:
    """A relative error of 1 % passes a limit of 2 %; where the reference crosses zero the limit is missed."""
    t = np.linspace(0, 1, 50)
    for base, passed in ((2.0, True), (0.0, False)):
        y = base + t
        run = Trace(t, {"a.x": y * 1.01 + (0 if base else 0.01)}, {"a.x": "m"})
        limit = Tolerance("maximum_relative", 0.02)
        assert validate(run, made(t, y, limit=limit), rate=False).passed is passed


def test_gaps_of_the_reference_are_left_out() -> None:
    """Missing samples are not compared, whether the samples are the reference's or those of a coarser run."""
    t = np.linspace(0, 1, 101)
    values = np.where((t > 0.305) & (t < 0.395), np.nan, t)  # nine samples, 0.31 to 0.39 s
    fine = Trace(np.linspace(0, 1, 1001), {"a.x": np.linspace(0, 1, 1001) + 0.5}, {"a.x": "m"})
    row = validate(fine, made(t, values))["a.x"]
    assert (len(row.time), row.notes[0]) == (92, "9 of 101 samples are in gaps of the reference, left out")
    # a straight line is interpolated exactly, but for rounding
    assert row.metrics.rmse == pytest.approx(0.5, rel=1e-12)
    assert row.metrics.iso.overall is not None
    coarse = Trace(t[::5], {"a.x": t[::5]}, {"a.x": "m"})
    row = validate(coarse, made(t, values), rate=False)["a.x"]
    assert set(t[::5]) - set(row.time) == {t[35]}  # 0.30 s and 0.40 s have their samples
    assert row.metrics.maximum_error < 1e-15
    with pytest.raises(Problem, match=r"ref.csv: a.x: expected two or more samples .* got 0"):
        validate(coarse, made(t, np.full(101, np.nan)))


def test_without_limits_nothing_is_judged() -> None:
    """No limit, no verdict: the run is not called good, and it does not fail either."""
    t = np.array([0.0, 1.0])
    found = validate(Trace(t, {"a.x": t}, {"a.x": "m"}), made(t, t + 5), rate=False)
    assert found.passed
    assert found.judged == ()
    assert found.verdict == "not judged: the reference has no limits"
