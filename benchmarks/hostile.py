"""FMUs that misbehave, through every command: `python -m benchmarks.hostile`, ten minutes on two cores.

Each misuse of tests/zoo/faulty.c is committed in a step. Each command runs the FMU twice: once with the
limits of time and memory that the command has, and once with Ctrl-C at a random time after the misuse.
Whatever the FMU does, the command has to end with one line that names the FMU, with all rows until then and
none twice, and without leaving processes or files. The table in docs/run.md has how it ended, in one of the
words of `ENDS`.
"""

from __future__ import annotations

import argparse
import json
import random
import sys
import tempfile
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from kit.wait import until
from zoo.command import Ended, command
from zoo.faulty import BEGIN, MEMORY, MISUSES, Faulty, faulty

from orchestrator.data.trace import read_trace

COMMANDS = ("run", "accuracy", "sweep", "batch", "validate", "check", "view", "reference")
ENDS = {
    "complete": "as if nothing had happened; `rounding`: with a warning",
    "named": "in one line with FMU and cause",
    "limit": "at a limit of the command",
    "Ctrl-C": "the command has no limit",
}
LIMIT = SILENT = 4.0  # [s] of wall time; of a machine that does not answer, more than 1500 folders take
NO_LIMIT = 12.0  # [s] until Ctrl-C for a command without a limit of time
MOST_DELAY = 1.0  # [s] from the misuse to Ctrl-C
SEED = 37
PREPARE = {
    "check": f"import orchestrator.worker.process as p; p.machine_memory = lambda: 4 * {MEMORY}e9",
    # two machines with real-time priority that hang would take both cores from all other processes
    "view": f"import os; os.environ['HARVESTER_PRIORITY'] = 'ordinary'; "
    f"import orchestrator.realtime.machine as m; m.MEMORY, m.SILENT = {MEMORY}e9, {SILENT}",
    "batch": "exec(open('batch.py').read())",
}
STUDY = """
system = "lag.fmu"
method = "grid"
stop = 1.0
step = 0.01
memory_limit = {memory}
time_limit = {limit}
[factors]
"lag.rate" = {{ distribution = "values", values = [3, 1] }}
[outputs.end]
signal = "lag.y"
measure = "final"
"""
BATCH = """
import sys
from orchestrator import Interrupted, batch
try:
    limits = dict(time_limit={limit}, memory_limit={memory})
    found = batch("lag.fmu", {{"lag.rate": [3, 1]}}, stop=1.0, step=0.01, lanes=False, workers=1, **limits)
except KeyboardInterrupt as stopped:
    sys.exit("interrupted; " + " ".join(stopped.result.status))
sys.exit("; ".join(filter(None, found.reasons)) or None)
"""


@dataclass(frozen=True)
class Played:
    """How a command ended; late [s]: after its limit of time, or after Ctrl-C; word: of ENDS."""

    word: str
    late: float
    ended: Ended


def play(misuse: str, name: str, folder: Path, delay: float | None = None) -> Played:
    """Run a command on an FMU; delay [s]: from the misuse to Ctrl-C, None: its limits end it."""
    fmu, due = faulty(folder, misuse), list[float]()
    patience = NO_LIMIT if delay is None else delay

    def interrupt() -> bool:
        """At its time after the misuse, or when a view has told the failure."""
        if not due and fmu.committed.exists():
            due.append(time.monotonic() + patience)
        told = (
            name == "view"
            and delay is None
            and "session-" in (folder / "stderr").read_text("utf-8", "replace")
        )
        return told or (bool(due) and time.monotonic() > due[0])

    limited = delay is None and name not in ("view", "validate", "reference")
    arguments, setup = _arguments(name, fmu, folder), PREPARE.get(name, "pass")
    ended = command(arguments, folder, None if limited else interrupt, setup)
    assert fmu.committed.exists(), (misuse, name, ended)
    _check(ended, misuse, name, fmu, folder)
    word, begun = _word(ended, name, delay), fmu.committed.stat().st_mtime
    return Played(word, max(0.0, ended.at - (ended.signalled or begun + LIMIT)), ended)


