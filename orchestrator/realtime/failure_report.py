"""Reports failures of a machine on the terminal, for users who do not look at its page."""

import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from orchestrator.base.errors import Problem
from orchestrator.realtime.setup import Machine

INTERVAL = 0.1  # [s] between two looks at the state


@contextmanager
def failures_reported(machine: Machine, save: Callable[[], Path]) -> Iterator[None]:
    """Context that prints each failure in one line on stderr; it closes the machine at its end.

    save   saves what the machine has recorded, for each failure; raises Problem if that is nothing
    """
    ended, failed = threading.Event(), False

    def look() -> None:
        nonlocal failed
        frame, before = machine.latest(), failed
        failed = frame.state == "failed"
        if failed and not before:
            saved = ""
            with suppress(Problem):
                saved = f"; the session until then is in {save()}"
            print(f"harvester: {frame.message}{saved}", file=sys.stderr, flush=True)

    def watch() -> None:
        while not ended.wait(INTERVAL):
            look()

    watching = threading.Thread(target=watch, daemon=True)
    watching.start()
    try:
        yield
    finally:
        ended.set()
        watching.join()
        machine.close()
        look()  # the FMUs may have failed at the end
