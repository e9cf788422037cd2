"""The state of a run in a file, from which another process goes on bit for bit: `save_state`, `resume`.

The file is a zip of NumPy arrays: what FMUs serialise, the memory of the engine without addresses, the events
so far, and a JSON of what has to be the same in both runs. The engine allocates its arrays in the same order
in both, so that each finds its values again.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import fields
from hashlib import file_digest, sha256
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any
from zipfile import ZipFile

import numpy as np

from orchestrator.base.compiler import host
from orchestrator.base.errors import Problem
from orchestrator.base.files import ZIP_ERRORS, Location, require, size_fault, write_whole
from orchestrator.base.options import seconds
from orchestrator.engine.c_library import recipe
from orchestrator.engine.options import RunOptions
from orchestrator.engine.time_grid import Grid
from orchestrator.fmi.cosimulation import RunningFmu

if TYPE_CHECKING:
    from orchestrator.engine.job import Job
    from orchestrator.engine.simulation_loop import SimulationLoop

FORMAT, SUFFIX = "harvester-cosim run 1", ".state"
DIGEST = 32  # bytes in front of the archive
SHOWN = 60  # letters of a difference in a message
SERIALISES = ("canSerializeFMUstate", "canSerializeFMUState")


def asked(options: RunOptions, times: Grid) -> tuple[Path, float] | None:
    """The file of a state and its time [s], at a point of the run: "FILE@TIME"; without a time the end."""
    given = options.save_state
    if given is None:
        return None
    name, at, text = str(given).rpartition("@")
    if Path(text).name != text:  # an @ in the name of a folder
        name, at, text = "", "", str(given)
    file = Path(name if at else text)
    if file.is_dir():  # as "" is
        raise Problem(f"save_state: expected the name of a file, FILE or FILE@TIME, got {str(given)!r}")
    if not at:
        return file, times.stop
    time = float(seconds(text, f"save_state {given}") or 0.0)
    if not times.start < time <= times.stop:
        span = f"from {times.start:g} s to {times.stop:g} s"
        raise Problem(f"save_state {given}: expected a time of the run, {span}, got {text}")
    points = np.array([*times.divided, float(times.nearest(np.array([time]))[0])])
    nearest = float(points[np.argmin(np.abs(points - time))])
    if abs(nearest - time) > 1e-9 * max(abs(time), times.step):
        expected = f"expected a communication point, such as {nearest:.9g} s"
        raise Problem(f"save_state {given}: {expected}, got {text}")
    return file, nearest


def check(job: Job) -> tuple[str, ...]:
    """Raise Problem for options that exclude each other, and FMUs that cannot be saved; returns notes."""
    options = job.options
    given = [name for name in ("save_state", "resume") if getattr(options, name) is not None]
    if not given:
        return ()
    asked(options, job.times)
    for name in ("accuracy", "error_estimate"):
        if getattr(options, name):
            raise Problem(f"{given[0]}: expected one run with a given master and step, got {name}")
    if options.resume == "":
        raise Problem("resume: expected the file of a state, got an empty name")
    if options.resume is not None:
        require(options.resume, (SUFFIX,))
    for name, component in job.system.components.items():
        face = component.interface
        entry = face.model.interfaces.get(face.kind)
        if component.source is None or entry is None or not (face.rollback and entry.declares(*SERIALISES)):
            raise Problem(f"{given[0]}: {name} cannot serialise its state: expected FMUs that can")
    own = job.coupling.method
    return (f"{given[0]}: what master {own.name} keeps in Python is not in the state",) if own.step else ()


def _identity(job: Job, loop: SimulationLoop) -> dict[str, Any]:
    """What is the same in the run that was saved and in the one that goes on."""
    settings = {f.name: getattr(job.coupling, f.name) for f in fields(job.coupling) if f.name != "master"}
    system, network = job.system, loop.network
    fmus = {f"FMU of {name}": fmu["sha256"] for name, fmu in job.provenance.fmus.items()}
    start = {f"start values of {n}": str(sorted(c.start.items())) for n, c in system.components.items()}
    engine = sha256(str(sorted(recipe(host())[1].items())).encode()).hexdigest()[:12]
    return {
        "platform": f"{host()}, engine {engine}",
        "master": job.coupling.method.name,
        **{f"setting {name} of the master": str(value) for name, value in settings.items()},
        "start": job.times.start,
        "step": None if job.times.free else job.times.step,
        "points per row": job.times.every,
        "tolerance": job.options.tolerance,
        **fmus,
        **start,
        "connections": str([str(c) for c in system.connections]),
        "signals": str([str(p) for p in (*network.reals.index, *network.integers.index)]),
        "recorded signals": str(loop.recorder.layout.names),
        "inputs of the scenario": str(sorted(map(str, job.scenario.columns)) if job.scenario else []),
    }


def save(file: Path, job: Job, loop: SimulationLoop) -> None:
    """Write the state of a run at a communication point."""
    arrays: dict[str, Any] = {f"memory_{k}": part for k, part in enumerate(loop.network.binding.memory())}
    for k, slave in enumerate(_fmus(loop)):
        arrays |= {f"fmu_{k}_{name}": np.asarray(part) for name, part in slave.saved().items()}
    document = {"format": FORMAT, "identity": _identity(job, loop), "loop": loop.saved()}
    text = np.frombuffer(json.dumps(document).encode(), np.uint8)
    for write in (np.savez_compressed, np.savez):  # packed zeros would look like a bomb
        write(buffer := BytesIO(), document=text, **arrays)
        with ZipFile(buffer) as archive:
            fault = size_fault(archive.infolist(), len(data := buffer.getvalue()))
        if not fault:
            break
    else:
        raise Problem(f"{file}: {fault}")
    write_whole(file, sha256(data).digest() + data)


def resume(file: Path, job: Job, loop: SimulationLoop) -> None:
    """Continue from a saved state in a run that has begun."""
    try:
        _resume(file, _read(file), job, loop)
    except (*ZIP_ERRORS, LookupError, AttributeError, ArithmeticError, TypeError, MemoryError):
        expected = "expected the state of a run as --save-state writes it"
        raise Problem(f"{file}: {expected}, got another or a damaged file") from None


def _resume(file: Path, arrays: dict[str, Any], job: Job, loop: SimulationLoop) -> None:
    document = json.loads(bytes(arrays.pop("document")))
    for name, now in _identity(job, loop).items():
        saved = document["identity"].get(name)
        if saved != now:
            raise Problem(
                f"{file}: {name}: expected {_shown(saved, now)} of the saved run, got {_shown(now, saved)}"
            )
    memory = [arrays[f"memory_{k}"] for k in range(sum(name.startswith("memory_") for name in arrays))]
    t = document["loop"]["t"]
    if not t < job.times.stop:
        raise Problem(
            f"{file}: expected a stop time after t = {t:.9g} s of the state, got {job.times.stop:.9g} s"
        )
    loop.restore(memory, document["loop"])
    for k, slave in enumerate(_fmus(loop)):
        first = f"fmu_{k}_"
        slave.resume({n.removeprefix(first): a for n, a in arrays.items() if n.startswith(first)})
    loop.resume()


def _fmus(loop: SimulationLoop) -> Iterator[RunningFmu]:
    return (slave for slave in loop.network.slaves.values() if isinstance(slave, RunningFmu))


def _read(file: Path) -> dict[str, Any]:
    """The arrays of a file within the limits of archives; raises Problem or what NumPy raises."""
    place = Location(require(file, (SUFFIX,)))
    with place.opened() as opened:
        if opened.read(DIGEST) != file_digest(opened, "sha256").digest():  # type: ignore[arg-type]
            raise ValueError
    with place.zip() as archive:
        parts = {m.filename.removesuffix(".npy"): archive.read(m) for m in archive.infolist()}
    arrays = {n: np.lib.format.read_array(BytesIO(p), allow_pickle=False) for n, p in parts.items()}
    if json.loads(bytes(arrays["document"]))["format"] != FORMAT:
        raise ValueError
    return arrays


def _shown(value: Any, other: Any) -> str:
    """A value in a message; of a long text the part that differs."""
    one, two = str(value), str(other)
    if len(one) <= SHOWN:
        return one
    k = next((k for k, (a, b) in enumerate(zip(one, two, strict=False)) if a != b), min(len(one), len(two)))
    return f"...{one[max(k - 20, 0) : k + SHOWN - 20]}..."
