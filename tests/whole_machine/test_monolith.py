"""The monolithic solution: corners of its inputs, times of two grids, its tolerance, the stored reference."""

import numpy as np
import pytest
from kit import shards
from kit.equations import machine
from kit.mistakes import problem
from kit.work_cycle import REFERENCE

from benchmarks import reference
from fmus.monolith import SAME_TIME, breakpoints, merge_times, simulate


def test_breakpoints_are_the_corners_of_a_piecewise_linear_signal():
    """Only samples where the slope changes, and both ends, split the integration."""
    t = np.linspace(0, 1, 101)
    bent = np.interp(t, [0, 0.2, 0.5, 1.0], [0, 1, 1, 0])[:, None]
    assert list(breakpoints(t, bent)) == [0, 20, 50, 100]
    assert list(breakpoints(t, 2e7 + 1e6 * bent)) == [0, 20, 50, 100]  # Pa: rounding makes no corners
    uneven = np.array([0.0, 0.2, 0.201, 0.5, 1.0])
    line = np.interp(uneven, [0, 0.2, 0.5, 1.0], [0, 1, 1, 0])[:, None]
    assert list(breakpoints(uneven, line)) == [0, 1, 3, 4]


@pytest.mark.parametrize("gap", [1e-9, 1e-6, 1e-5])
def test_breakpoints_give_the_samples_of_a_dense_curve(gap):
    """Where no sample of a curve is a corner for its neighbours, lines between breakpoints still pass it."""
    t = np.unique(np.concatenate([np.linspace(0, 1, 101), np.linspace(0, 1, 101)[:-1] + gap]))
    curve = np.column_stack([np.sin(t), 2e7 + 1e6 * np.cos(t)])
    corners = breakpoints(t, curve)
    for k, allowed in ((0, 1e-9), (1, 8 * np.finfo(float).eps * 2.1e7)):  # tolerance; rounding of pressures
        assert np.max(np.abs(np.interp(t, t[corners], curve[corners, k]) - curve[:, k])) <= allowed


def test_times_that_differ_by_rounding_only():
    """Of two grids they stand once, as in the first; of inputs they are refused in one sentence."""
    first, second = np.linspace(0, 1, 11), np.append(np.cumsum(np.full(10, 0.1)), 1.05)
    assert np.any(np.isin(second, first, invert=True)[:-1])  # rounding makes them differ
    np.testing.assert_array_equal(merge_times(first, second), [*first, 1.05])
    np.testing.assert_array_equal(merge_times(second, first), [0.0, *second])
    for bad in ([0.0, 1.0, 1.0 + SAME_TIME / 2, 2.0], [0.0, 1.0, 0.5], [0.0, np.nan, 1.0]):
        bad, u = np.array(bad), np.tile(machine().u, (len(bad), 1))
        problem(lambda bad=bad, u=u: simulate(machine(), bad, u), r"more than 1e-10 s.*merge_times")
        problem(lambda bad=bad: merge_times(np.array([0.0, 2.0]), bad), "more than 1e-10 s")


def test_monolith_reaches_its_tolerance():
    """Halving the tolerance exponent changes the result by what the looser tolerance allows."""
    model, time = machine(), np.linspace(0, 2, 201)
    u = np.tile(model.u, (201, 1))
    u[:, model.inputs.index("boom_command")] = np.interp(time, [0, 0.3, 1.0, 1.4], [0, 4, 4, 0])
    loose, tight = (simulate(model, time, u, tolerance=tolerance)[0] for tolerance in (1e-8, 1e-11))
    # integrator error: 1e-8 per step, some hundred steps
    assert np.max(np.abs(loose - tight) / model.nominal) < 1e-5


# in the first 5 s each joint moves; the other 37 s take 15 s, because each of 650 corners costs a solver
@pytest.mark.parametrize("stop", [5.0, pytest.param(42.0, marks=shards.machine)])
def test_reference_trace_is_what_the_monolith_gives(monkeypatch, stop):
    """The stored work cycle equals a new solution to the digits it is written with."""
    assert set(REFERENCE) == {"time", *reference.SIGNALS}
    cycle, commands = reference.work_cycle()
    first = cycle <= stop
    monkeypatch.setattr(reference, "work_cycle", lambda: (cycle[first], commands[first]))
    time, signals = (rows[:: reference.EVERY] for rows in reference.trace())
    assert np.allclose(REFERENCE["time"][: time.size], time, atol=1e-12)
    assert time[-1] == min(stop, REFERENCE["time"][-1])
    for k, name in enumerate(reference.SIGNALS):
        column = REFERENCE[name]
        # nine digits of the largest value, and 1e-11 per step of the solver on another machine's libm
        error = np.abs(column[: time.size] - signals[:, k]).max()
        assert error <= 1e-7 * np.ptp(column) + 1e-12, name
