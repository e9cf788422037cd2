"""Starts a child for each probe, watches it, and turns a crash, a hang or an exit into words."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from orchestrator.trial.beacon import Beacon, Sighting

POLL = 0.01  # s between looks at the child
WORDS = {
    "SIGSEGV": "segmentation fault",
    "SIGBUS": "bus error",
    "SIGABRT": "abort",
    "SIGFPE": "arithmetic exception",
    "SIGILL": "illegal instruction",
    "SIGKILL": "killed by the system (out of memory?)",
}


@dataclass(frozen=True)
class Limits:
    """Wall times [s].

    call    longest single call into the FMU; a longer one is a hang
    probe   longest probe of one side
    work    what one probe fills with steps, instances and the like
    """

    call: float = 10.0
    probe: float = 60.0
    work: float = 0.8


_limits = [Limits()]


@contextmanager
def limits(changed: Limits) -> Iterator[None]:
    """Other limits for the time of a block."""
    _limits.append(changed)
    try:
        yield
    finally:
        _limits.remove(changed)


def current() -> Limits:
    """The limits in force."""
    return _limits[-1]


@dataclass
class Outcome:
    """What a child said, how it ended ("" when as it should), and what it hands over."""

    said: list[tuple[str, str]] = field(default_factory=list)
    crashes: list[str] = field(default_factory=list)  # in stages that were left out after it
    end: str = ""
    result: Any = None
    stage: int = -1


def run(
    folder: Path, side: str, task: str, habits: Mapping[str, bool] | None = None, payload: Any = None
) -> Outcome:
    """One probe; after a crash in one of its stages a new child does the rest, a few times over.

    habits    what is known of the FMU, see `Bench`
    payload   what the task needs
    """
    whole = Outcome()
    first = 0
    for _ in range(6):
        job = {"folder": str(folder), "side": side, "task": task, "first": first, "habits": habits or {}}
        part = _child(job | {"seconds": current().work, "payload": payload})
        whole.said += part.said
        whole.result, whole.stage = part.result, part.stage
        if not part.end:
            return whole
        if part.stage < 0:
            whole.end = part.end
            return whole
        whole.crashes.append(part.end)
        first = part.stage + 1
    return whole


def _child(job: Mapping[str, Any]) -> Outcome:
    """Start, watch and read one child."""
    with tempfile.TemporaryDirectory(prefix="probe-", ignore_cleanup_errors=True) as name:
        folder = Path(name)
        (folder / "job.json").write_text(json.dumps(job), encoding="utf-8")
        beacon = Beacon(folder / "beacon")
        roots = [str(Path(__file__).parents[3]), *filter(None, [os.environ.get("PYTHONPATH")])]
        environment = os.environ | {"PYTHONPATH": os.pathsep.join(roots)}
        with (folder / "errors").open("wb") as errors:
            child = subprocess.Popen(
                [sys.executable, "-m", "orchestrator.trial.child", name],
                cwd=name,
                env=environment,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=errors,
                start_new_session=True,
            )
            end = _watch(child, beacon)
        outcome = _read(folder)
        seen = beacon.read()
        beacon.close()
        tail = (folder / "errors").read_text(encoding="utf-8", errors="replace").strip().rpartition("\n")[2]
        outcome.end = end or _ending(child.returncode, outcome, seen, tail)
        return outcome


def _watch(child: subprocess.Popen[bytes], beacon: Beacon) -> str:
    """Wait; a child that makes no progress is killed, and the text says where it stood."""
    begin = moved = time.monotonic()
    count = -1
    while True:
        with suppress(subprocess.TimeoutExpired):
            child.wait(POLL)
            return ""
        seen, now = beacon.read(), time.monotonic()
        if seen.count != count:
            count, moved = seen.count, now
        if now - moved > current().call:
            _kill(child)
            return f"hang: no return within {current().call:g} s {seen}"
        if now - begin > current().probe:
            _kill(child)
            return f"not done within {current().probe:g} s, stopped {seen}"


def _kill(child: subprocess.Popen[bytes]) -> None:
    """The child and what the FMU may have started."""
    if hasattr(os, "killpg"):
        with suppress(ProcessLookupError):
            os.killpg(child.pid, signal.SIGKILL)
    child.kill()
    child.wait()


def _read(folder: Path) -> Outcome:
    outcome = Outcome(end="unfinished")
    path = folder / "said.jsonl"
    for text in path.read_text(encoding="utf-8").splitlines() if path.is_file() else ():
        line = json.loads(text)
        if "severity" in line:
            outcome.said.append((line["severity"], line["text"]))
        outcome.stage = line.get("stage", outcome.stage)
        if "crash" in line:
            outcome.end = line["crash"]
        if "done" in line and outcome.end == "unfinished":
            outcome.end, outcome.result = "", line["result"]
    return outcome


def _ending(code: int, outcome: Outcome, seen: Sighting, tail: str) -> str:
    """How the child ended, in words; empty when it did its job."""
    if outcome.end != "unfinished":
        return outcome.end
    more = f' ("{tail[:120]}")' if tail else ""
    if code < 0:
        name = signal.Signals(-code).name
        return f"{WORDS.get(name, name)} {seen}{more}"
    return f"the process ended with exit status {code} {seen}{more}"
