"""When frames are due: on a clock that the test moves."""

import numpy as np
import pytest

from orchestrator.realtime import deadlines


def _frames(clock, works, length=0.01):
    """Latencies of frames that take so long, and the deadlines."""
    kept, latencies = deadlines.DeadlineClock(), []
    kept.begin(length)
    for work in works:
        kept.wait()
        clock.now += work
        latencies.append(clock.now - kept.due)
        kept.done(length)
    return latencies, kept


def test_deadlines_do_not_drift(clock):
    """After a thousand frames of any length below the frame the next one is due at the sum of the frames."""
    latencies, kept = _frames(clock, np.random.default_rng(1).uniform(0, 0.009, 1000))
    assert kept.due == pytest.approx(100.0 + 1001 * 0.01, abs=1e-9)  # rounding of a thousand sums
    assert max(latencies) < 0.0091
    assert kept.slipped == 0.0


def test_a_short_halt_is_caught_up_with(clock):
    """Nothing slips, and within a few frames they are on time again."""
    latencies, kept = _frames(clock, [0.001] * 5 + [0.08] + [0.001] * 30)
    assert kept.slipped == 0.0
    assert latencies[-1] == pytest.approx(0.001, abs=1e-9)  # rounding of sums


def test_too_slow_a_machine_slows_down_and_says_so(clock):
    """Each frame takes twice its time: latencies stay bounded, the clock slips by what is missing."""
    latencies, kept = _frames(clock, [0.02] * 1000)
    assert max(latencies) < deadlines.BEHIND + 0.05
    assert kept.slipped == pytest.approx(
        1000 * (0.02 - 0.01), rel=0.05
    )  # what is left to others, and the end
