"""FMUs driven from C: compilers, the driver in c/, and scripts for it."""

import math
import os
import subprocess
import zipfile
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import count
from pathlib import Path

import fmpy
import numpy as np
from kit.compile import compiled
from kit.needs import needs

from benchmarks.reference import work_cycle
from fmus.export.compile import HEADERS, PLATFORMS, host
from fmus.operator_input.work_cycle import COMMANDS

CODE = Path(__file__).parent / "c"
STANDARD = ("-std=c99", "-D_XOPEN_SOURCE=700", "-Wall", "-Wextra", "-isystem", str(HEADERS))
# as for the FMUs: with others the project's compiler makes its Windows libraries anew, for a minute
OPTIMISED = ("-O3", "-g0", "-s")
needs_gcc = needs("gcc")
_numbers = count()


def run(command: Sequence[object], **more: object) -> subprocess.CompletedProcess[str]:
    """Run a program; a failure contains its output."""
    words = [str(word) for word in command]
    done = subprocess.run(words, capture_output=True, text=True, check=False, timeout=1800, **more)
    ended = f"{' '.join(words[:6])}: exit status {done.returncode}"
    assert done.returncode == 0, f"{ended}\n{done.stderr[-3000:]}"
    return done


def driver(version: int, platform: str | None = None) -> Path:
    """The driver for FMUs of this version of FMI, for this computer or another platform."""
    name = f"drive{version}" + (".exe" if "windows" in (platform or host()) else "")
    libraries = () if name.endswith(".exe") else ("-ldl", "-lpthread")
    code, headers = (CODE / "drive.c", CODE / f"fmu{version}.c"), sorted(CODE.glob("*.h"))
    target = PLATFORMS[platform or host()].target
    flags = (*STANDARD, *OPTIMISED, *libraries)
    return compiled(name, code, *flags, included=headers, target=target)


@dataclass(frozen=True)
class Fmu:
    """Properties of an FMU for a script."""

    name: str
    version: int
    token: str
    library: Path
    sources: Path
    references: Mapping[str, int]
    start: Mapping[str, float]
    shown: tuple[int, int]  # states, derivatives and outputs: first value reference and how many
    states: int

    def inputs(self) -> list[str]:
        return [name for name in self.start if name in PUSHED]


def unpack(path: Path, folder: Path, platform: str | None = None) -> Fmu:
    """Unpack an FMU."""
    with zipfile.ZipFile(path) as archive:
        archive.extractall(folder)
    description = fmpy.read_model_description(str(folder), validate=False)
    version = int(description.fmiVersion[0])
    target = PLATFORMS[platform or host()]
    place = target.folders[0] if version == 2 else target.name
    variables = {v.name: v for v in description.modelVariables}
    shown = [v.valueReference for v in variables.values() if v.causality in ("local", "output")]
    return Fmu(
        name=description.modelName,
        version=version,
        token=description.guid,
        library=folder / "binaries" / place / f"{description.modelName}{target.suffix}",
        sources=folder / "sources",
        references={name: v.valueReference for name, v in variables.items()},
        start={n: float(v.start) for n, v in variables.items() if v.causality == "input"},
        shown=(min(shown), len(shown)),
        states=len(description.derivatives),
    )


def drive(
    program: Path,
    fmu: Fmu,
    script: Iterable[str],
    folder: Path,
    *,
    threads: int = 1,
    before: Sequence[str] = (),
    environment: Mapping[str, str] | None = None,
    library: Path | None = None,
) -> list[str]:
    """Run a script, in each thread; what each one prints. `before` is a program that runs the driver."""
    stem = f"run{next(_numbers)}"
    (folder / f"{stem}.txt").write_text("\n".join([*script, ""]), encoding="utf-8")
    # names relative to the folder mean the same to Windows programs under Wine
    binary = os.path.relpath(library or fmu.library, folder)
    binary = binary if "/" in binary else f"./{binary}"
    words = [*before, program, binary, fmu.token, f"{stem}.txt", stem, threads]
    run(words, cwd=folder, env={**os.environ, **(environment or {})})
    return [(folder / f"{stem}.{k}").read_text(encoding="utf-8") for k in range(threads)]


def numbers(text: str) -> np.ndarray:
    """Output of `get`, one row per call."""
    return np.array([[float(word) for word in line.split()] for line in text.splitlines()])


# inputs and by how much they are moved, about a tenth of what the machine does
PUSHED = {
    **dict.fromkeys(("swing_command", "boom_command", "stick_command"), 1.0),
    **{"swing_torque": 1e3, "boom_force": 200.0, "stick_force": -100.0},
}


def begin(fmu: Fmu, i: int = 0, kind: str = "cs") -> list[str]:
    """A new instance; an operator is just about to move a lever."""
    awake = [f"set {i} {fmu.references['clock']} 1.1"] if "clock" in fmu.references else []
    return [f"make {i} {kind}", f"begin {i} 0 1e-6", *awake, f"end {i}"]


def push(fmu: Fmu, phase: float, i: int = 0) -> list[str]:
    """All inputs at a point of a sine."""
    return [
        f"set {i} {fmu.references[name]} {fmu.start[name] + PUSHED[name] * math.sin(phase)!r}"
        for name in fmu.inputs()
    ]


def look(fmu: Fmu, i: int = 0) -> str:
    return f"get {i} {fmu.shown[0]} {fmu.shown[1]}"


def moves(fmu: Fmu, first: int, steps: int, step: float = 0.005, i: int = 0) -> list[str]:
    """Steps with moving inputs, and the outputs after each."""
    lines = []
    for k in range(first, first + steps):
        lines += [*push(fmu, 0.1 * k, i), f"step {i} {step!r} 1", look(fmu, i)]
    return lines


def cycle(fmu: Fmu, stop: float) -> list[str]:
    """The work cycle of harvester.fmu up to `stop` [s], with the rates of the commands."""
    time, commands = work_cycle()
    step = float(time[1] - time[0])
    lines = begin(fmu)
    for k in range(round(stop / step)):
        for name, value, following in zip(COMMANDS, commands[k], commands[k + 1], strict=True):
            lines.append(f"set 0 {fmu.references[name]} {float(value)!r}")
            lines.append(f"set 0 {fmu.references[f'{name}_rate']} {float(following - value) / step!r}")
        lines += [f"step 0 {step!r} 1", look(fmu)]
    return lines


def assert_same(ours: np.ndarray, theirs: np.ndarray) -> None:
    """Two runs of the same C give the same numbers, to 1e-9 of what each one ranges over.

    Rounding differs, at 1e-16, where libraries of mathematics and orders of operations do. The solver carries
    that on: its steps follow from estimates of its error, and change smoothly with them.
    """
    assert ours.shape == theirs.shape
    assert np.ptp(ours, axis=0).max() > 0
    scale = np.maximum(np.ptp(ours, axis=0), 1e-6 * np.abs(ours).max(axis=0))
    errors = np.abs(ours - theirs).max(axis=0) / np.where(scale > 0, scale, 1.0)
    assert errors.max() <= 1e-9, f"column {errors.argmax()}: {errors.max():.3g} of its range"
