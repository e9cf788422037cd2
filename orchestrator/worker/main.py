"""The child's side of a worker process: `python -m orchestrator.worker.main MODULE:FUNCTION FOLDER`.

Messages are pickled, one after the other: from the parent on standard input, to it on standard output. What
an FMU prints goes nowhere.
"""

from __future__ import annotations

import os
import pickle
import shutil
import sys
import threading
import time
import traceback
from importlib import import_module
from pathlib import Path
from queue import SimpleQueue
from typing import IO, Any

from orchestrator.worker.activity import ActivityRecord

_END = object()


class Channel:
    """What a function in a worker process has at hand.

    folder   for temporary files; the parent removes it, or this process if the parent is gone
    grace    [s] to end in an orderly way when the parent does not need this process any more
    ended    set then
    """

    def __init__(self, folder: Path) -> None:
        self.folder, self.grace, self.ended = folder, 0.0, threading.Event()
        self.activity = ActivityRecord(folder / "beacon")
        self._answers = _own_output()
        self._messages: SimpleQueue[Any] = SimpleQueue()
        threading.Thread(target=self._read, args=(sys.stdin.buffer,), daemon=True).start()

    def get(self) -> Any:
        """The next message; raises EOFError when the parent has closed its end."""
        message = self._messages.get()
        if message is _END:
            raise EOFError
        return message

    def put(self, message: Any) -> None:
        """Send something that can be pickled; at once, so that it survives a crash."""
        pickle.dump(message, self._answers, pickle.HIGHEST_PROTOCOL)
        self._answers.flush()

    def _read(self, source: IO[bytes]) -> None:
        """Hand over what comes; at the end of the input end soon, also in the middle of a call of an FMU."""
        try:
            while True:
                self._messages.put(pickle.load(source))
        except (EOFError, pickle.UnpicklingError, OSError):
            self.ended.set()
            self._messages.put(_END)
            time.sleep(self.grace)
            shutil.rmtree(self.folder, ignore_errors=True)
            os._exit(0)


def _own_output() -> IO[bytes]:
    """Standard output for the answers alone."""
    answers = os.fdopen(os.dup(sys.stdout.fileno()), "wb")
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, sys.stdout.fileno())
    return answers


def main(target: str, folder: Path) -> None:
    """Run the function, and leave at once: what an FMU does at the exit of the process is of no interest."""
    channel = Channel(folder)
    module, _, name = target.partition(":")
    try:
        getattr(import_module(module), name)(channel)
    except EOFError:
        channel.ended.wait(1.0)
    except BaseException:  # its last line is what the parent tells
        traceback.print_exc()
        sys.stderr.flush()
        os._exit(1)
    if channel.ended.is_set():  # there may be no parent any more
        shutil.rmtree(folder, ignore_errors=True)
    os._exit(0)


if __name__ == "__main__":
    main(sys.argv[1], Path(sys.argv[2]))
