"""What a child process of a study gets and does: it unpacks the systems and runs one sample after the other.

No file of the study has to exist on the computer of the process. A process starts fast, because it imports
neither pandas nor SciPy nor Dask.
"""

from __future__ import annotations

import io
import time
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass, replace
from hashlib import sha256
from pathlib import Path

from orchestrator.base.errors import Problem
from orchestrator.base.files import Location
from orchestrator.engine import simulation_loop
from orchestrator.studies.cases import Options, StudyCase, Unit
from orchestrator.studies.single_run import outcomes
from orchestrator.studies.study import Study
from orchestrator.worker.main import Channel, left_behind


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
                    copies[key] = self._unpack(component.source, folder / f"{len(copies):06}")
                components[name] = replace(component, source=copies[key])
            cases[options] = replace(case, system=replace(case.system, components=components))
        return cases, {str(copy): str(source) for (_, source), copy in copies.items()}

    def _unpack(self, source: Location, folder: Path) -> Location:
        folder.mkdir(parents=True)
        archive = folder.with_suffix(".fmu")
        archive.write_bytes(self.archives[self.sources[source]])
        try:
            Location(archive).extract(folder)
        except Problem as problem:  # with the name of the source instead of that of the copy
            raise Problem(str(problem).replace(str(archive), str(source))) from None
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


def main(channel: Channel) -> None:
    """Child process: read the payload, then samples that are run together, and send their outcomes."""
    simulation_loop.CORES = 1  # there is a process on every core
    study_payload: Payload = channel.get()
    cases, originals = study_payload.unpacked(channel.folder / "fmus")
    channel.put("originals", originals)
    while True:
        unit: Unit = channel.get()
        began = time.perf_counter()
        before = left_behind(threads=False)
        results = outcomes(study_payload.study, cases[unit[0].options], unit)
        wall = (time.perf_counter() - began) / len(unit)
        results = [replace(result, wall=wall) for result in results]
        channel.put("outcomes", (results, left_behind(threads=False) == before))
