"""One FMU in FMPy's interface, FMI 2.0 or 3.0, Co-Simulation or Model Exchange, with variables by name."""

from __future__ import annotations

import shutil
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from fmpy import extract, fmi2, fmi3, read_model_description

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

    def start(self, time: float = 0.0, tolerance: float | None = None, **values: float) -> Fmu:
        """Initialise at a time with start values; Model Exchange goes on to continuous time."""
        self.set(**values)
        if self.version == 2:
            self.fmu.setupExperiment(startTime=time, tolerance=tolerance)
            self.fmu.enterInitializationMode()
        else:
            self.fmu.enterInitializationMode(startTime=time, tolerance=tolerance)
        self.fmu.exitInitializationMode()
        if self.kind == "me":
            _ = self.fmu.newDiscreteStates() if self.version == 2 else self.fmu.updateDiscreteStates()
            self.fmu.enterContinuousTimeMode()
        self.time = time
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

    def derivative(self, unknowns: Sequence[str], knowns: Sequence[str]) -> np.ndarray:
        """Jacobian (unknowns, knowns) by directional derivatives."""
        rows, columns = ([self.references[n] for n in names] for names in (unknowns, knowns))
        return np.array([self.fmu.getDirectionalDerivative(rows, [c], [1.0]) for c in columns]).T

    def errors(self) -> list[str]:
        """Texts that were logged as errors."""
        return [text for category, text in self.messages if category == "logStatusError"]

    def close(self) -> None:
        """Free the instance and what was unpacked."""
        self.fmu.freeInstance()
        if self._unpacked:
            shutil.rmtree(self._unpacked, ignore_errors=True)


@contextmanager
def driving(path: Path, kind: str = "cs", time: float = 0.0, **values: float) -> Iterator[Fmu]:
    """An initialised FMU, freed at the end."""
    fmu = Fmu(path, kind)
    try:
        yield fmu.start(time, **values)
        fmu.fmu.terminate()
    finally:
        fmu.close()
