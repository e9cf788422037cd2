"""`many`: what has ended is kept, whatever ends the rest."""

from types import SimpleNamespace

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
    runs = SimpleNamespace(run=square, stop=lambda: stops.append(1))
    with pytest.raises(ValueError, match="3"):
        many(runs, range(4), kept.extend, 1, interval)
    assert sorted(kept) == [0, 1, 4]
    assert stops == [1]
