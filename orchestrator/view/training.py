"""The training task of a machine that all pages show: the current attempt, and a table of the finished ones.

The server calls `update` a few times a second, and sends `status`, which is plain data. The score of an
attempt equals that of `score.score` for the same samples. A page with a machine of its own scores by task.js.
"""

from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orchestrator.base.errors import Problem
from orchestrator.base.files import write_rows
from orchestrator.drive import score
from orchestrator.drive.score import Exercise, Progress, Samples, Task
from orchestrator.realtime.setup import Machine


class Training:
    """The task of one machine, shared by all pages.

    table   the attempts that are over: done, given up by `again`, or ended by a restart; one row each
    """

    def __init__(self, machine: Machine, declared: Callable[[], Task]) -> None:
        """declared: the task of the current machine."""
        self.task, self.table = declared(), list[dict[str, Any]]()
        self._machine, self._declared, self._source = machine, declared, _source(machine)
        self._number, self._open, self._loaded = -1, 0, False
        self._clear(self.task.exercises[0])

    def open(self) -> None:
        """A page shows the task. The first page begins an attempt."""
        self._open += 1
        if self._open == 1:
            self._fit()
            self._number = self._machine.latest().number

    def close(self) -> None:
        """A page hides the task. While no page shows it, nothing is recorded."""
        self._open = max(0, self._open - 1)
        self._loaded &= self.shown

    @property
    def shown(self) -> bool:
        """Does a page show the task?"""
        return self._open > 0

    def choose(self, name: str) -> None:
        """Begin another exercise, if there is one of this name."""
        exercise = self.task.exercise(name)
        if exercise is not None and exercise != self._progress.exercise:
            self.again(exercise)

    def again(self, exercise: Exercise | None = None) -> None:
        """Begin a new attempt, at another exercise if one is given. A started one is kept as unfinished."""
        self._keep()
        self._clear(exercise or self._progress.exercise)

    def update(self) -> None:
        """Add the frames since the last call."""
        if self._source != _source(self._machine):  # another machine, with other frame numbers
            self._keep()
            self._fit()
            self._number = -1
        numbers, times, _, values = self._machine.since(self._number)
        if not len(numbers):
            return
        self._number = int(numbers[-1])
        for part in np.split(np.arange(len(times)), np.flatnonzero(np.diff(times) < 0) + 1):
            if self._samples and times[part[0]] < self._samples[-1].time[-1]:  # restarted
                self.again()
            self._add(times[part], values[part])

    def status(self) -> dict[str, Any]:
        """State of the current attempt, without the score, which is computed at its end."""
        tip, progress = self._tip, self._progress
        exercise, target, inside = progress.exercise, progress.target, progress.inside
        return {
            "exercise": exercise.name,
            "phase": progress.phase,
            "target": asdict(target) if target else None,
            "radius": exercise.radius,
            "done": len(progress.done),
            "way": score.way(tip, target.at) if tip and target else None,
            "held": 0.0 if inside is None else (progress.now - inside) / exercise.hold,
            "time": progress.clock,
            "load": progress.load,
            "problem": self._problem,
            "table": self.table,
        }

    def loads(self) -> dict[str, float]:
        """Input -> its value: the load of the task, and none from its end on."""
        load = self._progress.load if self._open else 0.0
        self._loaded |= load > 0
        return {self.task.load: load} if self.task.load and self._loaded else {}

    def write(self, path: Path) -> Path:
        """Write the table as CSV."""
        if not self.table:
            raise Problem(f"{path}: expected a finished attempt, found none")
        return write_rows(path, [[*self.table[0]], *(row.values() for row in self.table)])

    def _fit(self) -> None:
        """Begin an attempt at the task of the machine that is shown now."""
        self._source, self.task = _source(self._machine), self._declared()
        self._clear(self.task.exercise(self._progress.exercise.name) or self.task.exercises[0])

    def _clear(self, exercise: Exercise) -> None:
        self._progress = Progress(exercise)
        self._samples: list[Samples] = []
        self._tip: tuple[float, float, float] | None = None
        self._problem = ""
        self._kept = False

    def _add(self, times: NDArray[np.float64], values: NDArray[np.float64]) -> None:
        if self._kept:
            return
        try:
            part = score.of_values(times, dict(zip(self._machine.signals, values.T, strict=True)), self.task)
        except Problem as error:
            self._problem = str(error)
            return
        if self._progress.started is None:  # samples before the start are not needed; a pause may be long
            self._samples = []
        self._samples.append(part)
        self._tip = part.tips[-1]
        self._progress = self._progress.follow(part)
        if self._progress.phase == "done":
            self._keep()
        elif self._progress.started is not None and times[-1] - self._progress.started > score.LONGEST:
            self.again()

    def _keep(self) -> None:
        if self._progress.started is not None and not self._kept:
            result = score.judge(Samples.joined(self._samples), self._progress)
            assert result is not None  # the clock has started
            numbered = {"attempt": len(self.table) + 1, "exercise": self._progress.exercise.name}
            self.table.append(numbered | asdict(result))
        self._kept = True


def _source(machine: Machine) -> int:
    """Number of exchanges of the machine."""
    return int(getattr(machine, "exchanges", 0))
