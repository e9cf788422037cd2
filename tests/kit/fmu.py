"""One FMU in FMPy's interface, FMI 2.0 or 3.0, Co-Simulation or Model Exchange, with variables by name."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from ctypes import c_double
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fmpy import extract, fmi2, fmi3, read_model_description
from fmpy.fmi1 import FMICallException

from kit.wait import LONG

CLASSES = {
    (2, "cs"): fmi2.FMU2Slave,
    (2, "me"): fmi2.FMU2Model,
    (3, "cs"): fmi3.FMU3Slave,
    (3, "me"): fmi3.FMU3Model,
}
STATUS = ("OK", "WARNING", "DISCARD", "ERROR", "FATAL", "PENDING")
KINDS = {"cs": "coSimulation", "me": "modelExchange"}


class Fmu:
    """An instance, not yet initialised.

    path       the archive, or a folder with its content
    kind       "cs" for Co-Simulation, "me" for Model Exchange
    token      GUID or instantiation token, where it is not that of the description
    options    of FMPy's instantiate

    fmu        FMPy's own object, for calls that have no method here
    messages   (category, text) of what it logged
    """

    def __init__(self, path: Path, kind: str = "cs", token: str | None = None, **options: Any) -> None:
        self.description = read_model_description(str(path), validate=False)
        self.version, self.kind, self.time = int(self.description.fmiVersion[0]), kind, 0.0
        self._unpacked = None if Path(path).is_dir() else extract(str(path))
        self.references = {v.name: v.valueReference for v in self.description.modelVariables}
        self.messages: list[tuple[str, str]] = []
        self.fmu: Any = CLASSES[self.version, kind](
            guid=token or self.description.guid,
            unzipDirectory=self._unpacked or str(path),
            modelIdentifier=getattr(self.description, KINDS[kind]).modelIdentifier,
            instanceName=Path(path).stem,
        )
        if self.version == 2:
            self._callbacks = fmi2.fmi2CallbackFunctions()
            self._callbacks.logger = fmi2.fmi2CallbackLoggerTYPE(self._log2)
            self.fmu.instantiate(callbacks=self._callbacks, **options)
        else:
            self.fmu.instantiate(logMessage=self._log3, **options)

    def _log2(self, _env: Any, _name: bytes, status: int, category: bytes, text: bytes) -> None:
        self._log3(None, status, category, text.replace(b"%%", b"%"))

    def _log3(self, _env: Any, status: int, category: bytes, text: bytes) -> None:
        self.messages.append((category.decode(), text.decode()))
        print(f"[{STATUS[status]}] {text.decode()}")  # as FMPy does: tests of faults at instantiation read it

    def enter(
        self, time: float = 0.0, tolerance: float | None = None, stop: float | None = None, **values: float
    ) -> Fmu:
        """Set start values and enter the initialisation mode."""
        self.set(**values)
        experiment = {"tolerance": tolerance, "startTime": time, "stopTime": stop}
        if self.version == 2:
            self.fmu.setupExperiment(**experiment)
            self.fmu.enterInitializationMode()
        else:
            self.fmu.enterInitializationMode(**experiment)
        self.time = time
        return self

    def initialise(self, time: float = 0.0, **more: Any) -> Fmu:
        """Initialise; Model Exchange is in event mode then."""
        self.enter(time, **more).fmu.exitInitializationMode()
        return self

    def start(self, time: float = 0.0, **more: Any) -> Fmu:
        """Initialise at a time with start values; Model Exchange goes on to continuous time."""
        self.initialise(time, **more)
        if self.kind == "me":
            self.update()
            self.fmu.enterContinuousTimeMode()
        return self

    def set(self, **values: float) -> Fmu:
        """Set variables by name."""
        if values:
            write = self.fmu.setReal if self.version == 2 else self.fmu.setFloat64
            write([self.references[n] for n in values], list(values.values()))
        return self

    def get(self, *names: str) -> np.ndarray:
        """Values of variables, shape (n,)."""
        read = self.fmu.getReal if self.version == 2 else self.fmu.getFloat64
        return np.array(read([self.references[n] for n in names]))

    def __getitem__(self, name: str) -> float:
        """The value of a variable."""
        return float(self.get(name)[0])

    def step(self, step: float, count: int = 1) -> Fmu:
        """Do `count` communication steps."""
        for _ in range(count):
            self.fmu.doStep(self.time, step)
            self.time += step
        return self

    def slopes(self, order: int = 1, **values: float) -> Fmu:
        """Set derivatives of inputs (FMI 2.0)."""
        references = [self.references[n] for n in values]
        self.fmu.setRealInputDerivatives(references, [order] * len(values), list(values.values()))
        return self

    def output_slopes(self, *names: str) -> list[float]:
        """First derivatives of outputs."""
        read = self.fmu.getRealOutputDerivatives if self.version == 2 else self.fmu.getOutputDerivatives
        return list(read([self.references[n] for n in names], [1] * len(names)))

    def derivative(self, unknowns: Sequence[str], knowns: Sequence[str]) -> np.ndarray:
        """Jacobian (unknowns, knowns) by directional derivatives."""
        rows, columns = ([self.references[n] for n in names] for names in (unknowns, knowns))
        return np.array([self.fmu.getDirectionalDerivative(rows, [c], [1.0]) for c in columns]).T

    def state(self) -> bytes:
        """The serialised state."""
        saved = self.fmu.getFMUState()
        data = bytes(self.fmu.serializeFMUState(saved))
        self.fmu.freeFMUState(saved)
        return data

    def restore(self, data: bytes, time: float | None = None) -> Fmu:
        """Go on from a serialised state, which was that of a time."""
        saved = (self.fmu.deSerializeFMUstate if self.version == 2 else self.fmu.deserializeFMUState)(data)
        self.fmu.setFMUState(saved)
        self.fmu.freeFMUState(saved)
        self.time = self.time if time is None else time
        return self

    # ---- Model Exchange

    def update(self) -> tuple[bool, bool, bool, bool, bool, float]:
        """Update discrete states: the fields of FMI's event information."""
        return self.fmu.newDiscreteStates() if self.version == 2 else self.fmu.updateDiscreteStates()

    def completed(self) -> bool:
        """The end of a solver's step: is an event asked for?"""
        return bool(self.fmu.completedIntegratorStep()[0])

    def continuous_states(self) -> list[float]:
        """The continuous states."""
        return self._vector(self.fmu.getContinuousStates)

    def set_continuous_states(self, *x: float) -> None:
        """Set them."""
        self.fmu.setContinuousStates((c_double * len(x))(*x), len(x))

    def derivatives(self) -> list[float]:
        """The derivatives of the continuous states."""
        old = self.version == 2
        return self._vector(self.fmu.getDerivatives if old else self.fmu.getContinuousStateDerivatives)

    def _vector(self, read: Callable[[Any, int], object]) -> list[float]:
        count = len(self.description.derivatives)
        found = (c_double * count)()
        read(found, count)
        return list(found)

    def errors(self) -> list[str]:
        """Texts that were logged as errors."""
        return self.logged("logStatusError")

    def logged(self, wanted: str) -> list[str]:
        """Texts of a category."""
        return [text for category, text in self.messages if category == wanted]

    def refuses(self, call: Callable[[], object], *words: str) -> None:
        """A call ends with the status of an error, whose message has all words."""
        with pytest.raises(FMICallException, match=r"status 3 \(error\)"):
            call()
        for word in words:
            assert word in self.errors()[-1]

    def close(self) -> None:
        """Free the instance and what was unpacked."""
        self.fmu.freeInstance()
        if self._unpacked:
            shutil.rmtree(self._unpacked, ignore_errors=True)


def in_new_process(code: str, *arguments: object, **environment: str) -> str:
    """Output of a Python program, which must succeed without a message; it can import what tests can."""
    command, folder = [sys.executable, "-c", code, *map(str, arguments)], Path(__file__).parents[1]
    environment, limit = {**os.environ, **environment}, {"timeout": 3 * LONG, "check": False}
    run = subprocess.run(command, capture_output=True, text=True, cwd=folder, env=environment, **limit)
    assert (run.returncode, run.stderr) == (0, "")
    return run.stdout


@contextmanager
def driving(path: Path, kind: str = "cs", time: float = 0.0, **values: float) -> Iterator[Fmu]:
    """An initialised FMU, freed at the end."""
    fmu = Fmu(path, kind)
    try:
        yield fmu.start(time, **values)
        fmu.fmu.terminate()
    finally:
        fmu.close()
