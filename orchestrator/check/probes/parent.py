"""Starts a child for each probe, watches it, and turns a crash, a hang or an exit into words."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from orchestrator.check.child.beacon import Beacon, Sighting

POLL = 0.01  # s between looks at the child
MESSAGES = 1 << 20  # bytes that a child may write to stderr before they are thrown away
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
    """Wall times [s] and memory.

    call     longest single call into the FMU; a longer one is a hang
    probe    longest probe of one side
    work     what one probe fills with steps, instances and the like
    memory   largest child [bytes], where /proc tells; 0: a quarter of the machine's memory
    """

    call: float = 10.0
    probe: float = 60.0
    work: float = 0.8
    memory: float = 0.0


_limits = [Limits()]
_halt = threading.Event()  # set by an interrupt: children are to be stopped


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
    """What a child said, how it ended ("" when as it should), and what it hands over.

    crashes   ends in stages that were left out after it
    late      it was stopped because its time was over, which may only mean that the FMU is slow
    """

    said: list[tuple[str, str]] = field(default_factory=list)
    crashes: list[str] = field(default_factory=list)
    end: str = ""
    late: bool = False
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
        if not part.end or part.late or part.stage < 0:
            whole.end, whole.late = part.end, part.late
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
        with (folder / "errors").open("ab") as errors:
            child = subprocess.Popen(
                [sys.executable, "-m", "orchestrator.check.child.main", name],
                cwd=name,
                env=environment,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=errors,
                start_new_session=True,
            )
            try:
                end, late = _watch(child, beacon, folder / "errors")
            finally:
                _kill(child)
        outcome = _read(folder)
        seen = beacon.read()
        beacon.close()
        tail = (folder / "errors").read_text(encoding="utf-8", errors="replace").strip().rpartition("\n")[2]
        outcome.end, outcome.late = end or _ending(child.returncode, outcome, seen, tail), late
        return outcome


def _watch(child: subprocess.Popen[bytes], beacon: Beacon, errors: Path) -> tuple[str, bool]:
    """Wait; why the child has to be stopped and where it stood, and whether only its time is over."""
    begin = moved = time.monotonic()
    count, most = -1, current().memory or _memory() / 4
    while True:
        with suppress(subprocess.TimeoutExpired):
            child.wait(POLL)
            return "", False
        if errors.stat().st_size > MESSAGES:
            with suppress(OSError):  # refused where a file in use is locked
                os.truncate(errors, 0)
        seen, now = beacon.read(), time.monotonic()
        if seen.count != count:
            count, moved = seen.count, now
        if count and now - moved > current().call:  # before the first call it is Python that starts
            return f"hang: no return within {current().call:g} s {seen}", False
        if _used(child.pid) > most:
            return f"takes more than {most / 1e9:.3g} GB of memory, stopped {seen}", False
        if now - begin > current().probe:
            return f"not done within {current().probe:g} s, stopped {seen}", True
        if _halt.is_set():
            return "interrupted", True


def _memory() -> float:
    """Memory of this machine [bytes]; infinite where it is not told."""
    try:
        return float(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"))
    except (AttributeError, OSError, ValueError):
        return float("inf")


def _used(pid: int) -> float:
    """Memory that a process takes [bytes]; 0 where it is not told."""
    try:
        pages = Path(f"/proc/{pid}/statm").read_text(encoding="ascii").split()[1]
    except (OSError, IndexError):
        return 0.0
    return float(pages) * os.sysconf("SC_PAGE_SIZE")


def _kill(child: subprocess.Popen[bytes]) -> None:
    """The child, if it still runs, and what the FMU has started and left behind."""
    if hasattr(os, "killpg"):
        with suppress(ProcessLookupError, PermissionError):
            os.killpg(child.pid, signal.SIGKILL)
    if child.poll() is None:
        child.kill()
        child.wait()


def side_by_side(work: Callable[[str], Outcome], sides: Sequence[str]) -> list[Outcome]:
    """Some work for several sides at the same time; an interrupt stops the children at once."""
    try:
        with ThreadPoolExecutor() as pool:
            try:
                return list(pool.map(work, sides))
            except BaseException:
                _halt.set()  # the threads of the pool are waited for
                raise
    finally:
        _halt.clear()


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
        known = {int(s): s.name for s in signal.Signals}
        name = known.get(-code, f"signal {-code}")
        return f"{WORDS.get(name, name)} {seen}{more}"
    return f"the process ended with exit status {code} {seen}{more}"
