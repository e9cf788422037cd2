"""`many`: what has ended is kept, whatever ends the rest."""

import pytest

from orchestrator.lanes.many import many


def square(task):
    if task == 3:
        raise ValueError(task)
    return task**2


@pytest.mark.parametrize("interval", [0.0, 1e9])
def test_outcomes_before_an_exception_are_kept(interval):
    """Also those that wait for the next interval; the tasks that run are told to stop, once."""
    kept, stops = [], []
    with pytest.raises(ValueError, match="3"):
        many(square, range(4), kept.extend, lambda: stops.append(1), 1, interval)
    assert sorted(kept) == [0, 1, 4]
    assert stops == [1]
