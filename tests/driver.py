"""Small drivers of single FMUs through FMPy, used by several tests."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from fmpy import extract, read_model_description
from fmpy.fmi2 import FMU2Model, FMU2Slave


class Driver:
    """One instance of an FMU 2.0, with variables by name."""

    def __init__(self, path: Path, kind: str = "cs") -> None:
        self.description = read_model_description(str(path))
        self.folder = extract(str(path))
        self.references = {v.name: v.valueReference for v in self.description.modelVariables}
        side, cls = (
            (self.description.coSimulation, FMU2Slave)
            if kind == "cs"
            else (self.description.modelExchange, FMU2Model)
        )
        self.fmu = cls(
            guid=self.description.guid,
            unzipDirectory=self.folder,
            modelIdentifier=side.modelIdentifier,
            instanceName=path.stem,
        )
        self.fmu.instantiate()
        self.kind, self.time = kind, 0.0

    def start(self, time: float = 0.0, **values: float) -> Driver:
        """Initialise at a time with start values."""
        self.fmu.setupExperiment(startTime=time)
        self.set(**values)
        self.fmu.enterInitializationMode()
        self.fmu.exitInitializationMode()
        if self.kind == "me":
            self.fmu.enterContinuousTimeMode()
        self.time = time
        return self

    def set(self, **values: float) -> None:
        """Set variables by name."""
        if values:
            self.fmu.setReal([self.references[n] for n in values], list(values.values()))

    def get(self, *names: str) -> np.ndarray:
        """Values of variables by name, shape (n,)."""
        return np.array(self.fmu.getReal([self.references[n] for n in names]))

    def step(self, step: float, count: int = 1) -> Driver:
        """Do `count` communication steps."""
        for _ in range(count):
            self.fmu.doStep(self.time, step)
            self.time += step
        return self

    def derivative(self, unknowns: list[str], knowns: list[str]) -> np.ndarray:
        """Jacobian (unknowns, knowns) by directional derivatives."""
        rows, columns = [self.references[n] for n in unknowns], [self.references[n] for n in knowns]
        return np.array([self.fmu.getDirectionalDerivative(rows, [c], [1.0]) for c in columns]).T


@contextmanager
def driving(path: Path, kind: str = "cs", time: float = 0.0, **values: float) -> Iterator[Driver]:
    """An initialised FMU, freed at the end."""
    driver = Driver(path, kind)
    try:
        yield driver.start(time, **values)
    finally:
        driver.fmu.terminate()
        driver.fmu.freeInstance()
        shutil.rmtree(driver.folder, ignore_errors=True)
