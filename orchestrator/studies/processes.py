"""Child processes that run the samples of a study, so that a crash of an FMU ends only its own run.

The payload of a process contains the study, its systems and their FMUs: no file of the study has to exist on
the computer of the process. Each Dask worker keeps as many processes as it has threads.
"""

from __future__ import annotations

import io
import pickle
import queue
import threading
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
from orchestrator.engine.recorded_calls import recorded
from orchestrator.studies.cases import Options, StudyCase
from orchestrator.studies.design import Sample
from orchestrator.studies.single_run import RunOutcome, failed, outcome
from orchestrator.studies.study import Study
from orchestrator.worker.main import Channel
from orchestrator.worker.process import LimitExceeded, Worker, WorkerLimits, machine_memory

# Each process uses one thread, because there is a process on every core.
THREADS = ("OMP", "OPENBLAS", "MKL", "NUMEXPR", "VECLIB_MAXIMUM")
MEMORY_SHARE = 0.25  # of the machine's memory, for one run without a limit of its own


def digest(data: bytes) -> str:
    """SHA-256 digest."""
    return sha256(data).hexdigest()


@dataclass(frozen=True)
class Payload:
    """A study, its systems, and their FMUs.

    sources   location of an FMU in the systems -> digest of its archive
    archives  digest of an archive -> its bytes
    """

    study: Study
    cases: Mapping[Options, StudyCase]
    sources: Mapping[Location, str]
    archives: Mapping[str, bytes]

    def unpacked(self, folder: Path) -> tuple[dict[Options, StudyCase], dict[str, str]]:
        """The cases with FMUs that are unpacked in a folder, and unpacked FMU -> original FMU.

        Each component gets its own copy of its FMU: two instances in one library may share variables.
        """
        copies: dict[tuple[str, Location], Location] = {}
        cases = {}
        for options, case in self.cases.items():
            components = dict(case.system.components)
            for name, component in components.items():
                if component.source is None:
                    continue
                key = name, component.source
                if key not in copies:
                    copies[key] = self._unpack(component.source, folder / str(len(copies)))
                components[name] = replace(component, source=copies[key])
            cases[options] = replace(case, system=replace(case.system, components=components))
        return cases, {str(copy): str(source) for (_, source), copy in copies.items()}

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
    """The bytes of an FMU; an unpacked FMU is packed, with bytes that do not depend on the time."""
    if not source.is_folder:
        return source.read()
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        for name in source.names():
            archive.writestr(zipfile.ZipInfo(name), source.member(name).read())
    return buffer.getvalue()


class ProcessPool(WorkerPlugin):  # type: ignore[misc]  # Dask has no types
    """Plugin of a Dask worker with its child processes, one for each thread, started on demand."""

    def __init__(self, name: str, data: bytes) -> None:
        """name: name of the plugin in this cluster; data: pickled payload."""
        self.name, self._data = name, data
        self._idle: queue.SimpleQueue[Worker]
        self._processes: set[Worker]

    def setup(self, worker: Any) -> None:  # noqa: ARG002  Dask passes it
        """Read the study; called on the Dask worker."""
        self._study = pickle.loads(self._data).study
        gigabytes = self._study.memory_limit
        memory = MEMORY_SHARE * machine_memory() if gigabytes is None else 1e9 * gigabytes
        self._limits = WorkerLimits(total_time=self._study.time_limit, memory=memory)
        self._idle, self._processes, self._stop = queue.SimpleQueue(), set(), threading.Event()

    def teardown(self, worker: Any) -> None:  # noqa: ARG002  Dask passes it
        """End all processes, including those that run a sample."""
        self._stop.set()
        for process in tuple(self._processes):
            self._close(process)

    def run(self, batch: Sequence[Sample]) -> list[RunOutcome]:
        """Run samples; if a sample ends its process, the next one runs in another process."""
        outcomes: list[RunOutcome] = []
        for sample in batch:
            process = self._process()
            process.put(sample)
            try:
                outcomes.append(self._answer(process, self._limits))
                self._idle.put(process)
            except ProcessEnded as ended:
                self._close(process)
                outcomes.append(failed(self._study, sample.run, str(ended)))
        return outcomes

    def _answer(self, process: Worker, limits: WorkerLimits) -> Any:
        """The answer of a process to the last message; raises ProcessEnded if it ends or is stopped."""
        try:
            for answer in process.messages(limits, self._stop):
                return answer
        except LimitExceeded as limit:
            raise ProcessEnded(str(limit)) from None
        raise ProcessEnded(process.report)

    def _process(self) -> Worker:
        """An idle process, else a new one that has read the payload."""
        with suppress(queue.Empty):
            return self._idle.get_nowait()
        if self._stop.is_set():
            raise Problem("the study is stopped")
        single_thread = {f"{name}_NUM_THREADS": "1" for name in THREADS}
        process = Worker("orchestrator.studies.processes:main", "sweep", environment=single_thread)
        self._processes.add(process)
        process.put(self._data)
        try:
            self._answer(process, WorkerLimits())
        except ProcessEnded as ended:
            self._close(process)
            raise Problem(f"a process for runs could not be started: {ended}") from None
        return process

    def _close(self, process: Worker) -> None:
        process.close()
        self._processes.discard(process)


class ProcessEnded(Exception):
    """A process ended, or was stopped because it exceeded a limit."""


def run_batch(name: str, batch: Sequence[Sample]) -> list[RunOutcome]:
    """The Dask task: run samples in the processes of this Dask worker."""
    pool = get_worker().plugins.get(name)
    if not isinstance(pool, ProcessPool):
        raise Problem(f"worker {get_worker().address}: expected the plugin {name}, got none")
    return pool.run(batch)


def main(channel: Channel) -> None:
    """Child process: read the payload, then samples, and send the outcome of each."""
    simulation_loop.CORES = 1  # there is a process on every core
    study_payload: Payload = channel.get()
    cases, originals = study_payload.unpacked(channel.folder / "fmus")
    open_fmu = recorded(channel.activity, originals)
    channel.put("ready")
    while True:
        sample: Sample = channel.get()
        began = time.perf_counter()
        result = outcome(study_payload.study, cases[sample.options], sample, open_fmu)
        reason = result.reason
        for unpacked, original in originals.items():  # folders differ from process to process
            reason = reason.replace(unpacked, original)
        channel.put(replace(result, reason=reason, wall=time.perf_counter() - began))
