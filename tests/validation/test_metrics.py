"""The numbers of a comparison, against values worked out by hand and against what must always hold."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from kit.mistakes import problem

from orchestrator.results.metrics import Metrics, measure

TIME = np.array([0.0, 1.0, 2.0, 3.0])
REFERENCE = np.array([0.0, 2.0, 4.0, 2.0])


def numbers(simulation: np.ndarray, reference: np.ndarray = REFERENCE, span: float | None = None) -> Metrics:
    """Metrics on a time axis of whole seconds."""
    time = np.arange(len(reference), dtype=float)
    return measure(time, simulation, reference, span=span, where="ref.csv: x")


def test_hand_computed_values() -> None:
    """Error (0, 1, -1, 0) on the reference (0, 2, 4, 2): mean 2, range 4, sum of squares about the mean 8."""
    found = numbers(np.array([0.0, 3.0, 3.0, 2.0]))
    # rounding only
    assert (found.maximum_error, found.time_of_maximum, found.maximum_relative) == (1.0, 1.0, 0.5)
    assert found.rmse == pytest.approx(np.sqrt(0.5), rel=1e-14)
    assert found.nrmse == pytest.approx(np.sqrt(0.5) / 4, rel=1e-14)
    assert found.fit == pytest.approx(50.0, rel=1e-14)  # 100 (1 - sqrt(2) / sqrt(8))
    assert found.vaf == pytest.approx(75.0, rel=1e-14)  # 100 (1 - 0.5 / 2)
    assert found.notes == ()


def test_an_offset_and_perfect_agreement() -> None:
    """VAF does not see an offset, which has no relative size at zero; equal signals have full marks."""
    found = numbers(REFERENCE + 1)
    assert found.maximum_relative is None
    assert found.vaf == pytest.approx(100.0, rel=1e-14)  # rounding only
    assert found.fit == pytest.approx(100 * (1 - 2 / np.sqrt(8)), rel=1e-14)
    found = measure(TIME, REFERENCE, REFERENCE, where="x")
    assert (found.maximum_error, found.rmse, found.nrmse, found.maximum_relative) == (0, 0, 0, 0)
    assert (found.fit, found.vaf) == (100, 100)


SIGNALS = st.lists(st.floats(-100, 100), min_size=5, max_size=5).map(np.array)


@given(y=SIGNALS, e=SIGNALS, scale=st.sampled_from([-7.0, -1.0, 1e-5, 1e5]), shift=st.floats(-50, 50))
def test_normalised_numbers_do_not_depend_on_the_unit(y, e, scale: float, shift: float) -> None:
    """NRMSE, fit and VAF stay the same when both signals are scaled and shifted, as by a change of unit."""
    y = y + np.array([0.0, 10.0, 0.0, 0.0, 0.0])
    if np.ptp(y) < 1:
        return
    a, b = numbers(y + e, y), numbers(scale * (y + e) + scale * shift, scale * (y + shift))
    # rounding: the error e is a difference of numbers up to 2e2, so it carries about 1e-13
    assert b.nrmse == pytest.approx(a.nrmse, rel=1e-9, abs=1e-12)
    assert b.fit == pytest.approx(a.fit, rel=1e-9, abs=1e-9)
    assert b.vaf == pytest.approx(a.vaf, rel=1e-9, abs=1e-7)
    assert b.rmse == pytest.approx(abs(scale) * a.rmse, rel=1e-9, abs=abs(scale) * 1e-12)


@given(y=SIGNALS, e=SIGNALS)
def test_sign_and_order_of_the_error_do_not_matter(y: np.ndarray, e: np.ndarray) -> None:
    """Too high and too low count alike, and so does time running backwards; RMSE is at most the maximum."""
    up, down, back = numbers(y + e, y), numbers(y - e, y), numbers((y + e)[::-1].copy(), y[::-1].copy())
    # rounding of y +- e, whose numbers are up to 2e2
    assert [down.rmse, back.rmse] == pytest.approx([up.rmse] * 2, abs=1e-12)
    assert down.maximum_error == pytest.approx(up.maximum_error, abs=1e-12)
    assert 0 <= up.rmse <= up.maximum_error * (1 + 1e-12)  # rounding only


def test_constant_reference_falls_back_to_its_magnitude() -> None:
    """Without a range, NRMSE is over the magnitude; fit and VAF do not exist; a note says so."""
    found = numbers(np.full(4, 5.5), np.full(4, 5.0))
    assert found.nrmse == pytest.approx(0.1)  # rounding only
    assert found.normalised_by == 5.0
    assert (found.fit, found.vaf) == (None, None)
    assert found.notes == ("the reference is constant: NRMSE over its magnitude, no fit or VAF",)
    # neither has a pressure a range that only flickers in the last digit of its file
    assert numbers(np.full(4, 2e7), 2e7 + np.array([0.0, 1e-3, 0.0, -1e-3])).fit is None


def test_what_nrmse_is_divided_by() -> None:
    """Never by zero, where rmse judges; for a signal at rest by the range that its meta file states."""
    assert numbers(np.ones(4), np.zeros(4)).nrmse is None
    assert numbers(np.zeros(4), np.zeros(4)).nrmse == 0
    assert "judge it by rmse" in numbers(np.ones(4), np.zeros(4)).notes[0]
    found = numbers(REFERENCE + 1, span=10.0)
    assert found.nrmse == pytest.approx(0.1)  # rounding only
    assert found.notes == ("NRMSE over the given range of 10",)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -1e200])
def test_not_a_number_is_refused(bad: float) -> None:
    """NaN and infinity are named with the place where they stand."""
    line = problem(lambda: numbers(np.array([0.0, bad, 0.0, 0.0])))
    assert line.startswith(f"ref.csv: x: expected finite numbers, got {bad} in the simulation")
    problem(lambda: numbers(REFERENCE, np.array([0.0, 1.0, bad, 0.0])), "in the reference at sample 2")


def test_lengths() -> None:
    """Equal lengths of two samples at least are needed."""
    line = problem(lambda: measure(TIME, REFERENCE[:3], REFERENCE, where="x"))
    assert "expected equal numbers of samples, at least 2, got 4, 3, 4" in line
    assert "got 1, 1, 1" in problem(lambda: measure(TIME[:1], REFERENCE[:1], REFERENCE[:1], where="x"))
