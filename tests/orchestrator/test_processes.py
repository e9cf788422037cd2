"""Work in several processes: results in order, and an end if one of them is killed."""

import os

import pytest

from orchestrator.base.errors import Problem
from orchestrator.base.processes import mapping


def test_a_killed_process_ends_the_work():
    """In one line, where the others would wait for ever; the results until then are in order."""
    with mapping(2) as each:
        assert list(each(abs, [-3, -1, -2])) == [3, 1, 2]
    with pytest.raises(Problem, match="a helper process was ended from outside"), mapping(2) as each:
        list(each(os._exit, [9, 9, 9]))
