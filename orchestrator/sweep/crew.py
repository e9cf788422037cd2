"""The processes that one Dask worker runs samples in, and what is told of one that dies."""

from __future__ import annotations

import os
import pickle
import queue
import shutil
import signal
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from distributed import WorkerPlugin, get_worker

from orchestrator.errors import Problem
from orchestrator.sweep.packet import Packet
from orchestrator.sweep.running import Row, Sample, failed

# one thread each: there is a process on every core
THREADS = ("OMP", "OPENBLAS", "MKL", "NUMEXPR", "VECLIB_MAXIMUM")
# Ctrl-C is for who started this one, who ends it; it may come before the process could ignore it
APART: dict[str, Any] = {"process_group": 0}
if sys.platform == "win32":
    APART = {"creationflags": subprocess.CREATE_NEW_PROCESS_GROUP}
LAST = 200  # characters of what a process said before it died


class Hand:
    """One process that runs samples, one after the other."""

    def __init__(self, packet: bytes) -> None:
        self._folder = Path(tempfile.mkdtemp(prefix="sweep-"))
        one = {f"{name}_NUM_THREADS": "1" for name in THREADS}
        with (self._folder / "errors").open("wb") as errors:
            self._process = subprocess.Popen(
                [sys.executable, "-m", "orchestrator.sweep.child", str(self._folder)],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=errors,
                env={**os.environ, **one},
                **APART,
            )
        self._put(packet)
        if self._next() is None:
            told = self._ended()
            self.close()
            raise Problem(f"a process for runs could not be started: {told}")

    def run(self, study: Any, sample: Sample) -> Row:
        """The row of a sample; the process may have died of it."""
        self._put(pickle.dumps(sample))
        found = self._next()
        return found if isinstance(found, Row) else failed(study, sample.run, self._ended())

    @property
    def alive(self) -> bool:
        return self._process.poll() is None

    def close(self) -> None:
        """End the process, whatever it does, and remove its files."""
        for pipe in filter(None, (self._process.stdin, self._process.stdout)):
            with suppress(OSError):
                pipe.close()
        with suppress(OSError):
            self._process.kill()
        self._process.wait()
        shutil.rmtree(self._folder, ignore_errors=True)

    def _next(self) -> Any:
        """What the process answers; None if it ends instead."""
        assert self._process.stdout
        try:
            return pickle.load(self._process.stdout)
        except (EOFError, ValueError, pickle.UnpicklingError):
            return None

    def _put(self, data: bytes) -> None:
        assert self._process.stdin
        with suppress(BrokenPipeError):  # what is read next tells of it
            self._process.stdin.write(data)
            self._process.stdin.flush()

    def _ended(self) -> str:
        """How the process ended."""
        status = self._process.wait()
        if status < 0:
            return f"the process ended by signal {-status} ({signal.Signals(-status).name})"
        said = (self._folder / "errors").read_text(errors="replace").strip().splitlines()
        told = f": {said[-1][:LAST]}" if said else ""
        return f"the process ended with status {status}{told}"


class Crew(WorkerPlugin):  # type: ignore[misc]  # Dask has no types
    """The processes of a worker, as many as it has threads; they are started when they are needed."""

    def __init__(self, name: str, packet: bytes) -> None:
        """name: of the study in this cluster."""
        self.name, self._packet = name, packet
        self._idle: queue.SimpleQueue[Hand]
        self._hands: set[Hand]

    def setup(self, worker: Any) -> None:  # noqa: ARG002  Dask passes it
        """On the worker."""
        packet: Packet = pickle.loads(self._packet)
        self._study, self._idle, self._hands = packet.study, queue.SimpleQueue(), set()

    def teardown(self, worker: Any) -> None:  # noqa: ARG002  Dask passes it
        """End the processes, also those that are at work."""
        for hand in tuple(self._hands):
            self._dismiss(hand)

    def work(self, batch: Sequence[Sample]) -> list[Row]:
        """Run samples; where one of them ends the process, another process goes on."""
        rows: list[Row] = []
        for sample in batch:
            hand = self._hand()
            rows.append(hand.run(self._study, sample))
            if hand.alive:
                self._idle.put(hand)
            else:
                self._dismiss(hand)
        return rows

    def _hand(self) -> Hand:
        with suppress(queue.Empty):
            return self._idle.get_nowait()
        hand = Hand(self._packet)
        self._hands.add(hand)
        return hand

    def _dismiss(self, hand: Hand) -> None:
        hand.close()
        self._hands.discard(hand)


def work(name: str, batch: Sequence[Sample]) -> list[Row]:
    """A task: run samples by the crew of this worker."""
    crew = get_worker().plugins.get(name)
    if not isinstance(crew, Crew):
        raise Problem(f"worker {get_worker().address}: has not got the study")
    return crew.work(batch)
