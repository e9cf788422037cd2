"""Runs one job of the matrix in a process of its own, and ends whatever that process has started."""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import signal
import subprocess
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import IO, TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from benchmarks.matrix.present import Tool

ROOT = Path(__file__).parents[2]
LIMIT = 900  # s of wall time for one run
END = 0.99  # a run that comes so far has come to its end: tools count the last step in their own ways
Rows = Mapping[str, np.ndarray]  # "time" and the recorded signals


# ---- programs


@dataclass(frozen=True)
class Ended:
    """How a program ended: its exit status, None when it was stopped at the limit, and what it said."""

    status: int | None
    out: str = ""
    err: str = ""

    @property
    def reason(self) -> str:
        """Why it failed: the last line that it said, else how it ended."""
        said = [line for line in (self.err.strip() or self.out).splitlines() if line.strip()]
        if said:
            return said[-1].strip()
        status = self.status or 0
        return f"exit status {status}" if status >= 0 else f"ended by {signal.Signals(-status).name}"


def ran(
    words: Sequence[str],
    limit: float,
    folder: Path | None = None,
    environment: Mapping[str, str] | None = None,
) -> Ended:
    """Run a program and whatever it starts for at most `limit` seconds.

    What it says goes to files: at a pipe one would wait for everyone who has inherited it.
    """
    with tempfile.TemporaryFile() as out, tempfile.TemporaryFile() as err:
        try:
            process = subprocess.Popen(
                words,
                stdin=subprocess.DEVNULL,
                stdout=out,
                stderr=err,
                cwd=folder,
                env=environment,
                start_new_session=True,
            )
        except OSError as problem:
            return Ended(127, err=problem.strerror or str(problem))
        status = _waited(process, limit)
        return Ended(status, _text(out), _text(err))


def _waited(process: subprocess.Popen[bytes], limit: float) -> int | None:
    """The exit status; afterwards nothing runs on, which would falsify the times of the next run."""
    try:
        return process.wait(limit)
    except subprocess.TimeoutExpired:
        return None
    finally:
        if hasattr(os, "killpg"):
            with contextlib.suppress(ProcessLookupError, PermissionError):
                os.killpg(process.pid, signal.SIGKILL)
        process.kill()
        process.wait()


def _text(file: IO[bytes]) -> str:
    file.seek(0)
    return file.read().decode(errors="replace")


# ---- jobs


@dataclass(frozen=True)
class Outcome:
    """Rows by name, wall time [s], and why there are none."""

    rows: Rows
    wall: float
    problem: str = ""

    def until(self, stop: float) -> Outcome:
        """The same, but a problem where the rows are not finite or end before `stop`."""
        if self.problem:
            return self
        time = self.rows["time"]
        for name, column in self.rows.items():
            bad = ~np.isfinite(column)
            if bad.any():
                n = int(bad.argmax())
                when = f"at {time[n]:.3g} s" if np.isfinite(time[n]) else f"in row {n + 1}"
                return replace(self, problem=f"{name} is {column[n]:g} {when}")
        return self if time[-1] >= END * stop else replace(self, problem=f"ends at {time[-1]:.3g} s")


def carried_out(tool: Tool, folder: Path, limit: float = LIMIT, **job: object) -> Outcome:
    """One job in a process of its own."""
    place = Path(tempfile.mkdtemp(dir=folder))
    told = {"parts": {}, "wires": [], "input": None, "master": "jacobi", "ordered": False, "side": "CS"} | job
    file = place / "job.json"
    file.write_text(json.dumps(told | {"tool": tool.key, "out": str(place / "rows.csv")}))
    more = {"PYTHONPATH": str(ROOT), "PYTHONDONTWRITEBYTECODE": "1"}
    words = [tool.python, "-m", "benchmarks.matrix.tools", str(file)]
    try:
        return _outcome(ran(words, limit, place, {**os.environ, **more}), place, limit)
    finally:
        shutil.rmtree(place, ignore_errors=True)


def _outcome(ended: Ended, place: Path, limit: float) -> Outcome:
    """What a job has left in its folder."""
    if ended.status is None:
        return Outcome({}, limit, f"not done in {limit:g} s")
    if ended.status:
        return Outcome({}, 0.0, ended.reason)
    try:
        return Outcome(_rows(place / "rows.csv"), float((place / "wall.txt").read_text()))
    except (OSError, ValueError):
        return Outcome({}, 0.0, "ends without rows")


def _rows(file: Path) -> Rows:
    names, *lines = file.read_text(encoding="utf-8").splitlines()
    if not lines:
        raise ValueError("no rows")
    return dict(zip(names.split(","), np.loadtxt(lines, delimiter=",", ndmin=2).T, strict=True))
