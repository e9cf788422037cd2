"""What is told of a study on its way where no terminal is; test_store.py has it from the command line."""

from __future__ import annotations

import io
import re

import numpy as np

from orchestrator.studies.parameter_study import StudyProgress
from orchestrator.studies.single_run import FAILED, OK, RunOutcome

RATE = r"[0-9.]+ runs/s, \d+ s left"


def _rows(count: int, status: str = OK) -> list[RunOutcome]:
    return [RunOutcome(n, status, "", np.zeros(1), wall=0.1) for n in range(count)]


def test_a_pipe_gets_a_line_for_each_tenth() -> None:
    """However the batches fall: one line when a tenth is full, none in between, the last one for all runs."""
    stream = io.StringIO()
    show = StudyProgress(stream)
    show(200, 0, ())
    done = 0
    for size in [7] * 28 + [4]:
        done += size
        show(200, done, _rows(size))
    told = stream.getvalue().splitlines()
    assert [line.split(":")[0] for line in told] == [f"{p} %" for p in range(10, 101, 10)]
    assert re.fullmatch(rf"10 %: 21 of 200 runs, {RATE}", told[0])
    assert told[-1].startswith("100 %: 200 of 200 runs, ")


def test_a_study_that_goes_on_tells_what_failed() -> None:
    """Tenths of stored runs are not reported again; a batch over several tenths is one line."""
    stream = io.StringIO()
    show = StudyProgress(stream)
    show(10, 4, ())
    show(10, 5, _rows(1))
    show(10, 10, _rows(5, FAILED))
    told = stream.getvalue().splitlines()
    assert re.fullmatch(rf"50 %: 5 of 10 runs, {RATE}", told[0])
    assert re.fullmatch(rf"100 %: 10 of 10 runs, {RATE}, 5 failed", told[1])
