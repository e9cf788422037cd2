"""What the process of a live machine is told when it starts.

The process of a live machine as its parent sees it: started, read, ended.
"""

from __future__ import annotations

import os
import pickle
import shutil
import signal
import subprocess
import sys
import tempfile
import weakref
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from orchestrator.realtime.setup import Setup
from orchestrator.realtime.shared_memory import Memory


@dataclass(frozen=True)
class Task:
    """Handed over through the pipe.

    address   of the shared memory
    rows      frames that it holds
    first     number of the first frame
    serial    of the last command that is not for this session
    folder    for temporary files
    """

    setup: Setup
    address: str
    rows: int
    first: int
    serial: int
    folder: str


PATIENCE = 3.0  # [s] for an orderly end, then it is killed


class Process:
    """One process, from its start until `end` is called or nobody knows it any more."""

    def __init__(self, setup: Setup, memory: Memory, rows: int, first: int, serial: int) -> None:
        """See `Task`."""
        folder = tempfile.mkdtemp(prefix="live-")
        self._child = _start(memory)
        self.end = weakref.finalize(self, _end, self._child, folder)
        task = Task(setup, memory.address, rows, first, serial, folder)
        memory.handed_over()
        with suppress(BrokenPipeError):  # then it ended at once, which `fate` tells
            pipe: Any = self._child.stdin
            pickle.dump(task, pipe)
            pipe.flush()

    @property
    def pid(self) -> int:
        """Its number."""
        return self._child.pid

    @property
    def fate(self) -> str:
        """How the process ended; empty while it lives."""
        code = self._child.poll()
        if code is None:
            return ""
        if code < 0:
            with suppress(ValueError):
                return f"the process of the machine was ended by {signal.Signals(-code).name}"
        return f"the process of the machine ended with exit status {code}"


def _start(memory: Memory) -> subprocess.Popen[bytes]:
    """A Python of its own, which imports nothing of this one.

    In a session of its own: Ctrl-C in the terminal does not reach it, and Linux shares out processors among
    sessions first, so that a browser with many threads takes less from it.
    """
    roots = [str(Path(__file__).parents[2]), *filter(None, [os.environ.get("PYTHONPATH")])]
    apart: dict[str, Any] = {"start_new_session": True, "pass_fds": memory.descriptors}
    if sys.platform == "win32":
        apart = {"creationflags": subprocess.CREATE_NEW_PROCESS_GROUP}
    return subprocess.Popen(
        [sys.executable, "-m", "orchestrator.realtime.child"],
        stdin=subprocess.PIPE,
        env=os.environ | {"PYTHONPATH": os.pathsep.join(roots)},
        **apart,
    )


def _end(child: subprocess.Popen[bytes], folder: str) -> None:
    """Close the pipe, wait, kill if need be, and leave nothing behind."""
    with suppress(OSError):
        if child.stdin is not None:
            child.stdin.close()
    try:
        child.wait(PATIENCE)
    except subprocess.TimeoutExpired:
        child.kill()
        child.wait()
    shutil.rmtree(folder, ignore_errors=True)
