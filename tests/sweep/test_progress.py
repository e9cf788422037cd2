"""What is told of a study on its way where no terminal is."""

from __future__ import annotations

import io
import re
import subprocess
import sys

import numpy as np
from sweep.studies import GAIN, study

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


def test_the_command_line_in_a_pipe(gain, tmp_path) -> None:
    """Progress is on standard error, and only the summary on standard output."""
    file = study(tmp_path, GAIN, gain)
    command = [sys.executable, "-m", "orchestrator", "sweep", str(file), "--workers", "1", "--no-report"]
    done = subprocess.run(
        [*command, "--out", str(tmp_path / "out")], capture_output=True, text=True, check=True
    )
    assert re.fullmatch(rf"\d+ %: \d+ of 12 runs, {RATE}", done.stderr.splitlines()[0])
    assert done.stderr.splitlines()[-1].startswith("100 %: 12 of 12 runs, ")
    assert done.stdout.startswith("12 runs: 12 ok\n")
