"""Runs of an accuracy that is asked for: against closed forms and the monolithic solution."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from orchestrator import Coupling, Problem, load, reference, run
from orchestrator.base.coupling import Suggestion
from orchestrator.engine import accuracy
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


@pytest.mark.parametrize(
    ("asked", "variants"),
    [(1e-2, {}), (1e-4, {}), (1e-3, {"boom_stick": "detailed", "supply": "engine_pump"})],
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
    monkeypatch.setattr(accuracy, "FIRST", ((0.0, Coupling("jacobi"), 1000),))
    result = run(open_oscillator, stop=10.0, record_step=0.1, accuracy=1e-3)
    assert "in run 1," not in result.card.notes[-1]
    assert deviation(result, exact) <= 1e-3


def test_too_many_runs(open_oscillator, monkeypatch):
    """If no run is accurate enough, the last error is told."""
    monkeypatch.setattr(accuracy, "MOST_RUNS", 1)
    monkeypatch.setattr(accuracy, "FIRST", ((0.0, Coupling("gauss-seidel"), 50),))
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
        with pytest.raises(Problem) as raised:
            run(open_oscillator, stop=1.0, **choice)
        assert str(raised.value).startswith(message)


def test_decisive_outputs_are_recorded(open_oscillator):
    """A selection of signals is extended by those to which the accuracy applies."""
    result = run(open_oscillator, stop=1.0, accuracy=1e-2, accuracy_of=["b.x"], record=["a.x"])
    assert list(result.trace.signals) == ["a.x", "b.x"]


@pytest.mark.parametrize(
    ("suggestion", "choices", "note"),
    [
        (Suggestion(), {}, True),
        (Suggestion(Coupling("gauss-seidel"), 1e-3), {}, False),
        (Suggestion(), {"step": 1e-3}, False),
        (Suggestion(), {"coupling": {"master": "jacobi"}}, False),
        (Suggestion(Coupling("gauss-seidel"), 1e-3), {"accuracy": 1e-2}, True),
    ],
)
def test_the_default_accuracy(fmu_dir, tmp_path, monkeypatch, suggestion, choices, note):
    """A default applies only if neither the user nor the system chooses; an accuracy overrides the system."""
    system = replace(load(fmu_dir / "harvester.ssp"), suggestion=suggestion)
    monkeypatch.setattr("orchestrator.engine.run.load", lambda _: system)
    out = tmp_path / "trace.csv"
    result, _ = run_to_file(
        fmu_dir / "harvester.ssp", None, out, stop=1.0, default_accuracy=1e-3, isolate=False, **choices
    )
    assert any(n.startswith("accuracy") for n in result.card.notes) == note
    assert [p.name for p in tmp_path.iterdir() if "partial" in p.name] == []


def test_failed_runs_leave_no_file(open_oscillator, tmp_path, monkeypatch):
    """A run that fails is followed by another one; its partial file is replaced."""
    goes_on = []
    judge = accuracy.AccuracySearch.judge

    def fail_once(self, result):
        if not goes_on:
            goes_on.append(True)
            assert self.goes_on()
            return None
        return judge(self, result)

    monkeypatch.setattr(accuracy.AccuracySearch, "judge", fail_once)
    monkeypatch.setattr("orchestrator.engine.run.load", lambda _: open_oscillator)
    out = tmp_path / "trace.csv"
    result, summary = run_to_file(tmp_path, None, out, stop=1.0, accuracy=1e-2, isolate=False)
    assert "in run 1," not in result.card.notes[-1]
    assert sorted(p.name for p in tmp_path.iterdir()) == ["trace.csv", "trace.run.json"]
    assert str(out) in summary
