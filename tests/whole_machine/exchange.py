"""One FMU through Model Exchange and Co-Simulation of both versions, in FMPy, with the same moving inputs.

FMPy's own simulate_fmu holds inputs between output points in Model Exchange. Here they move inside the steps
of CVode.
"""

from __future__ import annotations

import shutil
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from fmpy import extract, instantiate_fmu, read_model_description
from fmpy.sundials import CVodeSolver

# begin and end [s] of a piece of time, and for each input c0, c1, c2 of c0 + c1 t + c2 t^2 from its begin on
Piece = tuple[float, float, Mapping[str, tuple[float, float, float]]]


class Instance:
    """An initialised FMU of either version, its variables by name."""

    def __init__(self, path: Path, kind: str, first: Piece, tolerance: float | None = None) -> None:
        self.description = read_model_description(str(path))
        self.folder = extract(str(path))
        self.fmu: Any = instantiate_fmu(self.folder, self.description, kind)
        self.new = self.description.fmiMajorVersion == 3
        self._read = self.fmu.getFloat64 if self.new else self.fmu.getReal
        self._write = self.fmu.setFloat64 if self.new else self.fmu.setReal
        variables = self.description.modelVariables
        self.outputs = [v.name for v in variables if v.causality == "output"]
        self._outputs = [v.valueReference for v in variables if v.causality == "output"]
        self._references = {v.name: v.valueReference for v in variables}
        self.begin(first)
        self.put(first[0])
        if self.new:
            self.fmu.enterInitializationMode(tolerance=tolerance, startTime=first[0])
        else:
            self.fmu.setupExperiment(tolerance=tolerance, startTime=first[0])
            self.fmu.enterInitializationMode()
        self.fmu.exitInitializationMode()

    def begin(self, piece: Piece) -> None:
        """From now on the inputs are those of this piece."""
        self._from = piece[0]
        self._inputs = [self._references[name] for name in piece[2]]
        self._terms = np.array(list(piece[2].values())).T

    def put(self, time: float) -> None:
        """Set all inputs to their value at `time`."""
        t = time - self._from
        self._write(self._inputs, self._terms[0] + t * (self._terms[1] + t * self._terms[2]))

    def look(self, time: float) -> list[float]:
        """The time and all outputs."""
        return [time, *self._read(self._outputs)]


@contextmanager
def instance(path: Path, kind: str, first: Piece, tolerance: float | None = None) -> Iterator[Instance]:
    """An instance, freed at the end."""
    made = Instance(path, kind, first, tolerance)
    try:
        yield made
    finally:
        made.fmu.terminate()
        made.fmu.freeInstance()
        shutil.rmtree(made.folder, ignore_errors=True)


def stepped(path: Path, pieces: Sequence[Piece], tolerance: float, step: float) -> dict[str, np.ndarray]:
    """Outputs at the end of each step by Co-Simulation, where the rate inputs move the others."""
    with instance(path, "CoSimulation", pieces[0], tolerance) as made:
        rows = []
        for piece in pieces:
            made.begin(piece)
            for t in grid(piece, step)[:-1]:
                made.put(t)
                made.fmu.doStep(t, step)
                rows.append(made.look(t + step))
    return columns(made, rows)


def integrated(path: Path, pieces: Sequence[Piece], tolerance: float, step: float) -> dict[str, np.ndarray]:
    """The same by Model Exchange and CVode (BDF), which starts anew at each piece."""
    with instance(path, "ModelExchange", pieces[0]) as made:
        fmu = made.fmu
        _ = fmu.updateDiscreteStates() if made.new else fmu.newDiscreteStates()
        fmu.enterContinuousTimeMode()

        def set_time(t: float) -> None:
            fmu.setTime(t)
            made.put(t)

        solver = CVodeSolver(
            nx=made.description.numberOfContinuousStates,
            nz=0,
            get_x=fmu.getContinuousStates,
            set_x=fmu.setContinuousStates,
            get_dx=fmu.getContinuousStateDerivatives if made.new else fmu.getDerivatives,
            get_z=None,
            get_nominals=fmu.getNominalsOfContinuousStates,
            set_time=set_time,
            input=None,
            startTime=pieces[0][0],
            relativeTolerance=tolerance,
            maxNumSteps=10**6,
        )
        rows = []
        for piece in pieces:
            made.begin(piece)
            solver.reset(piece[0])
            for t, after in zip(grid(piece, step), grid(piece, step)[1:], strict=False):
                solver.step(t, after)
                set_time(after)
                rows.append(made.look(after))
    return columns(made, rows)


def grid(piece: Piece, step: float) -> np.ndarray:
    """Times from begin to end of a piece, which is a number of steps."""
    begin, end, _ = piece
    return begin + step * np.arange(round((end - begin) / step) + 1)


def columns(made: Instance, rows: list[list[float]]) -> dict[str, np.ndarray]:
    """Time and outputs by name."""
    return dict(zip(("time", *made.outputs), np.array(rows).T, strict=True))
