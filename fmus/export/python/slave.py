"""The object of Python behind the library of an FMU in Python (native/python_model.c).

All instances share it: the library calls the methods of the model by `call`; all else is done in C, as in
other FMUs.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from fmus.export.python.user_model import Array, UserModel, load, message
from orchestrator.base.errors import Problem
from orchestrator.base.xml import package_version

MODEL_FILE = "model.json"  # in resources/: name and file of the model, version, GUID
LONGEST = 500  # bytes of a message; the library has room for 512


class PythonSlave:
    """A model in Python.

    folder   resources/ of the FMU
    built    the content of `MODEL_FILE`
    guid     of the library
    """

    def __init__(self, folder: Path, built: Mapping[str, str], guid: str) -> None:
        if (version := built["version"]) != (installed := package_version()):
            raise Problem(
                f"{built['name']}: built with harvester-cosim {version}, the one in {sys.prefix} is"
                f" {installed}: install {version}, or build the FMU again"
            )
        self.folder, self.model = folder, UserModel(load(folder / built["file"]))
        if guid != built["guid"]:
            raise Problem(f'the GUID differs, expected "{built["guid"]}" (files of different builds)')

    def call(self, method: str, data: bytes) -> bytes | str:
        """The values that a method of the `UserModel` returns, or the reason why it failed.

        data   as doubles: states, inputs (their polynomials for "advance"), parameters, times
        """
        rows = 4 if method == "advance" else 1
        x, u, p = (values.size for values in self.model.start_values)
        try:
            states, inputs, parameters, times = np.split(np.frombuffer(data), np.cumsum((x, rows * u, p)))
            inputs = inputs.reshape(rows, -1) if method == "advance" else inputs
            arguments = (states, inputs, parameters, *times.tolist())
            result: Array | tuple[Array, ...] = getattr(self.model, method)(*arguments)
            return (np.concatenate(result) if isinstance(result, tuple) else result).tobytes()
        except KeyboardInterrupt:
            raise
        except BaseException as problem:  # the library could not handle it
            return _text(problem, self.folder)


def connect(folder: Path, built: Mapping[str, str], guid: str) -> PythonSlave | str:
    """The slave for a library with this GUID, or the reason as text why there is none."""
    try:
        return PythonSlave(folder, built, guid)
    except KeyboardInterrupt:
        raise
    except BaseException as problem:
        return _text(problem, folder)


def _text(problem: BaseException, folder: Path) -> str:
    text = message(problem, folder).replace("\0", " ").encode("utf-8", "replace")
    return text[:LONGEST].decode("utf-8", "ignore")
