"""`Machines`: many machines in lanes that are stepped with commands for each of them."""

from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Unpack

import numpy as np
from numpy.typing import ArrayLike, NDArray

from orchestrator.base.errors import Problem
from orchestrator.base.options import chosen
from orchestrator.base.processes import available_cores
from orchestrator.data.table import Array
from orchestrator.engine.arguments import MachinesArguments
from orchestrator.engine.job import Job
from orchestrator.engine.options import MachinesOptions, RunOptions, same
from orchestrator.lanes.batch import machine_values
from orchestrator.lanes.compiled import LANES
from orchestrator.lanes.group import Group, Lanes
from orchestrator.ssp.system import System

FOREVER = 1e6  # [s], stop time: steps of 1 ms are equal to 1e-7 until then


class Machines:
    """n machines of native FMUs, with commands that are held over each call of `advance`.

    system    the system of each machine
    count     number of machines
    step      communication step [s]
    commands, signals   names of the inputs that are set, and of the variables that are read
    """

    def __init__(
        self,
        system: System | str | Path,
        count: int,
        commands: Sequence[str],
        signals: Sequence[str],
        **options: Unpack[MachinesArguments],
    ) -> None:
        """Raises NotInLanes if the system has other than native FMUs, or the compiler is missing.

        commands   inputs, with names as the columns of a scenario
        signals    variables, `component.variable`
        options    those of `batch`, without a time span
        """
        if count < 1 or not commands or not signals:
            got = f"{count} machines, {len(commands)} commands and {len(signals)} signals"
            raise Problem(f"machines: expected at least one machine, command and signal, got {got}")
        held = {"time": [0.0, FOREVER], **{name: [0.0, 0.0] for name in commands}}
        given = chosen(MachinesOptions, options, "Machines")
        workers = given.workers
        asked = replace(same(RunOptions, given), record=tuple(signals), stop=FOREVER)
        self._job = Job.of(system, held, asked)
        self.system = self._job.system
        lanes = Lanes(self._job, [self._job.system.port(name) for name in signals])
        self.count, self.step = count, self._job.times.step
        self.commands, self.signals = tuple(commands), tuple(signals)
        self._rows = np.full((len(signals), count, 1), np.nan)
        self._groups = [Group(lanes) for _ in range(0, count, LANES)]
        self._fresh = Group(lanes)  # in it machines start before they replace others
        self._threads = ThreadPoolExecutor(max(1, min(workers or available_cores(), len(self._groups))))
        self._point = 0
        for group, first in zip(self._groups, range(0, count, LANES), strict=True):
            group.record(first, [*self._rows], count)
        self.start()

    def start(
        self, values: Mapping[str, ArrayLike] | None = None, machines: ArrayLike | None = None
    ) -> Array:
        """Start machines, with commands of zero; returns the signals of all, shape (n, signals).

        values     name -> parameter or start value of each machine, shape (n,), as in `batch`
        machines   which ones, shape (n,) of bool; default: all
        """
        given, _ = machine_values(self._job, values or {}, self.count)
        chosen = np.ones(self.count, np.bool_) if machines is None else np.asarray(machines, np.bool_)
        if chosen.shape != (self.count,):
            raise Problem(f"machines: expected the shape ({self.count},), got {chosen.shape}")
        if chosen.all():
            self._point = 0  # so that equal runs are equal to the last digit
        for k, group in enumerate(self._groups):
            lanes = self._lanes(k)
            if not chosen[lanes].any():
                continue
            whole = chosen[lanes].all()
            target = group if whole else self._fresh
            target.reset({port: array[lanes] for port, array in given.items()})
            target.command(np.zeros((len(self.commands), LANES)))
            target.begin()
            if whole:
                group.move(self._point)
            else:
                group.adopt(target, chosen[lanes])
        return self._read(self._point)

    def advance(self, commands: ArrayLike, steps: int = 1) -> Array:
        """Hold commands, shape (n, commands), for some steps; returns the signals, shape (n, signals).

        The signals of a machine that has failed are NaN.
        """
        table = np.asarray(commands, np.float64)
        if table.shape != (self.count, len(self.commands)):
            expected = f"({self.count}, {len(self.commands)})"
            raise Problem(f"commands: expected the shape {expected}, got {table.shape}")
        for k, group in enumerate(self._groups):
            group.command(table[self._lanes(k)].T)
        self._point += steps
        return self._read(self._point)

    def _lanes(self, group: int) -> NDArray[np.intp]:
        """The machine in each lane of a group; lanes in excess repeat the last one."""
        first = group * LANES
        return np.minimum(first + np.arange(LANES), self.count - 1)

    def _read(self, point: int) -> Array:
        """The signals at a communication point, to which all groups step."""
        list(self._threads.map(lambda group: group.advance(point), self._groups))
        return self._rows[:, :, 0].T.copy()

    @property
    def reasons(self) -> list[str]:
        """Why each machine has failed, or is not reliable since its start; empty if neither."""
        found = [group.doubted() for group in self._groups]
        places = (divmod(machine, LANES) for machine in range(self.count))
        return [found[k][lane].reason if lane in found[k] else "" for k, lane in places]

    def close(self) -> None:
        """End the threads."""
        self._threads.shutdown()
