"""The processes that run the samples of a study: an FMU may take one down without harm.

A packet is all that such a process needs, as one piece: no file of the study has to be where it runs. Each Dask worker
keeps processes of its own, as many as it has threads.
"""

from __future__ import annotations

import io
import pickle
import queue
import time
import zipfile
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from hashlib import sha256
from pathlib import Path
from typing import Any

from distributed import WorkerPlugin, get_worker

from orchestrator.base.errors import Problem
from orchestrator.base.files import Location
from orchestrator.engine import simulation_loop
from orchestrator.studies.cases import Case, Options
from orchestrator.studies.single_run import Row, Sample, failed, row
from orchestrator.studies.study import Study
from orchestrator.worker.main import Channel
from orchestrator.worker.process import Worker


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


class Runner:
    """One process that runs samples, one after the other."""

    def __init__(self, packet: bytes) -> None:
        one = {f"{name}_NUM_THREADS": "1" for name in THREADS}
        self._process = Worker("orchestrator.studies.worker:main", "sweep", environment=one)
        self._process.put(packet)
        try:
            self._process.get()
        except EOFError:
            message = self._ended()
            self.close()
            raise Problem(f"a process for runs could not be started: {message}") from None

    def run(self, study: Any, sample: Sample) -> Row:
        """The row of a sample; the process may have died of it."""
        self._process.put(sample)
        try:
            found: Row = self._process.get()
        except EOFError:
            return failed(study, sample.run, self._ended())
        return found

    @property
    def alive(self) -> bool:
        return self._process.alive

    def close(self) -> None:
        """End the process, whatever it does, and remove its files."""
        self._process.close()

    def _ended(self) -> str:
        """How the process ended."""
        last = self._process.last_words
        message = f"the process ended: {self._process.ending}"
        return f"{message}: {last}" if last else message


class Crew(WorkerPlugin):  # type: ignore[misc]  # Dask has no types
    """The processes of a worker, as many as it has threads; they are started when they are needed."""

    def __init__(self, name: str, packet: bytes) -> None:
        """name: of the study in this cluster."""
        self.name, self._packet = name, packet
        self._idle: queue.SimpleQueue[Runner]
        self._runners: set[Runner]

    def setup(self, worker: Any) -> None:  # noqa: ARG002  Dask passes it
        """On the worker."""
        packet: Packet = pickle.loads(self._packet)
        self._study, self._idle, self._runners = packet.study, queue.SimpleQueue(), set()

    def teardown(self, worker: Any) -> None:  # noqa: ARG002  Dask passes it
        """End the processes, also those that are at work."""
        for runner in tuple(self._runners):
            self._dismiss(runner)

    def work(self, batch: Sequence[Sample]) -> list[Row]:
        """Run samples; where one of them ends the process, another process goes on."""
        rows: list[Row] = []
        for sample in batch:
            runner = self._runner()
            rows.append(runner.run(self._study, sample))
            if runner.alive:
                self._idle.put(runner)
            else:
                self._dismiss(runner)
        return rows

    def _runner(self) -> Runner:
        with suppress(queue.Empty):
            return self._idle.get_nowait()
        runner = Runner(self._packet)
        self._runners.add(runner)
        return runner

    def _dismiss(self, runner: Runner) -> None:
        runner.close()
        self._runners.discard(runner)


def work(name: str, batch: Sequence[Sample]) -> list[Row]:
    """A task: run samples by the crew of this worker."""
    crew = get_worker().plugins.get(name)
    if not isinstance(crew, Crew):
        raise Problem(f"worker {get_worker().address}: has not got the study")
    return crew.work(batch)


def main(channel: Channel) -> None:
    """In the process: a packet comes first, then samples, each answered with a row."""
    simulation_loop.CORES = 1  # there is a process on every core
    packet: Packet = channel.get()
    cases = packet.unpacked(channel.folder / "fmus")
    true = {str(c.source): name for name, c in _sources(packet, cases)}
    channel.put("ready")
    while True:
        sample = channel.get()
        began = time.perf_counter()
        found = row(packet.study, cases[sample.options], sample)
        channel.put(replace(found, reason=_told(found, true), wall=time.perf_counter() - began))


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
