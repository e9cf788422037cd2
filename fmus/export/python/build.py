"""Builds FMUs whose code is Python: a script and its numbers, a library that calls it, and what people read.

The library is ours, not PythonFMU's: see docs/design.md, "The Python back end".
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from importlib.resources import files
from pathlib import Path
from tempfile import TemporaryDirectory

from fmus.contract import ModelError, Subsystem
from fmus.export.codegen import string
from fmus.export.compile import shared_library
from fmus.export.interface import Interface, interface
from fmus.export.model_description import COSIMULATION, FLAGS, Unknowns, described, package_version, unknowns
from fmus.export.package import PLACEHOLDER, fingerprint_of, pack, shown
from fmus.export.platforms import binaries, host
from fmus.export.proof import proof
from fmus.export.python.model import Model
from fmus.export.python.origin import fingerprint, origin, subsystem
from fmus.export.python.scripts import script
from fmus.export.python.slave import CARD
from fmus.export.python.trials import tried
from fmus.export.python.user import declared_files, refuse_neighbours, structure
from fmus.parameters import Values, values

MAIN = "python_fmu.c"
PYTHON = "python"  # folder of FMUs in Python, beside the native ones
RESERVED = (CARD, "slavemodule.txt", "parameters.toml")


def build_model(model: str, folder: Path, platforms: Sequence[str]) -> Path:
    """The FMU of a user's file, or of a subsystem by its origin: what a command line is given.

    It goes to a folder of its own, where none of the same name is overwritten.
    """
    folder = folder / PYTHON
    if model.endswith(".py"):
        return build_user(Path(model), folder, platforms=platforms)
    return build_python(subsystem(model), folder, platforms=platforms, where=model)


def build_python(
    sub: Subsystem,
    folder: Path,
    step: float = 1e-3,
    stop: float = 10.0,
    numbers: Values | None = None,
    platforms: Sequence[str] | None = None,
    where: str | None = None,
) -> Path:
    """Write `<sub.name>.fmu` to `folder` and return its path. It needs this package on the target.

    step, stop   default experiment [s]
    numbers      parameters and start values; by default those of the subsystem's parameters.toml
    platforms    names of `platforms.PLATFORMS`; by default the one this runs on
    where        "module:NAME" by which the FMU finds the subsystem; by default what `origin` finds
    """
    given, found = numbers or values(sub), where or origin(sub)
    face = interface(sub, given)
    card = {"origin": found, "fingerprint": fingerprint(face), "numbers": asdict(given)}
    flags = FLAGS | COSIMULATION | {"needsExecutionTool": "true"}
    more = shown(sub, face, 2, step, stop) | proof(sub)
    return write(folder, face, card, "SubsystemSlave", flags, unknowns(face), step, stop, more, platforms)


def build_user(
    path: Path,
    folder: Path,
    step: float = 1e-3,
    stop: float = 10.0,
    platforms: Sequence[str] | None = None,
) -> Path:
    """Write an FMU of the `Model` in a user's file to `folder` and return its path; arguments as above."""
    refuse_neighbours(path)
    with TemporaryDirectory() as room:  # with what will be in the FMU, and nothing else
        copy = Path(room).resolve() / path.name
        copy.write_bytes(path.read_bytes())
        more = {f"resources/{path.name}": path.read_bytes()} | _files(path, copy.parent)
        model, face = tried(copy, step)
    if [*model.files] != declared_files(path):
        raise ModelError(f'{path.name}: files is no plain list, expected one such as files = ("map.csv",)')
    more |= shown(_surrogate(model, face, path), face, 2, step, stop)
    flags = FLAGS | COSIMULATION | {"needsExecutionTool": "true"} | _NO_DERIVATIVES
    card = {"file": path.name}
    return write(folder, face, card, "UserSlave", flags, structure(model, face), step, stop, more, platforms)


_NO_DERIVATIVES = {"providesDirectionalDerivative": "false", "maxOutputDerivativeOrder": "0"}


def _files(path: Path, room: Path) -> dict[str, bytes]:
    """What else the model reads, by path in the FMU; copied to `room`, where it is tried."""
    found = {}
    for name in declared_files(path):
        if Path(name).name != name or name in RESERVED or name == path.name:
            raise ModelError(f"{path.name}: files names {name!r}, expected the name of a file beside it")
        if not (path.parent / name).is_file():
            raise ModelError(f"{path.name}: files names {name!r}, which is not beside it")
        found[f"resources/{name}"] = (path.parent / name).read_bytes()
        (room / name).write_bytes(found[f"resources/{name}"])
    return found


def _surrogate(model: Model, face: Interface, path: Path) -> Subsystem:
    """What the documentation wants to know of a model: its variables and where its README may be."""
    return Subsystem(
        name=face.name,
        text=face.text,
        parameters=model.Parameters,
        states=model.State,
        inputs=model.Inputs,
        outputs=model.Outputs,
        dynamics=model.require,  # nobody calls these two
        observe=model.require,
        values=path.with_suffix(".toml"),
    )


def write(
    folder: Path,
    face: Interface,
    card: Mapping[str, object],
    slave: str,
    flags: Mapping[str, str],
    structure: Unknowns,
    step: float,
    stop: float,
    more: Mapping[str, bytes],
    platforms: Sequence[str] | None,
) -> Path:
    """Put an FMU together.

    card         what the slave has to know
    slave        the class in `slave` that runs it
    flags        of the co-simulation
    structure    unknowns and what they depend on
    more         further files by path
    """
    about = {"name": face.name, "version": package_version(), "guid": PLACEHOLDER, **card}
    drafts = {
        "modelDescription.xml": described(
            face, PLACEHOLDER, {"CoSimulation": flags}, [], step, stop, structure
        ).decode(),
        f"resources/{CARD}": json.dumps(about, indent=1),
        "resources/script": script(face.name, face.text, slave, ""),
        **{f"library/{name}": text.decode() for name, text in library_code().items()},
        **{path: text.decode() for path, text in more.items() if path.endswith(".py")},
    }
    guid = fingerprint_of([drafts])
    stem = f"slave_{face.name}_{guid[1:9]}"
    content = {
        "modelDescription.xml": drafts["modelDescription.xml"].replace(PLACEHOLDER, guid).encode(),
        f"resources/{CARD}": drafts[f"resources/{CARD}"].replace(PLACEHOLDER, guid).encode(),
        "resources/slavemodule.txt": stem.encode(),
        f"resources/{stem}.py": script(face.name, face.text, slave, package_version()).encode(),
        **more,
        **binaries(face.name, 2, {name: library(name) for name in platforms or (host(),)}),
    }
    path = Path(folder) / f"{face.name}.fmu"
    pack(path, content)
    return path


def library_code() -> dict[str, bytes]:
    """The C files of the library by name; start.py becomes a string in start.h."""
    folder = files("fmus.export.python") / "native"
    code = {
        f.name: f.read_text(encoding="utf-8")
        for f in folder.iterdir()
        if f.name.endswith((".c", ".h", ".py"))
    }
    lines = code.pop("start.py").splitlines()
    text = "\n".join(f"    {string(line + chr(10))}" for line in lines)
    code["start.h"] = f"/* start.py. Generated. */\n\nstatic const char START[] =\n{text};\n"
    return {name: text.encode() for name, text in sorted(code.items())}


def library(platform: str) -> bytes:
    """The library for a platform, the same for all models."""
    return shared_library("python_fmu", library_code(), [MAIN], platform, ("-ldl",))
