"""Child processes that run the samples of a study, so that a crash of an FMU ends only its own run.

A process gets the study and its systems, whose FMUs have been unpacked for all processes of a computer, and
runs one sample after the other. It starts fast, because it imports neither pandas nor SciPy nor Dask.
"""

from __future__ import annotations

import pickle
import re
import tempfile
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing, suppress
from dataclasses import dataclass, replace
from hashlib import sha256
from math import inf
from pathlib import Path
from typing import Any

from orchestrator.base.errors import Problem
from orchestrator.base.files import Location, naming, zip_bytes
from orchestrator.base.interrupts import DeferredInterrupts, in_threads
from orchestrator.base.processes import machine_memory, remove_folder
from orchestrator.base.text import first_names
from orchestrator.engine import simulation_loop
from orchestrator.engine.c_library import library
from orchestrator.lanes.one_by_one import unpacked, with_originals
from orchestrator.studies.cases import Options, StudyCase, Unit
from orchestrator.studies.single_run import RunOutcome, failed, outcomes
from orchestrator.studies.study import Study
from orchestrator.worker.main import Channel, left_behind
from orchestrator.worker.process import LimitExceeded, Worker, WorkerLimits

# Each process uses one thread, because there is a process on every core.
ONE_THREAD = {f"{name}_NUM_THREADS": "1" for name in ("OMP", "OPENBLAS", "MKL", "NUMEXPR", "VECLIB_MAXIMUM")}
CONTENTS = {"ready": str, "outcomes": tuple[list[RunOutcome], bool]}  # what a process may send
STOPPED = re.compile(r"(time_limit|memory_limit) = ([\d.e+-]+): ")  # begins the reason of a stopped run
WRITTEN = 1e-8  # relative rounding of a limit in a reason, of 9 digits
MEMORY_SHARE = 0.25  # of the machine's memory, for one run without a limit of its own
STORE_TIME = 1.5  # [s] between two times at which outcomes are stored: short to lose by a kill


# ---- what the processes get


def digest(data: bytes) -> str:
    """SHA-256 digest."""
    return sha256(data).hexdigest()


@dataclass(frozen=True)
class Payload:
    """A study, its systems, and their FMUs, so that no file has to exist on the computer of a process.

    archives  location of an FMU in the systems -> the bytes of its archive
    """

    study: Study
    cases: Mapping[Options, StudyCase]
    archives: Mapping[Location, bytes]

    def unpacked(self, folder: Path) -> tuple[dict[Options, StudyCase], dict[str, str]]:
        """The cases with FMUs that are unpacked in a folder, and unpacked FMU -> original FMU."""
        systems, originals = unpacked([case.system for case in self.cases.values()], folder, self._unpack)
        pairs = zip(self.cases.items(), systems, strict=True)
        return {options: replace(case, system=system) for (options, case), system in pairs}, originals

    def _unpack(self, source: Location, folder: Path) -> None:
        archive = folder.with_suffix(".fmu")
        archive.write_bytes(self.archives[source])
        try:
            Location(archive).extract(folder)
        except Problem as problem:  # with the name of the source instead of that of the copy
            raise Problem(str(problem).replace(str(archive), str(source))) from None
        archive.unlink()


def payload(study: Study, cases: Mapping[Options, StudyCase]) -> Payload:
    """The payload of a study."""
    components = (c for case in cases.values() for c in case.system.components.values())
    sources = dict.fromkeys(c.source for c in components if c.source)
    archives = {source: _archive(source) for source in sources}
    once = {content: content for content in archives.values()}  # pickle sends an object only once
    return Payload(study, cases, {source: once[content] for source, content in archives.items()})


def _archive(source: Location) -> bytes:
    """The bytes of an FMU; an unpacked FMU is packed, with bytes that do not depend on the time."""
    if not source.is_folder:
        return source.read()
    return zip_bytes({name: source.member(name).read() for name in source.names()})


# ---- limits of a run


def run_limits(study: Study) -> WorkerLimits:
    """The limits of a run of a study on this machine."""
    memory = MEMORY_SHARE * machine_memory() if study.memory_limit is None else 1e9 * study.memory_limit
    return WorkerLimits(total_time=study.time_limit, memory=memory)


def _by_key(limits: WorkerLimits) -> Mapping[str, float]:
    """The limits by the keys of a study file and in its units, [s] and [GB]."""
    return {"time_limit": limits.total_time, "memory_limit": limits.memory / 1e9}


