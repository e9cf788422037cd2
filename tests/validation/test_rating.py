"""The rating of ISO/TS 18571, only where it is asked for; its numbers are those that its authors publish."""

import sys
from dataclasses import asdict, replace
from importlib import import_module
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from kit import shards
from kit.mistakes import problem
from validation.conftest import Edit

from orchestrator import compare
from orchestrator.base import extras
from orchestrator.data.description import Tolerance, read_description
from orchestrator.data.recording import read_recording
from orchestrator.data.trace import Trace
from orchestrator.results.comparison_report import report
from orchestrator.results.rating import FEWEST, PARTS, SAMPLES, Rating, rate
from orchestrator.results.validation import Validation, validate
from orchestrator.results.validation_report import validation_report

PACKAGE = "objective_rating_metrics"
TIME = np.linspace(0.0, 4.0, 400)
FOUND = Rating(0.7128, 0.7, 0.6, 0.9, 0.6643, "fair")
LIMIT = 'metric = "iso18571", limit = {}'


def wave(delay: float = 0.0, gain: float = 1.0) -> np.ndarray:
    """A decaying oscillation of 400 samples over 4 s."""
    t = TIME - delay
    return gain * np.sin(4 * t) * np.exp(-t / 4)


class Fake:
    """The package's class with fixed ratings; the real one compiles for 10 s in each process."""

    curves: tuple[np.ndarray, np.ndarray]
    dt: float
    rating = FOUND
    calls = 0

    def __init__(self, reference: np.ndarray, comparison: np.ndarray, dt: float) -> None:
        Fake.curves, Fake.dt, Fake.calls = (reference, comparison), dt, Fake.calls + 1

    def __getattr__(self, name: str):
        return lambda digits: getattr(Fake.rating, name.removesuffix("_rating")) if digits < 0 else None


@pytest.fixture
def fake(monkeypatch: pytest.MonkeyPatch) -> type[Fake]:
    """The package gives these ratings."""
    module = ModuleType(f"{PACKAGE}.rating")
    vars(module)["ISO18571"] = Fake
    monkeypatch.setitem(sys.modules, PACKAGE, ModuleType(PACKAGE))
    monkeypatch.setitem(sys.modules, f"{PACKAGE}.rating", module)
    monkeypatch.setattr(Fake, "rating", FOUND)
    monkeypatch.setattr(Fake, "calls", 0)
    monkeypatch.setattr(extras, "_installed", lambda _: True)
    return Fake


def test_curves_of_equal_steps_over_the_whole_time(fake: type[Fake]) -> None:
    """1000 samples of both, the reference first, also of a run with unequal steps."""
    time = TIME**2 / 4
    assert rate(time, 3 * time, 2 * time) == FOUND
    even = np.linspace(0.0, 4.0, SAMPLES)
    for curve, slope in zip(fake.curves, (2, 3), strict=True):
        # straight lines are interpolated exactly, but for rounding
        np.testing.assert_allclose(curve, np.column_stack((even, slope * even)), rtol=1e-12, atol=1e-12)
    assert fake.dt == pytest.approx(4.0 / 999, rel=1e-12)


def test_it_says_why_it_does_not_rate(fake: type[Fake], monkeypatch: pytest.MonkeyPatch) -> None:
    """Where the standard has no meaning; equal curves need no package."""
    assert rate(TIME, wave(), np.full(400, 3.0)) == Rating(reason="the reference is constant")
    few = slice(FEWEST - 1)
    assert rate(TIME[few], wave(0.1)[few], wave()[few]) == Rating(reason="29 samples are fewer than 30")
    assert rate(TIME, wave(), wave()) == Rating(1, 1, 1, 1, 1, "excellent")
    assert fake.calls == 0
    monkeypatch.setattr(Fake, "rating", replace(FOUND, slope=np.nan))
    told = "the shifted reference is constant, its slope cannot be rated"
    assert rate(TIME, wave(0.1), wave()) == Rating(reason=told)
    for overall, grade in {0.95: "excellent", 0.94: "good", 0.7: "fair", 0.58: "poor"}.items():
        monkeypatch.setattr(Fake, "rating", replace(FOUND, overall=overall))
        assert rate(TIME, wave(0.1), wave()).grade == grade


def test_nothing_is_rated_unasked(fake: type[Fake], outcome: Validation) -> None:
    """The JSON has null, and no text has the word."""
    assert all(row.metrics.iso18571 is None for row in outcome.rows)
    found = validation_report("", outcome)
    assert [signal["metrics"]["iso18571"] for signal in found.data["signals"]] == [None, None]
    assert "18571" not in found.text() + found.html()
    assert fake.calls == 0


def test_all_parts_in_text_page_and_json(fake: type[Fake], written: Path, trace: Trace) -> None:
    """With the grade; a signal without a rating has its reason."""
    reference = read_recording(written / "ref.csv")
    still = {**reference.signals, "pump.pressure": np.full(len(reference.time), 1e7)}
    found = validation_report("", validate(trace, replace(reference, signals=still), rate=True))
    first, second = (signal["metrics"]["iso18571"] for signal in found.data["signals"])
    assert first == asdict(FOUND)
    assert second == dict.fromkeys(PARTS) | {"reason": "the reference is constant", "grade": "not rated"}
    row = next(line for line in found.text().splitlines() if line.startswith("shaft.angle "))
    assert row.split() == ["shaft.angle", "0.713", "0.700", "0.600", "0.900", "0.664", "fair"]
    for shown in (found.text(), found.html()):
        assert "pump.pressure: not rated, the reference is constant" in shown
        assert all(word in shown for word in (*PARTS, "0.713", "fair"))
    assert fake.calls == 1


