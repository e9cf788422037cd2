"""All that a worker needs to run a study, as one piece: no file of the study has to be where it runs."""

from __future__ import annotations

import io
import pickle
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass, replace
from hashlib import sha256
from pathlib import Path

from orchestrator.files.archive import Location
from orchestrator.sweep.cases import Case, Options
from orchestrator.sweep.study import Study


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