def limit_is_raised(reason: str, limits: WorkerLimits) -> bool:
    """Did a limit stop the run that failed for this reason, and is that limit larger now?"""
    stopped = STOPPED.match(reason)
    return stopped is not None and _by_key(limits)[stopped[1]] > float(stopped[2]) * (1 + WRITTEN)


# ---- the processes


class ProcessEnded(Exception):
    """A process ended, or was stopped because it exceeded a limit."""


class RunProcesses:
    """The processes of a study on this computer, started on demand, as many as threads call `run`."""

    def __init__(self, payload: Payload) -> None:
        """Unpack the FMUs."""
        self._study, self._limits, self._stop = payload.study, run_limits(payload.study), threading.Event()
        self._folder, self._idle = Path(tempfile.mkdtemp(prefix="sweep-")), deque[Worker]()
        try:
            with naming(self._folder):
                cases, self._originals = payload.unpacked(self._folder)
        except BaseException:
            self.close()
            raise
        self._data = pickle.dumps((payload.study, cases), pickle.HIGHEST_PROTOCOL)
        self._fmus = first_names(self._originals.values())

    def stop(self) -> None:
        """End all runs as soon as possible."""
        self._stop.set()

    def close(self) -> None:
        """End all processes, and remove the FMUs; no thread calls `run` any more."""
        with DeferredInterrupts():
            while self._idle:
                self._idle.pop().close()
            remove_folder(self._folder)

    def run(self, unit: Unit) -> list[RunOutcome]:
        """Run samples together; if they end their process or exceed a limit, each one by itself."""
        process = self._process()
        process.forget_printed()  # by the run before
        process.put(unit)
        try:
            found, reusable = self._answer(process, self._limits)
        except ProcessEnded as ended:
            process.close()
            if len(unit) > 1:
                return [outcome for sample in unit for outcome in self.run((sample,))]
            found, reusable = [failed(self._study, unit[0].run, str(ended))], False
        if reusable:
            self._idle.append(process)
        else:
            process.close()
        return [replace(o, reason=with_originals(o.reason, self._originals)) for o in found]

    def _answer(self, process: Worker, limits: WorkerLimits) -> Any:
        """The answer of a process to the last message; raises ProcessEnded if it ends or is stopped."""
        try:
            for _, answer in process.messages(limits, self._stop):
                return answer
        except LimitExceeded as limit:
            name = "time_limit" if limit.timed_out else "memory_limit"
            raise ProcessEnded(f"{name} = {_by_key(limits)[name]:.9g}: {limit}") from None
        raise ProcessEnded(process.report)

    def _process(self) -> Worker:
        """An idle process, else a new one that has read the study."""
        if self._stop.is_set():
            raise Problem("the study is stopped")
        with suppress(IndexError):
            return self._idle.pop()
        process = Worker(
            "orchestrator.studies.processes:main", lambda: CONTENTS, "sweep", environment=ONE_THREAD
        )
        process.fmus = self._fmus
        process.put(self._data)
        try:
            problem = self._answer(process, WorkerLimits())
        except ProcessEnded as ended:
            problem = f"a process for runs could not be started: {ended}"
        if problem:
            process.close()
            raise Problem(problem)
        return process


def run_units(
    payload: Payload, units: Sequence[Unit], workers: int, store: Callable[[list[RunOutcome]], None]
) -> None:
    """Run samples on this computer, those of a unit together; `store` gets their outcomes now and then."""
    waiting, done, stored = iter(units), deque[RunOutcome](), -inf
    with closing(RunProcesses(payload)) as processes:

        def work() -> None:
            for unit in waiting:
                done.extend(processes.run(unit))

        def keep() -> None:
            nonlocal stored
            if done and time.monotonic() - stored > STORE_TIME:
                store([done.popleft() for _ in range(len(done))])
                stored = time.monotonic()

        in_threads([work] * min(workers, len(units)), processes.stop, keep)
        if done:
            store([*done])


def main(channel: Channel) -> None:
    """Child process: read the study, then samples that are run together, and send their outcomes."""
    simulation_loop.CORES = 1  # there is a process on every core
    study, cases = channel.get()
    missing = ""
    try:
        library()
    except Problem as problem:
        missing = str(problem)
    channel.put("ready", missing)
    while True:
        unit: Unit = channel.get()
        began = time.perf_counter()
        before = left_behind(channel, threads=False)
        found = outcomes(study, cases[unit[0].options], unit)
        wall = (time.perf_counter() - began) / len(unit)
        found = [replace(outcome, wall=wall) for outcome in found]
        channel.put("outcomes", (found, left_behind(channel, threads=False) == before))
