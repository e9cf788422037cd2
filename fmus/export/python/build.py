"""Builds FMUs whose code is Python: the user's file, model.json, the library that calls it, documentation.

The library is that of FMUs with C code, with calls of Python in the place of equations and solver: see
docs/design.md, "The Python back end".
"""

import json
from collections.abc import Sequence
from importlib import resources
from pathlib import Path
from tempfile import TemporaryDirectory

from fmus.contract import Subsystem
from fmus.export.build import PLACEHOLDER, Files, common_files, guid_of
from fmus.export.c_code import main_source, sources, string
from fmus.export.compile import binaries, shared_library
from fmus.export.model_description import model_description
from fmus.export.python.checks import checked
from fmus.export.python.slave import MODEL_FILE
from fmus.export.python.user_model import UserModel, declared_files, in_file, refuse_neighbours, structure
from orchestrator.base.compiler import host
from orchestrator.base.errors import Problem
from orchestrator.base.files import write_zip
from orchestrator.base.xml import package_version

STEP, STOP = 1e-3, 10.0  # s, default experiment
SUBFOLDER = "python"  # folder of FMUs in Python, next to those with C code
RESERVED = (MODEL_FILE, "parameters.toml")  # names of files in resources/


def build_user(path: Path, folder: Path, platforms: Sequence[str] | None = None, fmi: int = 2) -> Path:
    """Write an FMU of the `Model` in a user's file to `folder`; returns its path.

    The FMU needs this package where it runs.

    platforms   names of `compile.PLATFORMS`; default: the platform that this program runs on
    fmi         2 or 3
    """
    try:
        refuse_neighbours(path)
        with TemporaryDirectory() as test_folder:  # contains only files that the FMU will contain
            copy = Path(test_folder).resolve() / path.name
            copy.write_bytes(path.read_bytes())
            files = {f"resources/{path.name}": path.read_bytes()} | _model_files(path, copy.parent)
            user = checked(copy, STEP)
        if [*user.model.files] != declared_files(path):
            raise Problem(
                f'{path.name}: files is not a plain list, expected one such as files = ("map.csv",)'
            )
        files |= common_files(_subsystem(user, path), user.interface, fmi, STEP, STOP)
        return _write(folder, user, path.name, files, fmi, platforms or (host(),))
    except Problem as problem:
        raise in_file(problem, path) from None


def _model_files(path: Path, test_folder: Path) -> dict[str, bytes]:
    """The files that the model reads, by path in the FMU; also copied to the folder of the test."""
    content = {}
    for name in declared_files(path):
        if Path(name).name != name or name in RESERVED or name == path.name:
            raise Problem(f"{path.name}: files: expected the name of a file in the same folder, got {name!r}")
        if not (path.parent / name).is_file():
            raise Problem(f"{path.name}: files: {name!r} is not in the same folder")
        content[f"resources/{name}"] = (path.parent / name).read_bytes()
        (test_folder / name).write_bytes(content[f"resources/{name}"])
    return content


def _subsystem(user: UserModel, path: Path) -> Subsystem:
    """A model as a `Subsystem` without equations, for its documentation."""
    model = user.model
    return Subsystem(
        name=user.interface.name,
        text=user.interface.description,
        parameters=model.Parameters,
        states=model.State,
        inputs=model.Inputs,
        outputs=model.Outputs,
        dynamics=model.require,  # not called, nor is observe
        observe=model.require,
        values=path.with_suffix(".toml"),
    )


def _write(
    folder: Path, user: UserModel, file: str, files: Files, fmi: int, platforms: Sequence[str]
) -> Path:
    """Write the FMU of a model to a folder; returns its path. `files`: further ones by path."""
    interface, name = user.interface, user.interface.name
    card = {"name": name, "version": package_version(), "guid": PLACEHOLDER, "file": file}
    description = model_description(interface, fmi, PLACEHOLDER, STEP, STOP, structure=structure(user))
    code = sources(interface, PLACEHOLDER, fmi, model=python_code())
    shown = {
        "modelDescription.xml": description.decode(),
        f"resources/{MODEL_FILE}": json.dumps(card, indent=1),
    }
    modules = {path: text.decode() for path, text in files.items() if path.endswith(".py")}
    guid = guid_of([shown, code, modules])
    encoded = {path: text.replace(PLACEHOLDER, guid).encode() for path, text in code.items()}
    libraries = {p: shared_library(name, encoded, [main_source(name)], p, ("-lm", "-ldl")) for p in platforms}
    content = {
        **{path: text.replace(PLACEHOLDER, guid).encode() for path, text in shown.items()},
        **files,
        **binaries(name, fmi, libraries),
    }
    path = Path(folder) / f"{name}.fmu"
    write_zip(path, content)
    return path


def python_code() -> dict[str, str]:
    """The C files of a model in Python by name; loader.h contains loader.py as a string."""
    folder = resources.files("fmus.export.python") / "native"
    code = {
        f.name: f.read_text(encoding="utf-8")
        for f in folder.iterdir()
        if f.name.endswith((".c", ".h", ".py"))
    }
    lines = code.pop("loader.py").splitlines()
    text = "\n".join(f"    {string(line + chr(10))}" for line in lines)
    code["loader.h"] = f"/* loader.py. Generated. */\n\nstatic const char LOADER[] =\n{text};\n"
    return code
