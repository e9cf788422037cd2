"""Windows that end after the runs, and numbers that are set twice, are told before anything is run."""

from __future__ import annotations

import pytest
from sweep.studies import GAIN, study

from orchestrator import Problem
from orchestrator.studies.cases import resolve
from orchestrator.studies.study import read


@pytest.fixture
def file(gain, tmp_path):
    """The study of the gain."""
    return study(tmp_path, GAIN, gain)


def _told(file, text):
    """What is wrong with a study of this text."""
    file.write_text(text, encoding="utf-8")
    with pytest.raises(Problem) as wrong:
        resolve(read(file))[0]
    return str(wrong.value)


def test_a_window_that_ends_after_the_runs_is_refused(file):
    """The report would tell a window that no run has."""
    expected = f"{file}: outputs.end: stop: expected at most 0.2 s, where the runs end, got 25 s"
    assert _told(file, f"{GAIN}start = 0.1\nstop = 25\n") == expected


def test_a_factor_that_is_fixed_by_another_name_is_told(file):
    """With the variable that both set."""
    text = GAIN.replace("gain.factor", "gain.u").replace('"gain.u" = 2', '"u" = 2')
    expected = (
        "fixed: u: expected another variable than the factors, which sets gain.u as factors.gain.u does"
    )
    assert _told(file, text) == f"{file}: {expected}"


def test_a_window_may_end_with_the_runs(file):
    """At the stop of the study, also where that is no whole number of steps."""
    for end in ("0.2", "0.1999"):
        file.write_text(GAIN.replace("stop = 0.2", f"stop = {end}") + f"stop = {end}\n", encoding="utf-8")
        assert resolve(read(file))[0].outputs[0].stop == float(end)
