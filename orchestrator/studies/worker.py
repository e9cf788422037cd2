"""All that a worker needs to run a study, as one piece: no file of the study has to be where it runs.

The processes that one Dask worker runs samples in, and what is told of one that dies.

A process that runs samples and nothing else: an FMU may take it down without harm.

It reads a packet and then samples from its standard input, pickled one after the other, and answers each with
a row; it ends when its input does.
"""

from __future__ import annotations

import io
import os
import pickle
import queue
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
import zipfile
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from hashlib import sha256
from pathlib import Path
from typing import IO, Any

from distributed import WorkerPlugin, get_worker

from orchestrator.base.errors import Problem
from orchestrator.base.files import Location
from orchestrator.engine.native import compiled
from orchestrator.studies.cases import Case, Options
from orchestrator.studies.single_run import Row, Sample, failed, row
from orchestrator.studies.study import Study


@dataclass(frozen=True)
class Packet:
    """A study, its systems, and their FMUs.

    sources    FMU as the systems name it -> what `archives` calls it
    archives   digest of an archive -> its bytes
    """

    study: Study
    cases: Mapping[Options, Case]
    sources: Mapping[Location, str]
    archives: Mapping[str, bytes]

    def unpacked(self, folder: Path) -> Mapping[Options, Case]:
        """The cases with FMUs that lie unpacked in a folder.

        Each component has an FMU of its own there: two instances in one library may share variables.
        """
        there: dict[tuple[str, Location], Location] = {}
        found = {}
        for options, case in self.cases.items():
            components = dict(case.system.components)
            for name, component in components.items():
                if component.source is None:
                    continue
                place = name, component.source
                if place not in there:
                    there[place] = Location(folder / str(len(there)))
                    self._unpack(component.source, there[place].path)
                components[name] = replace(component, source=there[place])
            found[options] = replace(case, system=replace(case.system, components=components))
        return found

    def _unpack(self, source: Location, folder: Path) -> None:
        folder.mkdir(parents=True)
        archive = folder.with_suffix(".fmu")
        archive.write_bytes(self.archives[self.sources[source]])
        Location(archive).extract(folder)
        archive.unlink()


def packet(study: Study, cases: Mapping[Options, Case]) -> Packet:
    """The packet of a study."""
    sources, archives = dict[Location, str](), dict[str, bytes]()
    for case in cases.values():
        for component in case.system.components.values():
            if component.source is not None and component.source not in sources:
                data = _archive(component.source)
                sources[component.source] = digest(data)
                archives[digest(data)] = data
    return Packet(study, cases, sources, archives)


def digest(data: bytes) -> str:
    """What stands for some bytes."""
    return sha256(data).hexdigest()


def dumps(packet: Packet) -> bytes:
    """A packet as bytes."""
    return pickle.dumps(packet, protocol=pickle.HIGHEST_PROTOCOL)


def _archive(source: Location) -> bytes:
    """The bytes of an FMU; of an unpacked one those of an archive that does not depend on when it is made."""
    if not source.is_folder:
        return source.read()
    room = io.BytesIO()
    with zipfile.ZipFile(room, "w", zipfile.ZIP_DEFLATED) as archive:
        for name in source.names():
            archive.writestr(zipfile.ZipInfo(name), source.member(name).read())
    return room.getvalue()


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
                [sys.executable, "-m", "orchestrator.studies.worker", str(self._folder)],
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
