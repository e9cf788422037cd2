"""A process that runs samples and nothing else: an FMU may take it down without harm.

It reads a packet and then samples from its standard input, pickled one after the other, and answers each with
a row; it ends when its input does.
"""

from __future__ import annotations

import os
import pickle
import queue
import shutil
import sys
import threading
import time
from dataclasses import replace
from pathlib import Path
from typing import IO, Any

from orchestrator.runs import compiled
from orchestrator.sweep.packet import Packet
from orchestrator.sweep.running import Row, row


def main(folder: Path) -> None:
    """folder: for unpacked FMUs; this process removes it when it ends by itself."""
    compiled.CORES = 1  # there is a process on every core
    answers = _own_output()
    requests: queue.SimpleQueue[Any] = queue.SimpleQueue()
    reader = threading.Thread(target=_read, args=(sys.stdin.buffer, requests, folder), daemon=True)
    reader.start()
    packet: Packet = requests.get()
    cases = packet.unpacked(folder / "fmus")
    true = {str(c.source): name for name, c in _sources(packet, cases)}
    _answer(answers, "ready")
    while True:
        sample = requests.get()
        began = time.perf_counter()
        found = row(packet.study, cases[sample.options], sample)
        _answer(answers, replace(found, reason=_told(found, true), wall=time.perf_counter() - began))


def _sources(packet: Packet, cases: Any) -> list[tuple[str, Any]]:
    """Components with their FMUs here, and what the FMUs are called where they come from."""
    return [
        (str(packet.cases[o].system.components[n].source), c)
        for o, case in cases.items()
        for n, c in case.system.components.items()
    ]


def _told(found: Row, true: dict[str, str]) -> str:
    """The reason without the folder of this process, which is another one each time."""
    for here, there in true.items():
        found = replace(found, reason=found.reason.replace(here, there))
    return found.reason


def _own_output() -> IO[bytes]:
    """Standard output for the answers alone; what an FMU prints goes nowhere."""
    answers = os.fdopen(os.dup(sys.stdout.fileno()), "wb")
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, sys.stdout.fileno())
    return answers


def _answer(answers: IO[bytes], found: Row | str) -> None:
    pickle.dump(found, answers, protocol=pickle.HIGHEST_PROTOCOL)
    answers.flush()


def _read(source: IO[bytes], requests: queue.SimpleQueue[Any], folder: Path) -> None:
    """Hand over what is asked; at the end of the input end at once, also in the middle of a run."""
    try:
        while True:
            requests.put(pickle.load(source))
    except (EOFError, pickle.UnpicklingError, OSError):
        shutil.rmtree(folder, ignore_errors=True)
        os._exit(0)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
