"""The processes that run the samples of a study: an FMU that crashes costs no more than its own run.

A payload is all that such a process needs, in one piece: no file of the study has to exist where it runs.
Each Dask worker keeps as many processes as it has threads.
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
from orchestrator.studies.cases import Options, StudyCase
from orchestrator.studies.design import Sample
from orchestrator.studies.single_run import RunOutcome, failed, outcome
from orchestrator.studies.study import Study
from orchestrator.worker.main import Channel
from orchestrator.worker.process import Worker

# one thread each: there is a process on every core
THREADS = ("OMP", "OPENBLAS", "MKL", "NUMEXPR", "VECLIB_MAXIMUM")


def digest(data: bytes) -> str:
    """The SHA-256 of some bytes."""
    return sha256(data).hexdigest()


@dataclass(frozen=True)
class Payload:
    """A study, its systems, and their FMUs.

    sources   FMU as the systems name it -> digest of its archive
    archives  digest of an archive -> its bytes
    """

    study: Study
    cases: Mapping[Options, StudyCase]
    sources: Mapping[Location, str]
    archives: Mapping[str, bytes]

    def unpacked(self, folder: Path) -> tuple[dict[Options, StudyCase], dict[str, str]]:
        """The cases with FMUs that are unpacked in a folder, and unpacked FMU -> original FMU.

        Each component has an FMU of its own there: two instances in one library may share variables.
        """
        places: dict[tuple[str, Location], Location] = {}
        cases = {}
        for options, case in self.cases.items():
            components = dict(case.system.components)
            for name, component in components.items():
                if component.source is None:
                    continue
                key = name, component.source
                if key not in places:
                    places[key] = self._unpack(component.source, folder / str(len(places)))
                components[name] = replace(component, source=places[key])
            cases[options] = replace(case, system=replace(case.system, components=components))
        return cases, {str(place): str(source) for (_, source), place in places.items()}

    def _unpack(self, source: Location, folder: Path) -> Location:
        folder.mkdir(parents=True)
        archive = folder.with_suffix(".fmu")
        archive.write_bytes(self.archives[self.sources[source]])
        Location(archive).extract(folder)
        archive.unlink()
        return Location(folder)


def payload(study: Study, cases: Mapping[Options, StudyCase]) -> Payload:
    """The payload of a study."""
    sources, archives = dict[Location, str](), dict[str, bytes]()
    for case in cases.values():
        for component in case.system.components.values():
            if component.source is not None and component.source not in sources:
                data = _archive(component.source)
                sources[component.source] = digest(data)
                archives[digest(data)] = data
    return Payload(study, cases, sources, archives)


def _archive(source: Location) -> bytes:
    """The bytes of an FMU; an unpacked one is packed so that the bytes do not depend on the time."""
    if not source.is_folder:
        return source.read()
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        for name in source.names():
            archive.writestr(zipfile.ZipInfo(name), source.member(name).read())
    return buffer.getvalue()


class ProcessPool(WorkerPlugin):  # type: ignore[misc]  # Dask has no types
    """The processes of a Dask worker, as many as it has threads; they are started when they are needed."""

    def __init__(self, name: str, data: bytes) -> None:
        """name: of the study in this cluster; data: its payload, pickled."""
        self.name, self._data = name, data
        self._idle: queue.SimpleQueue[Worker]
        self._processes: set[Worker]

    def setup(self, worker: Any) -> None:  # noqa: ARG002  Dask passes it
        """On the Dask worker."""
        self._study = pickle.loads(self._data).study
        self._idle, self._processes = queue.SimpleQueue(), set()

    def teardown(self, worker: Any) -> None:  # noqa: ARG002  Dask passes it
        """End the processes, also the busy ones."""
        for process in tuple(self._processes):
            self._close(process)

    def run(self, batch: Sequence[Sample]) -> list[RunOutcome]:
        """Run samples; where one of them ends the process, another process goes on."""
        outcomes: list[RunOutcome] = []
        for sample in batch:
            process = self._process()
            process.put(sample)
            try:
                outcomes.append(process.get())
            except EOFError:
                outcomes.append(failed(self._study, sample.run, _ending(process)))
            if process.alive:
                self._idle.put(process)
            else:
                self._close(process)
        return outcomes

    def _process(self) -> Worker:
        """An idle process, else a new one that has read the payload."""
        with suppress(queue.Empty):
            return self._idle.get_nowait()
        one = {f"{name}_NUM_THREADS": "1" for name in THREADS}
        process = Worker("orchestrator.studies.processes:main", "sweep", environment=one)
        process.put(self._data)
        try:
            process.get()
        except EOFError:
            message = _ending(process)
            process.close()
            raise Problem(f"a process for runs could not be started: {message}") from None
        self._processes.add(process)
        return process

    def _close(self, process: Worker) -> None:
        process.close()
        self._processes.discard(process)


def _ending(process: Worker) -> str:
    """How the process ended."""
    message, last = f"the process ended: {process.ending}", process.last_stderr_line
    return f"{message}: {last}" if last else message


def run_batch(name: str, batch: Sequence[Sample]) -> list[RunOutcome]:
    """The Dask task: run samples in the processes of this Dask worker."""
    pool = get_worker().plugins.get(name)
    if not isinstance(pool, ProcessPool):
        raise Problem(f"worker {get_worker().address}: has not got the study")
    return pool.run(batch)


def main(channel: Channel) -> None:
    """In the process: read a payload, then samples, and answer each with its outcome."""
    simulation_loop.CORES = 1  # there is a process on every core
    study_payload: Payload = channel.get()
    cases, originals = study_payload.unpacked(channel.folder / "fmus")
    channel.put("ready")
    while True:
        sample: Sample = channel.get()
        began = time.perf_counter()
        result = outcome(study_payload.study, cases[sample.options], sample)
        reason = result.reason
        for unpacked, original in originals.items():  # the folder of this process is another one each time
            reason = reason.replace(unpacked, original)
        channel.put(replace(result, reason=reason, wall=time.perf_counter() - began))
