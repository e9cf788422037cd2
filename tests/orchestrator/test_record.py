"""The record of a run: which points are kept, and that everything else still sees all of them."""

import math

import numpy as np
import pytest
from kit.mistakes import problem, table

from orchestrator import RunFailed, assemble, run
from orchestrator.engine.time_grid import record_interval


def assert_kept(kept, system, record_step, **options):
    """With a record step the trace equals the complete one at the points `kept`, bit for bit."""
    whole, thin = (run(system, record_step=r, **options).trace for r in (None, record_step))
    np.testing.assert_array_equal(thin.time, whole.time[kept])
    assert list(thin.signals) == list(whole.signals)
    for name, values in thin.signals.items():
        np.testing.assert_array_equal(values, whole[name][kept])


@pytest.mark.parametrize("every", [1, 2, 7, 256, 300])
def test_every_so_many_points_are_kept(oscillator, every):
    """Also if the size of a block is not a multiple of the interval."""
    kept = np.union1d(np.arange(0, 1501, every), 1500)
    assert_kept(kept, oscillator, every * 1e-3, step=1e-3, stop=1.5)


@table(__file__, "points", "step, interval, stop, kept")
def test_first_and_last_point_are_always_kept(oscillator, step, interval, stop, kept):
    """Whether or not the stop time is a multiple of the record step."""
    assert_kept(kept, oscillator, interval, step=step, start=0.0, stop=stop)


def test_a_run_may_record_nothing(oscillator):
    """It ends, with its card and an empty trace."""
    result = run(oscillator, record=[], step=1e-2, stop=0.1, isolate=False)
    assert (result.card.steps, dict(result.trace.signals)) == (10, {})


def test_other_kinds_of_numbers_are_kept_too(fmus):
    """Integers and Booleans have the same rows as Real signals."""
    start = {"types.int_in": 3}
    assert_kept([0, 3, 6, 9, 10], str(fmus["types"]), 0.3, step=0.1, stop=1.0, set=start)


@pytest.mark.parametrize("record_step", [0.025, 0.005, 0.0, -0.01, math.nan, math.inf])
def test_an_interval_that_is_no_multiple_is_refused(oscillator, record_step):
    """Between two steps there is nothing to record."""
    message = problem(lambda: run(oscillator, step=0.01, stop=1.0, record_step=record_step))
    assert message == f"record step: expected a multiple of the step 0.01 s, got {record_step:g} s"


def test_the_card_sees_every_step(oscillator):
    """Steps and energies do not depend on what is recorded."""
    whole, thin = (run(oscillator, step=1e-2, stop=2.0, record_step=r).card for r in (None, 0.1))
    assert (thin.steps, thin.simulated, thin.bonds) == (whole.steps, whole.simulated, whole.bonds)
    assert (whole.record_step, thin.record_step) == (0.01, 0.1)


@pytest.mark.parametrize(("every", "steps"), [(1, 2000), (4, 2000), (5, 2003)])
def test_the_error_estimate_compares_recorded_points(oscillator, every, steps):
    """It is the change at half the step at the recorded points, and the order stays that of the master."""
    step = 5e-4
    card = run(oscillator, step=step, stop=steps * step, record_step=every * step, error_estimate=True).card
    estimate = {e.name: e for e in card.errors}["a.x"]
    whole, fine = (run(oscillator, step=h, stop=steps * step).trace for h in (step, step / 2))
    kept = np.union1d(np.arange(0, steps + 1, every), steps)
    change = np.abs(fine["a.x"][2 * kept] - whole["a.x"][kept]).max()
    expected = change / np.ptp(fine["a.x"][2 * kept])
    assert estimate.largest == pytest.approx(expected, rel=1e-12)  # same numbers
    # first order; the second-order term is 5 % of the error at this step
    assert estimate.order == pytest.approx(1, abs=0.15)


def test_a_failure_keeps_the_last_point_reached(fmus):
    """Also one off the grid; of values that are no number the message has the time."""
    system = assemble({"bad": fmus["fails"]}, [])
    for when, steps, kept in ((0.55, 6, [0, 0.2, 0.4, 0.6]), (0.45, 5, [0, 0.2, 0.4, 0.5])):
        with pytest.raises(RunFailed, match=f"bad: the step failed at t = {0.1 * steps:g} s") as caught:
            run(system, step=0.1, stop=1.0, record_step=0.2, set={"bad.when": when, "bad.how": 3})
        result = caught.value.result
        np.testing.assert_allclose(result.trace.time, kept)
        assert (result.complete, result.card.steps) == (False, steps)
    with pytest.raises(RunFailed, match=r"fails.y: expected a finite value, got nan at t = 0.4 s") as caught:
        run(str(fmus["fails"]), step=0.1, stop=9.0, record_step=0.9, set={"fails.when": 0.25, "fails.how": 5})
    np.testing.assert_allclose(caught.value.result.trace.time, [0, 0.3])


@table(__file__, "default", "step, interval")
def test_default_interval_of_the_command_line(step, interval):
    """It is the largest multiple of the step up to 5 ms; invalid steps are refused elsewhere."""
    # products of the step: rounding only
    assert record_interval(step) == (pytest.approx(interval, rel=1e-12) if interval else None)