def _arguments(name: str, fmu: Faulty, folder: Path) -> list[str | Path]:
    limits = ["--time-limit", str(LIMIT), "--memory-limit", str(MEMORY)]
    values = {"limit": LIMIT, "memory": MEMORY}
    (folder / "study.toml").write_text(STUDY.format(**values), "utf-8")
    (folder / "batch.py").write_text(BATCH.format(**values), "utf-8")
    (folder / "reference.csv").write_text("time,lag.y\n0,0\n1,0\n", "utf-8")
    (folder / "reference.toml").write_text('[signals."lag.y"]\nunit = "Pa"\n', "utf-8")
    path = str(fmu.fmu)
    return {
        "run": ["run", path, "--stop", "1", "--step", "0.01", "--out", "trace.csv", *limits],
        "accuracy": ["run", path, "--stop", "1", "--accuracy", "1e-3", "--out", "trace.csv", *limits],
        "sweep": ["sweep", "study.toml", "--out", "out", "--no-report", "--workers", "1"],
        "batch": [],
        "validate": ["validate", path, "--reference", "reference.csv", "--out", "out", "--step", "0.01"],
        "check": ["check", path, "--timeout", str(LIMIT)],
        "view": ["view", path, "--no-open", "--port", "0", "--results", "results"],
        "reference": ["reference", path, "--stop", "1", "--record-step", "0.01", "--out", "trace.csv"],
    }[name]


def _check(ended: Ended, misuse: str, name: str, fmu: Faulty, folder: Path) -> None:
    """What must hold however it ended."""
    said = ended.err + ended.out
    assert not ended.left, (misuse, name, ended.left)
    if misuse == "orphan":  # it has no environment by which `command` finds it
        until(lambda: not Path(f"/proc/{int(fmu.committed.read_text())}").exists())
    assert "Traceback" not in said, (misuse, name, said)
    fails = [line for line in ended.lines if line.startswith("harvester: ") and "interrupted" not in line]
    assert len(fails) <= 1, (misuse, name, ended.err)
    if fails and name != "validate":
        assert str(fmu.fmu) in fails[0] or "lag" in fails[0], (misuse, name, fails)
    for file in (*folder.glob("trace*.csv"), *folder.glob("out/run*.csv")):
        times = read_trace(file).time if len(file.read_text("utf-8").splitlines()) > 1 else np.zeros(0)
        assert (np.diff(times) > 0).all(), (misuse, name, file)
        complete = ".partial" not in file.name
        metadata = file.with_suffix(".run.json")
        if metadata.is_file():
            assert json.loads(metadata.read_text("utf-8"))["complete"] == complete, (misuse, name, file)
        if len(times) and misuse not in ("close", "garbage", "thread", "forge"):
            assert times[-1] >= BEGIN - 0.011, (misuse, name, times[-1])


def _word(ended: Ended, name: str, delay: float | None) -> str:
    """The word for the end of a command."""
    said = ended.err + ended.out
    if "not done within" in said or "hang: " in said or "more than" in said or "has not answered" in said:
        return "limit"
    if "no message" in said or "lost its connection" in said or "wrote over" in said or "the process" in said:
        return "named"
    if "segmentation fault" in said:
        return "named"
    return "Ctrl-C" if ended.status == 130 and (delay is not None or name != "view") else "complete"


def table(words: Callable[[str, str], str]) -> str:
    """The table of the page."""
    rows = [f"| the FMU | {' | '.join(COMMANDS)} |", f"|{' --- |' * (len(COMMANDS) + 1)}"]
    for misuse, text in MISUSES.items():
        rows.append(f"| {text} | {' | '.join(words(misuse, name) for name in COMMANDS)} |")
    return "\n".join(rows)


def main() -> None:
    """Run all cases and print the table, with the longest time after a limit and after Ctrl-C."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", nargs="*", default=[*MISUSES], help="misuses")
    parser.add_argument("--workers", type=int, default=2)
    options = parser.parse_args()
    began, chosen = time.monotonic(), random.Random(SEED)
    cases = [
        (m, c, d) for m in options.only for c in COMMANDS for d in (None, chosen.uniform(0.0, MOST_DELAY))
    ]

    def one(case: tuple[str, str, float | None]) -> Played:
        with tempfile.TemporaryDirectory() as folder:
            return play(*case[:2], Path(folder), case[2])

    with ThreadPoolExecutor(options.workers) as threads:
        played = dict(zip(cases, threads.map(one, cases), strict=True))
    words = {(m, c): p.word for (m, c, d), p in played.items() if d is None}
    print(table(lambda misuse, name: words.get((misuse, name), "")))
    for title, limited in (("its limit of time", True), ("Ctrl-C", False)):
        late = {
            p.late: f"{m}, {c}"
            for (m, c, d), p in played.items()
            if (p.word == "limit" and not p.ended.signalled if limited else p.ended.signalled)
        }
        if late:
            print(
                f"longest time after {title}: {max(late):.1f} s ({late[max(late)]}), "
                f"median {np.median([*late]):.1f} s"
            )
    print(f"{len(cases)} runs in {time.monotonic() - began:.0f} s, seed {SEED}")


if __name__ == "__main__":
    main()
