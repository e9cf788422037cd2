"""Copies of an SSP with changes in its system structure: tools take the system as it is in the file."""

from __future__ import annotations

import re
import zipfile
from pathlib import Path

from lxml import etree

RATE = re.compile(r"_(rate|acceleration)$")
Wire = tuple[str, str]  # output and input, both as component.variable


def structure(system: Path) -> bytes:
    """The system structure."""
    with zipfile.ZipFile(system) as archive:
        return archive.read("SystemStructure.ssd")


def wires(system: Path) -> list[Wire]:
    """All connections between components."""
    found = etree.fromstring(structure(system)).iterfind(".//{*}Connection")
    ends = [
        (c.attrib[f"{end}Element"], c.attrib[f"{end}Connector"]) for c in found for end in ("start", "end")
    ]
    names = [".".join(end) for end in ends]
    return list(zip(names[::2], names[1::2], strict=True))


def without_rates(system: Path, target: Path) -> Path:
    """A copy that lacks the wires of the rate ports: inputs are held by whoever cannot do better."""
    root = etree.fromstring(structure(system))
    for wire in root.findall(".//{*}Connection"):
        if RATE.search(wire.attrib["endConnector"]):
            wire.getparent().remove(wire)
    return _copy(system, target, etree.tostring(root))


def for_libcosim(system: Path, target: Path, step: float, workers: int) -> Path:
    """A copy with libcosim's annotation: the step [s], and threads beside the one that calls."""
    root = etree.fromstring(structure(system))
    algorithm = root.find(".//{*}FixedStepAlgorithm")
    algorithm.attrib.update({"baseStepSize": repr(step), "numWorkerThreads": str(workers)})
    return _copy(system, target, etree.tostring(root))


def _copy(system: Path, target: Path, structure: bytes) -> Path:
    with zipfile.ZipFile(system) as old, zipfile.ZipFile(target, "w") as new:
        for name in old.namelist():
            new.writestr(name, structure if name == "SystemStructure.ssd" else old.read(name))
    return target
