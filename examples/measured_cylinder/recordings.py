"""The recordings: a description in TOML next to each .mat file, and reading them at a lower rate."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path

from fmus.identification.recordings.clock import resample
from orchestrator.base.errors import Problem
from orchestrator.data.description import (
    Condition,
    Description,
    Origin,
    SignalDescription,
    TimeDescription,
    write_description,
)
from orchestrator.data.recording import Recording, read_recording

NAME = re.compile(r"m_find_b_p([AB])_([1-9])V_sample_(\d+)\.mat")
PRESSURES = {"A": "head_pressure", "B": "rod_pressure"}
HELD_OUT = (2, 4)  # V
RATE = 125.0  # Hz, of fit and comparison; the filter before passes 50 Hz
START = 0.056  # s, the valve has closed before; the steps lie between two samples
METRES = 0.02  # per volt of the position
CODE = 20 / 4096  # V, step of the converter of +-10 V with 12 bit
NOISE = {"position": 0.04 * METRES, "pressure": 0.3}  # m, MPa: of a sample at rest


@dataclass(frozen=True)
class File:
    """One file of the folder: which pressure, step of the command [V], number of the repeat."""

    path: Path
    chamber: str
    volts: int
    repeat: int


def files(folder: Path) -> list[File]:
    """The recordings of a folder by voltage, chamber and number; a file that is there twice counts once."""
    found, seen = list[File](), dict[bytes, str]()
    for path in folder.rglob("*.mat"):
        if match := NAME.fullmatch(path.name):
            found.append(File(path, match[1], int(match[2]), int(match[3])))
    found.sort(key=lambda f: (f.volts, f.chamber, f.repeat))
    if not found:
        raise Problem(f"{folder}: expected files such as m_find_b_pA_1V_sample_1.mat, got none")
    different = []
    for file in found:
        digest = sha256(file.path.read_bytes()).digest()
        if digest in seen:
            print(f"{file.path.name}: the same content as {seen[digest]}, left out")
            continue
        seen[digest] = file.path.name
        different.append(file)
    return different


def describe(file: File) -> Path:
    """Write the description of a file next to it."""
    pressure = PRESSURES[file.chamber]
    description = Description(
        reference=Origin(
            title=f"Steps of +-{file.volts} V, pressure of chamber {file.chamber}, run {file.repeat}",
            origin="github.com/ingxfm/find-the-viscous-friction-value-from-a-bunch-of-.mat-data-files",
        ),
        experiment={
            "procedure": "measured_cylinder",
            "use": "test" if file.volts in HELD_OUT else "train",
            "step": Condition(float(file.volts), "V"),
            "chamber": file.chamber,
        },
        time=TimeDescription(column="t", start=START),
        signals={
            "command": SignalDescription(column="w_verdadero2", unit="V"),
            "position": SignalDescription(
                column="poloha_bez_filtr2",
                factor=METRES,
                unit="m",
                noise=NOISE["position"],
                resolution=CODE * METRES,
                span=(-10 * METRES, (10 - CODE) * METRES),
            ),
            pressure: SignalDescription(column="pressure_bez_filtr1", unit="MPa", noise=NOISE["pressure"]),
        },
    )
    path = file.path.with_suffix(".toml")
    write_description(path, description)
    return path


def read(chosen: Sequence[File]) -> Iterator[Recording]:
    """The recordings at a lower rate; their signals pass a filter without delay before."""
    for file in chosen:
        describe(file)
        yield resample(read_recording(file.path), RATE, hold=["command"])


def select(found: Sequence[File], volts: Sequence[int], repeats: int | None) -> list[File]:
    """The first repeats of each chamber at these steps; None: all."""
    groups: dict[tuple[int, str], list[File]] = {}
    for file in found:
        if file.volts in volts:
            groups.setdefault((file.volts, file.chamber), []).append(file)
    return [file for group in groups.values() for file in _spread(group, repeats)]


def _spread(group: Sequence[File], repeats: int | None) -> list[File]:
    """Some of the repeats, from the first to the last, because the rig warms up."""
    if repeats is None or repeats >= len(group):
        return list(group)
    if repeats == 1:
        return [group[len(group) // 2]]
    return [group[round(k * (len(group) - 1) / (repeats - 1))] for k in range(repeats)]
