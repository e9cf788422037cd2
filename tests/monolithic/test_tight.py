"""The tight co-simulation: its steps, its choice among the runs, the estimate of the error."""

from contextlib import nullcontext
from math import inf, nan

import numpy as np
import pytest
from kit.any_fmu.models import oscillation, oscillator_of
from kit.mistakes import table

from orchestrator import Coupling, Result, RunFailed, Trace, run
from orchestrator.base.errors import Problem
from orchestrator.engine.result import Card, SignalError
from orchestrator.fmi.interface import FmuInterface
from orchestrator.monolithic import reference as solving
from orchestrator.monolithic import tight
from orchestrator.monolithic.tight import estimated_error, first_step, master, tightened
from orchestrator.ssp.system import Component, System

SYSTEM = System("s", {"a": Component("a", FmuInterface({}))})


@table(__file__, "first_steps", "record_step, suggested, steps")
def test_the_first_step_divides_the_record_step(record_step, suggested, steps):
    """By the smallest whole number for which it exceeds neither the suggestion nor 1 ms."""
    assert first_step(record_step, suggested) == record_step / steps


def test_the_guard_gets_stricter_with_the_square_of_the_step():
    """From 1e-6 on; a quarter of the step has a sixteenth. Passes end at a thousandth of the bound 1e-6."""
    assert master(1.0) == Coupling("hermite", guard=1e-6, tolerance=1e-9)
    assert master(0.25).guard == 1e-6 / 16


@pytest.mark.parametrize(
    ("order", "factor"),
    [(None, 2), (0.5, 2), (1.0, 2), (2.0, 4 / 3), (3.0, 8 / 7), (4.0, 16 / 15), (6.0, 16 / 15)],
)
def test_the_error_follows_from_the_change_by_its_order(order, factor):
    """2^p / (2^p - 1) times the change, p from 1 to 4, the order of the master."""
    assert estimated_error(SignalError("y", 1.0, 0.3, order)) == pytest.approx(0.3 * factor, rel=1e-15)
    assert estimated_error(SignalError("y", 1.0, nan, order)) == inf


def outcome(step, steps):
    """The result of a run with a step and a number of steps."""
    return Result(SYSTEM, Trace(np.zeros(1), {}), Card("hermite", step, 0.1, steps, 1.0, 0.1))


@table(__file__, "best_runs", "errors, bound, best, tried")
def test_the_best_run_is_taken(monkeypatch, errors, bound, best, tried):
    """Until the estimate meets the bound or hardly falls; each run is compared with those beside it."""
    steps, compared = [], []

    def changes(*runs):
        compared.append([None if r is None else r.card.step for r in runs])
        return tuple(SignalError("y", 1.0, e / 2) for e in errors[len(compared) - 1 :][:1])

    def co_simulated(step, coupling):
        assert coupling == master(step / 0.25)
        steps.append(step)
        return outcome(step, 1)

    monkeypatch.setattr(tight, "changes", changes)
    result = tightened(co_simulated, 0.25, bound, "because")
    assert steps == [0.25 * 0.5**k for k in range(tried)]
    assert compared == [[*h] for h in zip([None, *steps], steps, steps[1:], strict=False)]
    assert result.card.step == 0.25 * 0.5**best
    expected = [inf if e != e else e for e in errors[best:][:1]]
    assert [estimated_error(e) for e in result.card.errors] == expected


@pytest.mark.parametrize(
    ("steps", "runs"),
    [([100_000, 300_000], 3), ([100_001, 300_000], 2), ([333_333], 2), ([333_334], 1), ([], 19)],
)
def test_all_runs_together_have_at_most_a_million_steps(monkeypatch, steps, runs):
    """The next has twice as many as the last. Those that fail at the start count 1, 2, 4 ... up to 2^18."""
    done, errors = [], iter([1.0, 0.1, 0.01, 0.001])

    def co_simulated(step, _):
        done.append(step)
        assert len(done) < 100
        if not steps:
            raise RunFailed(Problem("no solution"), outcome(step, 0))
        return outcome(step, [*steps, 10**6][len(done) - 1])

    monkeypatch.setattr(tight, "changes", lambda *_: (SignalError("y", 1.0, next(errors)),))
    with nullcontext() if steps else pytest.raises(RunFailed, match="no solution"):
        tightened(co_simulated, 1.0, 0.0, "because")
    assert len(done) == runs


def test_first_steps_may_fail_and_a_run_may_have_no_estimate():
    """Without a run at half the step the card says so, with the reason for the co-simulation."""

    def co_simulated(step, _):
        if step != 0.25:
            raise RunFailed(Problem("diverged"), outcome(step, 1))
        return outcome(step, 4)

    card = tightened(co_simulated, 1.0, 1e-5, "because").card
    assert card.step == 0.25
    assert "no estimate of its error" in card.notes[-1]
    assert card.notes[-1].endswith("reason: because")


def test_its_error_is_what_it_says(fmus):
    """Two masses without Model Exchange against their closed form: 4e-8 and 4e-7, estimated to 1 %."""
    result = solving.reference(oscillator_of(fmus["mass_a"], fmus["mass_b"]), record_step=0.01)
    truth = oscillation(result.time)
    for name, k in (("a.x", 0), ("b.x", 1)):
        rms = float(np.sqrt(np.mean((result[name] - truth[:, k]) ** 2)))
        claimed = next(estimated_error(e) for e in result.card.errors if e.name == name)
        assert claimed == pytest.approx(rms / np.ptp(truth[:, k]), rel=0.01)
        assert claimed < 1e-6


def test_the_solvers_in_the_fmus_get_a_tight_tolerance(fmus, monkeypatch):
    """1e-10, a ten-thousandth of the smallest bound; the steps divide the record step."""
    given = []

    def noted(system, scenario, **options):
        given.append(options)
        return run(system, scenario, **options)

    monkeypatch.setattr(solving, "run", noted)
    ramp = {"time": [0.0, 1.0], "u": [0.0, 1.0]}
    result = solving.reference(fmus["gain"], ramp, record_step=0.1, set={"gain.factor": 2.0})
    assert [g["step"] for g in given] == [0.1 / 100, 0.1 / 200]
    assert {(g["tolerance"], g["record_step"]) for g in given} == {(1e-10, 0.1)}
    assert result["gain.y"] == pytest.approx(2.0 * result.time, abs=1e-12)  # rounding
