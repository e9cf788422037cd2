"""The slave class of FMUs in Python.

The script of an FMU defines a subclass of `PythonSlave`. The library of the FMU (native/python_model.c) has
one object of it for all instances and calls the methods of the model by `call`; all else is done in C, as in
other FMUs. The library of PythonFMU has an object for each instance, which keeps the values; it checks none
of them, and holds the inputs over a step.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from pythonfmu import Fmi2Slave, Real
from pythonfmu.enums import Fmi2Status

from fmus.export.python.user_model import Array, UserModel, load, message
from orchestrator.base.errors import Problem
from orchestrator.base.xml import package_version

MODEL_FILE = "model.json"  # in resources/: name and file of the model, version, GUID
LONGEST = 500  # bytes of a message; the library has room for 512


class PythonSlave(Fmi2Slave):  # type: ignore[misc]
    """A model in Python; x states, u inputs, p parameters."""

    def __init__(self, *, instance_name: str, resources: str, logger: int = 0, visible: int = 0) -> None:
        """The arguments with which the library of PythonFMU calls it."""
        super().__init__(instance_name=instance_name, resources=resources, logger=logger, visible=visible)
        self.folder = Path(self.resources)
        self.built = json.loads((self.folder / MODEL_FILE).read_text(encoding="utf-8"))
        self._check_version()
        self.model = m = UserModel(load(self.folder / self.built["file"]))
        self.x, self.u, self.p = (values.copy() for values in m.start_values)
        self.time = 0.0
        groups = (m.interface.parameters, m.interface.inputs, m.interface.states)
        for values, group in zip((self.p, self.u, self.x), groups, strict=True):
            for i, v in enumerate(group):
                get, put = partial(values.__getitem__, i), partial(values.__setitem__, i)
                self.register_variable(Real(v.name, getter=get, setter=put))
        for i, v in enumerate(m.interface.outputs):
            self.register_variable(Real(v.name, getter=partial(self._output, i)))

    def _check_version(self) -> None:
        name, built, installed = self.built["name"], self.built["version"], package_version()
        if built != installed:
            raise Problem(
                f"{name}: built with harvester-cosim {built}, the one in {sys.prefix} is {installed}: "
                f"install {built}, or build the FMU again"
            )

    # ---- the library of the FMU

    def call(self, method: str, data: bytes) -> bytes | str:
        """The values that a method of the `UserModel` returns, or the reason why it failed.

        data   as doubles: states, inputs (their polynomials for "advance"), parameters, times
        """
        rows = 4 if method == "advance" else 1
        sizes = self.x.size, rows * self.u.size, self.p.size
        try:
            x, u, p, times = np.split(np.frombuffer(data), np.cumsum(sizes))
            inputs = u.reshape(rows, -1) if method == "advance" else u
            result: Array | tuple[Array, ...] = getattr(self.model, method)(x, inputs, p, *times.tolist())
            return (np.concatenate(result) if isinstance(result, tuple) else result).tobytes()
        except KeyboardInterrupt:
            raise
        except BaseException as problem:  # the library could not handle it
            return _text(problem, self.folder)

    # ---- the library of PythonFMU

    def _output(self, i: int) -> float:
        return float(self.model.observe(self.x, self.u, self.p, self.time)[0][i])

    def setup_experiment(self, start_time: float, *_: object) -> None:
        """Times in [s]."""
        self.time = start_time

    def exit_initialization_mode(self) -> None:
        """Compute the initial states."""
        self.x[:] = self.model.start(self.x, self.u, self.p)

    def do_step(self, current_time: float, step_size: float) -> bool:
        """A communication step [s]; logs a message and returns False if it failed."""
        try:
            self.x[:] = self.model.advance(self.x, self.u[None], self.p, current_time, step_size)
        except Exception as problem:
            self.log(message(problem, self.folder), Fmi2Status.error)
            return False
        self.time = current_time + step_size
        return True


def connect(slave: Callable[..., PythonSlave], folder: Path, guid: str) -> Any:
    """The slave for a library with this GUID, or the reason as text why there is none."""
    try:
        connected = slave(instance_name="", resources=str(folder))
        if guid != connected.built["guid"]:
            raise Problem(
                f'the GUID differs, expected "{connected.built["guid"]}" (files of different builds)'
            )
        return connected
    except KeyboardInterrupt:
        raise
    except BaseException as problem:
        return _text(problem, folder)


def _text(problem: BaseException, folder: Path) -> str:
    text = message(problem, folder).replace("\0", " ").encode("utf-8", "replace")
    return text[:LONGEST].decode("utf-8", "ignore")
