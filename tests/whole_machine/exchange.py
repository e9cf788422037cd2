"""One FMU through Model Exchange and Co-Simulation of both versions, in FMPy, with the same moving inputs.

FMPy's own simulate_fmu holds inputs between output points in Model Exchange. Here they move inside the steps
of CVode.
"""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from fmpy.sundials import CVodeSolver
from kit.fmu import Fmu

# begin and end [s] of a piece of time, and for each input c0, c1, c2 of c0 + c1 t + c2 t^2 from its begin on
Piece = tuple[float, float, Mapping[str, tuple[float, float, float]]]


class Moved(Fmu):
    """An initialised FMU, its inputs on a piece of time."""

    def __init__(self, path: Path, kind: str, first: Piece, tolerance: float | None = None) -> None:
        super().__init__(path, kind)
        self.outputs = [v.name for v in self.description.modelVariables if v.causality == "output"]
        self.begin(first)
        self.put(first[0])
        self.initialise(first[0], tolerance=tolerance)

    def begin(self, piece: Piece) -> None:
        """From now on the inputs are those of this piece."""
        self._from, self._inputs = piece[0], list(piece[2])
        self._terms = np.array(list(piece[2].values())).T

    def put(self, time: float) -> None:
        """Set all inputs to their value at `time`."""
        t = time - self._from
        values = self._terms[0] + t * (self._terms[1] + t * self._terms[2])
        self.set(**dict(zip(self._inputs, values, strict=True)))

    def look(self, time: float) -> list[float]:
        """The time and all outputs."""
        return [time, *self.get(*self.outputs)]


@contextmanager
def instance(path: Path, kind: str, first: Piece, tolerance: float | None = None) -> Iterator[Moved]:
    """An instance, freed at the end."""
    made = Moved(path, kind, first, tolerance)
    try:
        yield made
        made.fmu.terminate()
    finally:
        made.close()


def stepped(path: Path, pieces: Sequence[Piece], tolerance: float, step: float) -> dict[str, np.ndarray]:
    """Outputs at the end of each step by Co-Simulation, where the rate inputs move the others."""
    with instance(path, "cs", pieces[0], tolerance) as made:
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
    with instance(path, "me", pieces[0]) as made:
        fmu = made.fmu
        made.update()
        fmu.enterContinuousTimeMode()

        def set_time(t: float) -> None:
            fmu.setTime(t)
            made.put(t)

        solver = CVodeSolver(
            nx=made.description.numberOfContinuousStates,
            nz=0,
            get_x=fmu.getContinuousStates,
            set_x=fmu.setContinuousStates,
            get_dx=fmu.getContinuousStateDerivatives if made.version == 3 else fmu.getDerivatives,
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


def columns(made: Moved, rows: list[list[float]]) -> dict[str, np.ndarray]:
    """Time and outputs by name."""
    return dict(zip(("time", *made.outputs), np.array(rows).T, strict=True))
