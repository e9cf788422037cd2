"""Child's side of a worker process: `python -m orchestrator.worker.main MODULE:FUNCTION FOLDER`.

Messages are pickled: those of the parent arrive on standard input, answers go to standard output. What an FMU
prints goes to the file of stderr. Temporary files are made in the folder of the process.
"""

import os
import pickle
import shutil
import signal
import sys
import threading
import time
import traceback
from importlib import import_module
from pathlib import Path
from queue import SimpleQueue
from typing import IO, Any

from orchestrator.worker.activity import ActivityRecord
from orchestrator.worker.call_slots import share_calls

_END_OF_INPUT = object()


class Channel:
    """Connection of a function in a worker process to its parent.

    folder     for temporary files; removed by the parent, or by this process if the parent has ended
    grace      time for an orderly end after the parent has closed its end [s]
    ended      set when the parent has closed its end
    activity   shared memory for the last FMI call
    """

    def __init__(self, folder: Path) -> None:
        self.folder, self.grace, self.ended, self._parent = folder, 0.0, threading.Event(), os.getppid()
        self.activity = ActivityRecord(folder / "activity")
        share_calls(folder / "calls")
        self._answers, self._writing = _redirect_output(), threading.Lock()
        self._messages: SimpleQueue[Any] = SimpleQueue()
        threading.Thread(target=self._read, args=(sys.stdin.buffer,), daemon=True).start()

    def get(self) -> Any:
        """The next message; raises EOFError when the parent has closed its end."""
        message = self._messages.get()
        if message is _END_OF_INPUT:
            raise EOFError
        return message

    @property
    def waiting(self) -> bool:
        """Is there a message, or has the parent closed its end?"""
        return not self._messages.empty()

    def put(self, message: Any) -> None:
        """Send an object that can be pickled, without buffering, so that it survives a crash."""
        with self._writing:  # an FMU may log from a thread of its own
            pickle.dump(message, self._answers, pickle.HIGHEST_PROTOCOL)
            self._answers.flush()

    def end(self) -> None:
        """Remove the folder, and end this process; if the parent has ended, also those that FMUs started."""
        shutil.rmtree(self.folder, ignore_errors=True)
        if hasattr(os, "killpg") and os.getppid() != self._parent and os.getpgrp() == os.getpid():
            os.killpg(os.getpgrp(), signal.SIGKILL)
        os._exit(0)

    def _read(self, source: IO[bytes]) -> None:
        """Queue messages until the input ends; then end the process, even during a call of an FMU."""
        try:
            while True:
                self._messages.put(pickle.load(source))
        except (EOFError, pickle.UnpicklingError, OSError, AttributeError, ImportError, TypeError):
            self.ended.set()
            self._messages.put(_END_OF_INPUT)
            time.sleep(self.grace)
            self.end()


def _redirect_output() -> IO[bytes]:
    """A copy of standard output for answers; standard output is redirected to stderr."""
    answers = os.fdopen(os.dup(sys.stdout.fileno()), "wb")
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())
    return answers


def main(target: str, folder: Path) -> None:
    """Run the function, then end the process without the exit handlers of FMUs."""
    channel = Channel(folder)
    module, _, name = target.partition(":")
    try:
        getattr(import_module(module), name)(channel)
    except EOFError:
        channel.ended.wait(1.0)
    except BaseException:  # the parent reports the last line of the traceback
        traceback.print_exc()
        sys.stderr.flush()
        os._exit(1)
    if channel.ended.is_set():  # the parent may have ended
        channel.end()
    os._exit(0)


if __name__ == "__main__":
    main(sys.argv[1], Path(sys.argv[2]))
