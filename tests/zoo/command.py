"""Runs a command of harvester in a process of its own, and finds what it leaves behind."""

import os
import signal
import subprocess
import sys
import time
import uuid
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from kit.wait import LONG, until

ROOT = Path(__file__).parents[2]
VANISH = 20.0  # [s] for processes that have been killed, and their last files; an FMU that hangs would stay
MARK = "HARVESTER_ZOO"  # environment variable by which all descendants are found, also in other sessions
MAIN = "import sys; from orchestrator.__main__ import script; {}; script()"


@dataclass(frozen=True)
class Ended:
    """The end of a command.

    left   temporary files, and command lines of descendants, that are still there
    at     time of the end, as of files [s]; signalled: time of the signal, 0 without one
    """

    status: int
    out: str
    err: str
    left: tuple[str, ...]
    at: float = 0.0
    signalled: float = 0.0

    @property
    def lines(self) -> list[str]:
        """Lines on standard error."""
        return self.err.strip().splitlines()


def command(
    arguments: Sequence[str | Path],
    folder: Path,
    interrupt: Callable[[], bool] | None = None,
    setup: str = "pass",
    number: int = signal.SIGINT,
) -> Ended:
    """Run `harvester ARGUMENTS` in a folder until it ends; a test fails that waits long for the end.

    interrupt   sends a signal to the command alone when this becomes true
    setup       Python statement before the command, such as one that sets a limit
    number      of the signal
    """
    temporary, mark = folder / "temporary", uuid.uuid4().hex
    temporary.mkdir(exist_ok=True)
    environment = {**os.environ, MARK: mark, "TMPDIR": str(temporary)}
    environment["PYTHONPATH"] = os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])
    with (folder / "stdout").open("wb") as out, (folder / "stderr").open("wb") as err:
        child = subprocess.Popen(
            [sys.executable, "-c", MAIN.format(setup), *map(str, arguments)],
            cwd=folder,
            env=environment,
            stdin=subprocess.DEVNULL,
            stdout=out,
            stderr=err,
            start_new_session=True,
            preexec_fn=_usual_signals,
        )
    signalled = 0.0
    try:
        if interrupt is not None:
            until(lambda: interrupt() or child.poll() is not None)
            child.send_signal(number)
            signalled = time.time()
        status, at = child.wait(LONG), time.time()
        until(lambda: not (_marked(mark) or _files(temporary)), VANISH)
        left = tuple(map(_command_line, _marked(mark)))
    finally:
        for pid in _marked(mark):
            os.kill(pid, signal.SIGKILL)
        child.wait(LONG)
    texts = [(folder / name).read_text("utf-8", "replace") for name in ("stdout", "stderr")]
    return Ended(status, *texts, (*_files(temporary), *left), at, signalled)


def _usual_signals() -> None:
    """What a terminal gives a command: in the background, or under nohup, some signals are ignored."""
    signal.signal(signal.SIGINT, signal.default_int_handler)
    for number in (signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_DFL)


def _marked(mark: str) -> list[int]:
    """Processes that have inherited the mark and run."""
    found, text = [], f"{MARK}={mark}".encode()
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            if text in (folder / "environ").read_bytes():
                found.append(int(folder.name))
        except OSError:
            continue
    return found


def _command_line(pid: int) -> str:
    try:
        return f"{pid}: {Path(f'/proc/{pid}/cmdline').read_bytes().replace(bytes(1), b' ').decode()}"
    except OSError:
        return str(pid)


def _files(folder: Path) -> tuple[str, ...]:
    return tuple(sorted(str(path.relative_to(folder)) for path in folder.rglob("*")))
