"""What a study tells on the command line: its progress in a pipe, how many runs, and why some failed."""

import io
import re
from dataclasses import replace
from functools import partial

import numpy as np
import pandas as pd
from kit.mistakes import table
from sweep.synthetic import ISHIGAMI, ishigami, results

from orchestrator.lanes.group import Status
from orchestrator.studies.analysis.analyse import analyse
from orchestrator.studies.analysis.results import without_numbers
from orchestrator.studies.parameter_study import progress
from orchestrator.studies.runs import RunOutcome
from orchestrator.studies.store import Results
from orchestrator.studies.study_page import study_report

RATE = r"[0-9.]+ runs/s, \d+ s left"
_failed = partial(results, ishigami, ISHIGAMI, "latin", 40)


def told(found: Results) -> list[str]:
    """What the command prints, line by line."""
    return study_report(found, analyse(found)).text().splitlines()


def test_runs_that_ended_come_first() -> None:
    """ok, early, failed, however many failed."""
    for failed in (5, 20, 35):
        found = _failed(reasons=dict.fromkeys(range(failed), "it broke"))
        assert told(found)[0] == f"40 runs: {40 - failed} ok, {failed} failed"
    found = _failed(reasons={0: "it broke", 1: "it broke", 2: "it broke"})
    status = found.table["status"].where(found.table["run"] != 2, "early")
    found = replace(found, table=found.table.assign(status=status))
    assert told(found)[0] == "40 runs: 37 ok, 1 early, 2 failed"


def test_failures_are_grouped_whatever_the_numbers_in_their_reasons() -> None:
    """The first of a kind is the example; one that is always the same stays; five groups are printed."""
    reasons = {n: f"operator_input: swing_1_rise is {-0.1 * n:g}, expected at least 0" for n in range(3, 9)}
    found = _failed(reasons={**reasons, 30: "the process ended by signal 11 (SIGSEGV)"})
    assert told(found)[1:3] == [
        "6 of them, such as: operator_input: swing_1_rise is -0.3, expected at least 0",
        "1 of them: the process ended by signal 11 (SIGSEGV)",
    ]
    found = _failed(reasons={n: f"part {'abcdefg'[n % 7]} broke at {n} s" for n in range(14)})
    lines = told(found)
    assert lines[6] == "... and for 2 other reasons"
    assert lines[1] == "2 of them, such as: part a broke at 0 s"


@table(__file__, "causes", "one, other, same")
def test_names_are_no_numbers(one: str, other: str, same: bool) -> None:
    """Digits in a name tell of what it is the name."""
    assert (without_numbers(pd.Series([one, other])).nunique() == 1) is same


def _rows(count: int, status: str = Status.OK) -> list[RunOutcome]:
    return [RunOutcome(n, status, "", np.zeros(1)) for n in range(count)]


def test_a_terminal_sees_how_many_runs_are_left_and_failed() -> None:
    """Runs that were stored before have no part in the rate; the line is erased at the end."""

    class Terminal(io.StringIO):
        def isatty(self) -> bool:
            return True

    stream = Terminal()
    with progress(stream) as watch:
        watch(10, 4, ())
        watch(10, 5, _rows(1))
        watch(10, 10, _rows(5, Status.FAILED))
    _, stored, first, last = re.findall(r"(?:starting|\d[^\x1b\r]*)", stream.getvalue())
    assert stored == "4 of 10 runs"
    assert re.fullmatch(rf"5 of 10 runs, {RATE}", first)
    assert re.fullmatch(rf"10 of 10 runs, {RATE}, 5 failed", last)