@pytest.mark.parametrize("name", ["iso18571", "iso"])
def test_a_limit_rates_its_signal_alone(fake: type[Fake], edited: Edit, trace: Trace, name: str) -> None:
    """A lower limit from 0 to 1, also by the name that older references have; a miss tells how much."""
    file = edited('metric = "nrmse", limit = 0.01', f'metric = "{name}", limit = 0.8')
    assert read_description(file).tolerances["angle"] == Tolerance("iso18571", 0.8)
    found = validate(trace, read_recording(file))
    assert (found["shaft.angle"].metrics.iso18571, found["pump.pressure"].metrics.iso18571) == (FOUND, None)
    assert found["shaft.angle"].passed is False
    # (1 - 0.7128) / (1 - 0.8), rounding
    assert found["shaft.angle"].limit_use == pytest.approx(1.436, rel=1e-9)
    text = validation_report("", found).text()
    assert "! shaft.angle: ISO/TS 18571 0.7128, limit 0.8 (0.0872 short)" in text
    assert fake.calls == 1
    assert validate(trace, read_recording(edited("limit = 0.8", "limit = 0.7"))).passed


@pytest.mark.usefixtures("fake")
def test_a_limit_without_a_rating_fails_with_its_reason(edited: Edit, trace: Trace) -> None:
    """A run of 20 samples cannot be judged by the standard."""
    file = edited('metric = "nrmse", limit = 0.01', LIMIT.format(0.8))
    short = Trace(trace.time[:200], {n: v[:200] for n, v in trace.signals.items()}, trace.units)
    told = "! shaft.angle: no ISO/TS 18571, limit 0.8 (20 samples are fewer than 30)"
    assert told in validation_report("", validate(short, read_recording(file))).text()


def test_a_comparison_rates_what_it_shows(fake: type[Fake], trace: Trace) -> None:
    """One table for each run; other signals are not rated."""
    other = replace(trace, signals={name: 1.1 * values for name, values in trace.signals.items()})
    found = report(compare({"a": trace, "b": other, "c": other}, signals="*.angle", rate=True))
    assert found.text().count("ISO/TS 18571, ") == 2
    assert "fair" in found.html()
    signals = found.data["runs"]["b"]["signals"]
    assert signals["shaft.angle"]["iso18571"]["grade"] == "fair"
    assert signals["pump.pressure"]["iso18571"] is None
    assert fake.calls == 2


def test_without_the_package_one_line_says_what_to_install(
    monkeypatch: pytest.MonkeyPatch, edited: Edit, trace: Trace
) -> None:
    """Before anything is computed, also for a limit in the description."""
    monkeypatch.setattr(extras, "_installed", lambda _: False)
    file = edited('metric = "nrmse", limit = 0.01', LIMIT.format(0.8))
    for call in (
        lambda: validate(trace, read_recording(file)),
        lambda: compare({"a": trace, "b": trace}, rate=True),
    ):
        told = f"the rating of ISO/TS 18571 needs the package {PACKAGE}; install with: pip install"
        assert problem(call) == f'{told} "harvester-cosim[rating]"'


@shards.machine
def test_the_examples_that_the_authors_publish() -> None:
    """README of objective-rating-metrics, ISO/TS 18571:2024, TU Graz: 0.713 and 0.815."""
    time = np.arange(0, 0.150, 0.0001)
    scaled = time, 1.3 * np.sin(20 * time), np.sin(20 * time)
    # 10 ms late; both begin at 30 ms and end at 170 ms
    late = time[:1400], np.sin(20 * time[:1400]), np.sin(20 * time[100:])
    rating = import_module(f"{PACKAGE}.rating")
    for (t, simulation, reference), published in ((scaled, 0.713), (late, 0.815)):
        curves = (np.column_stack((t, y)) for y in (reference, simulation))
        assert rating.ISO18571(*curves).overall_rating() == published
        # 1000 instead of 1500 samples: a shift is rounded to another step, of 0.5 % of the largest shift
        assert rate(t, simulation, reference).overall == pytest.approx(published, abs=0.002)


@shards.machine
def test_each_part_tells_what_is_wrong() -> None:
    """A delay costs phase, a wrong gain magnitude; an offset half way to the outer corridor 3/4 of it."""
    n, steps = SAMPLES, 50
    whole = np.linspace(0.0, 9.0, n + steps)
    signal = np.sin(whole) * np.linspace(1.0, 2.0, n + steps)
    t = whole[:n]
    late = rate(t, signal[:n], signal[steps:])
    # exact but for rounding: 50 of the 200 steps that the standard allows, and equal curves after the shift
    assert late.phase == pytest.approx(0.75, rel=1e-12)
    assert (late.magnitude, late.slope) == pytest.approx((1.0, 1.0), abs=1e-9)
    assert late.corridor < 1
    weak = rate(TIME, wave(gain=0.8), wave())
    # (0.5 - 0.2) / 0.5 for an error of 20 %; time warping finds nearer partners, so it is more
    assert weak.phase == 1
    assert 0.6 <= weak.magnitude < 0.9
    step = np.where(t < 2.0, 1.0, -1.0)
    assert rate(t, step + 0.275, step).corridor == pytest.approx(0.25, rel=1e-9)
    assert rate(TIME, np.zeros(400), wave()).grade == "poor"
    for found in (late, weak):
        weighted = 0.4 * found.corridor + 0.2 * (found.phase + found.magnitude + found.slope)
        assert found.overall == pytest.approx(weighted, rel=1e-12)
