"""Runs of an accuracy that is asked for: against closed forms and the monolithic solution."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from kit import shards
from kit.mistakes import problem

from orchestrator import Coupling, Problem, Result, Trace, load, reference, run
from orchestrator.base.coupling import Suggestion
from orchestrator.engine import accuracy as accuracy_search
from orchestrator.engine.result import Card, SignalError
from orchestrator.engine.run import run_to_file

SPEEDS = "manipulator.*_speed"


def deviation(result, exact):
    """The larger RMS error of both positions, over its range."""
    found = np.stack([result.trace["a.x"], result.trace["b.x"]], axis=1)
    mean = np.mean(np.square(found - exact(result.trace.time)), axis=0)
    return np.max(np.sqrt(mean) / np.ptp(found, axis=0))


@pytest.mark.parametrize("asked", [1e-2, 1e-4, 1e-6])
def test_an_oscillator_is_as_accurate_as_asked(open_oscillator, exact, asked):
    """An undamped oscillator keeps every error, and still the accuracy holds against the closed form."""
    result = run(open_oscillator, stop=10.0, record_step=0.1, accuracy=asked)
    assert deviation(result, exact) <= asked
    assert f"accuracy {asked:g} of" in result.card.notes[-1]


def test_steps_are_halved_without_an_estimate(moving, exact):
    """Without directional derivatives the change at half the step is the estimate."""
    result = run(moving, stop=10.0, record_step=0.1, accuracy=1e-4)
    assert not result.card.errors_of_inputs
    assert "in run 1" not in result.card.notes[-1]
    assert deviation(result, exact) <= 1e-4


def searched(system, accuracy, *errors):
    """The settings of the run that follows runs with these errors, over the accuracy; None if none does."""
    search = accuracy_search.AccuracySearch(system, accuracy, ["a.x"], None)
    for rms in accuracy * np.array(errors):
        found = {"errors": (SignalError("a.x", rms, rms, change=rms),), "errors_of_inputs": True}
        card = Card("any", search.settings.step, 0.0, 10, 1.0, 1.0, **found)
        if search.judge(Result(system, Trace(np.zeros(1), {}), card)) is not None:
            return None
    return search.settings


# of equal steps (of order 3) and of hermite's (of order 2): what is accepted, and the next step over the last
# one, which aims at 0.45 and 0.35 of the accuracy; the steps are 4 and 5 times the suggested one of 1 ms
@pytest.mark.parametrize(
    ("asked", "error", "step"),
    [
        (1e-3, 0.79, None),
        (1e-3, 0.81, 0.8 * 4e-3),  # at most that
        (1e-3, 1.25, 0.711379 * 4e-3),  # 0.36^(1/3)
        (1e-3, 3.6, 0.5 * 4e-3),
        (1e-4, 0.49, None),
        (1e-4, 0.51, 0.8 * 5e-3),
        (1e-4, 1.4, 0.5 * 5e-3),
    ],
)
def test_the_next_step(open_oscillator, asked, error, step):
    """By the order of convergence, as if nothing but the step mattered."""
    settings = searched(open_oscillator, asked, error)
    assert (
        settings is None if step is None else settings.step == pytest.approx(step, rel=1e-6)
    )  # the digits above


def test_adaptive_steps_follow_where_equal_ones_would_be_too_short(open_oscillator):
    """At a tenth of the accuracy beyond 50 times that error; then by the aim of 0.35, at most by half."""
    for errors, adaptive in (
        ((51.0,), 1e-4),
        ((51.0, 0.6), 0.5e-4),
        ((51.0, 1.4), 0.25e-4),
        ((51.0, 35.0), 1e-5),
    ):
        settings = searched(open_oscillator, 1e-3, *errors)
        assert settings.coupling.adaptive == pytest.approx(adaptive, rel=1e-9)  # rounding
    # equal steps below the suggested one: 4 ms times 0.09^(1/3) and 0.01^(1/3)
    assert searched(open_oscillator, 1e-3, 5.0).step == pytest.approx(1.79256e-3, rel=1e-5)
    assert searched(open_oscillator, 1e-3, 45.0).coupling.adaptive == pytest.approx(1e-4 / 45, rel=1e-9)


@pytest.mark.parametrize(("asked", "tolerance"), [(1e-6, 3e-8), (1e-3, 3e-5), (1e-7, 1e-8), (1e-1, 1e-4)])
def test_the_solvers_of_the_fmus_are_more_accurate_than_the_run(asked, tolerance):
    """By 3 % of the accuracy, within limits."""
    assert accuracy_search.fmu_tolerance(asked) == pytest.approx(tolerance, rel=1e-12)  # one product


@pytest.mark.parametrize(
    ("asked", "variants"),
    [
        (1e-2, {}),
        *(
            pytest.param(*case, marks=shards.machine)
            for case in ((1e-4, {}), (1e-3, {"boom_stick": "detailed", "supply": "engine_pump"}))
        ),
    ],
)
def test_the_machine_is_as_accurate_as_asked(fmu_dir, asked, variants):
    """The RMS error of the joint speeds is below the accuracy, against the monolithic solution."""
    inputs = {"time": [0.0, 0.5, 0.8, 2.0], "boom_command": [0.0, 0.0, 4.0, 4.0]}
    case = {"swap": variants, "stop": 2.0}
    result = run(fmu_dir / "harvester.ssp", inputs, accuracy=asked, accuracy_of=[SPEEDS], **case)
    true = reference(fmu_dir / "harvester.ssp", inputs, record_step=1e-3, **case).trace
    for name in ("manipulator.boom_speed", "manipulator.stick_speed"):
        t = result.trace.time
        error = result.trace[name] - np.interp(t, true.time, true[name])
        # linear interpolation over 1 ms: (pi 11 Hz 1 ms)^2 / 2 of an 11 Hz oscillation, 6e-4 of its
        # amplitude, which is below a tenth of the range
        limit = asked * np.ptp(true[name]) + 6e-5 * np.ptp(true[name])
        assert np.sqrt(np.trapezoid(np.square(error), t) / t[-1]) <= limit


def test_an_unstable_first_run_is_repeated(open_oscillator, exact, monkeypatch):
    """A first step beyond the limit of stability is followed by shorter ones, until the accuracy holds."""
    monkeypatch.setattr(accuracy_search, "FIRST", ((0.0, Coupling("jacobi"), 1000),))
    result = run(open_oscillator, stop=10.0, record_step=0.1, accuracy=1e-3)
    assert "in run 1," not in result.card.notes[-1]
    assert deviation(result, exact) <= 1e-3


def test_too_many_runs(open_oscillator, monkeypatch):
    """If no run is accurate enough, the last error is told."""
    monkeypatch.setattr(accuracy_search, "MOST_RUNS", 1)
    monkeypatch.setattr(accuracy_search, "FIRST", ((0.0, Coupling("gauss-seidel"), 50),))
    with pytest.raises(Problem, match=r"accuracy 1e-06: not reached in 1 runs; the last run has an error of"):
        run(open_oscillator, stop=2.0, accuracy=1e-6)


def test_what_follows_from_the_accuracy_is_not_chosen(open_oscillator):
    """Master and step together with an accuracy, wrong values and unknown outputs are refused."""
    for choice, message in (
        (
            {"accuracy": 1e-3, "master": "jacobi"},
            "accuracy 0.001: expected no master, which follows from it, got jacobi",
        ),
        ({"accuracy": 1e-3, "step": 0.1}, "accuracy 0.001: expected no step, which follows from it, got 0.1"),
        ({"accuracy": 1.0}, "accuracy: expected 1e-06 to 0.1, got 1"),
        ({"accuracy": 1e-3, "accuracy_of": ["c.*"]}, "accuracy of c.*: expected continuous outputs"),
        ({"accuracy_of": ["a.x"]}, "accuracy_of a.x: expected an accuracy, got none"),
    ):
        assert problem(lambda: run(open_oscillator, stop=1.0, **choice)).startswith(message)  # noqa: B023


def test_decisive_outputs_are_recorded(open_oscillator):
    """A selection of signals is extended by those to which the accuracy applies."""
    result = run(open_oscillator, stop=1.0, accuracy=1e-2, accuracy_of=["b.x"], record=["a.x"])
    assert list(result.trace.signals) == ["a.x", "b.x"]


SUGGESTED = Suggestion(Coupling("gauss-seidel"), 1e-3)


@pytest.mark.parametrize(
    ("suggestion", "choices", "note"),
    [
        (Suggestion(), {}, True),
        (SUGGESTED, {}, False),
        (Suggestion(), {"step": 1e-3}, False),
        (Suggestion(), {"coupling": {"master": "jacobi"}}, False),
        (SUGGESTED, {"accuracy": 1e-2}, True),
    ],
)
def test_the_default_accuracy(fmu_dir, tmp_path, monkeypatch, suggestion, choices, note):
    """A default applies only if neither the user nor the system chooses; an accuracy overrides the system."""
    system = replace(load(fmu_dir / "harvester.ssp"), suggestion=suggestion)
    monkeypatch.setattr("orchestrator.engine.run.load", lambda _: system)
    out = tmp_path / "trace.csv"
    options = {"stop": 0.2, "default_accuracy": 1e-3, "isolate": False} | choices
    result, _ = run_to_file(fmu_dir / "harvester.ssp", None, out, **options)
    assert any(n.startswith("accuracy") for n in result.card.notes) == note
    assert [p.name for p in tmp_path.iterdir() if "partial" in p.name] == []


def test_failed_runs_leave_no_file(open_oscillator, tmp_path, monkeypatch):
    """A run that fails is followed by another one; its partial file is replaced."""
    goes_on = []
    judge = accuracy_search.AccuracySearch.judge

    def fail_once(self, result):
        if not goes_on:
            goes_on.append(True)
            assert self.goes_on()
            return None
        return judge(self, result)

    monkeypatch.setattr(accuracy_search.AccuracySearch, "judge", fail_once)
    monkeypatch.setattr("orchestrator.engine.run.load", lambda _: open_oscillator)
    out = tmp_path / "trace.csv"
    result, summary = run_to_file(tmp_path, None, out, stop=1.0, accuracy=1e-2, isolate=False)
    assert "in run 1," not in result.card.notes[-1]
    assert sorted(p.name for p in tmp_path.iterdir()) == ["trace.csv", "trace.run.json"]
    assert str(out) in summary
