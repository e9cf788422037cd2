"""What all pages show, a running machine or a replayed file: started, exchanged and saved."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from orchestrator.base.errors import Problem
from orchestrator.data.trace import Trace, read, write
from orchestrator.realtime.setup import Array, Frame, Machine, Setup
from orchestrator.view.choice import MachineChoice, ViewPlan, plan
from orchestrator.view.result_files import columns_of, find_result, list_results
from orchestrator.view.view_description import SignalIndex, by_bare_name


class ExchangeableMachine:
    """A `Machine` that forwards everything to another one, which may be exchanged.

    factor      the speed that was asked for last, of whichever machine
    exchanges   counts the exchanges: frames of before have nothing to do with those of after
    """

    def __init__(self, machine: Machine) -> None:
        self.machine = machine
        self.exchanges, self.factor = 0, 1.0

    def exchange(self, machine: Machine) -> None:
        """Show another machine from now on; the one before stands still."""
        if self.machine.drives:
            self.machine.command({})
        self.machine.pause()
        machine.speed(self.factor)
        self.machine = machine
        self.exchanges += 1

    @property
    def axes(self) -> Sequence[str]:
        return self.machine.axes

    @property
    def signals(self) -> Sequence[str]:
        return self.machine.signals

    @property
    def units(self) -> Mapping[str, str]:
        return self.machine.units

    @property
    def drives(self) -> bool:
        return self.machine.drives

    def command(self, values: Mapping[str, float]) -> None:
        self.machine.command(values)

    def play(self) -> None:
        self.machine.play()

    def pause(self) -> None:
        self.machine.pause()

    def speed(self, factor: float) -> None:
        self.machine.speed(factor)
        self.factor = factor

    def restart(self, setup: Setup | None = None) -> None:
        self.machine.restart(setup)
        self.exchanges += 1

    def latest(self) -> Frame:
        return self.machine.latest()

    def since(self, number: int) -> tuple[NDArray[np.int64], Array, Array, Array]:
        return self.machine.since(number)

    def trace(self) -> Trace:
        return self.machine.trace()

    def close(self) -> None:
        self.machine.close()


class SeekableMachine(Machine, Protocol):
    """A machine that can go to any time of its file."""

    def seek(self, t: float) -> None: ...


Simulate = Callable[[Setup], Machine]
Replayed = Callable[[Trace], SeekableMachine]


class Session:
    """The machine that all pages show.

    plan      what was chosen last
    machine   live, or a replay
    index   of its frames
    title     what is shown, in words
    span      times of the file that is replayed: first, last [s]; None for a live machine
    """

    def __init__(
        self, first: MachineChoice, simulate: Simulate, replay: Replayed, folders: Sequence[Path] = ()
    ) -> None:
        """simulate, replay: make machines; folders: with result files, the first one also to write to."""
        self._replay, self.folders = replay, tuple(folders)
        self.plan: ViewPlan = plan(first)
        self._live = simulate(self.plan.setup)
        self.machine = ExchangeableMachine(self._live)
        self.file = ""
        self._recording: SeekableMachine | None = None
        self.span: tuple[float, float] | None = None
        self._read()

    @property
    def title(self) -> str:
        """System, pose and variants, or the file that is replayed."""
        if self.file:
            return f"Replay: {self.file}"
        choice = self.plan.choice
        swaps = [f"{part} {variant}" for part, variant in choice.swap.items()]
        sets = [f"{name}={value}" for name, value in choice.set.items()]
        return ", ".join([choice.system.name, *([choice.pose] if choice.pose else []), *swaps, *sets])

    @property
    def replaying(self) -> bool:
        """Is it a file that is shown?"""
        return bool(self.file)

    def start(self, choice: MachineChoice) -> None:
        """The live machine from the beginning, with this choice."""
        wanted = plan(choice)
        self._live.restart(wanted.setup)
        self.plan = wanted
        self._show(self._live, "")
        self._live.play()

    def again(self) -> None:
        """From the beginning, what is shown now."""
        self.machine.restart()
        self.machine.play()

    @property
    def _telling(self) -> set[str]:
        """Signals of which a result file has to have one: joint angles, or any without a drawing."""
        description = self.plan.description
        return set(description.scene.joints if description.scene else description.shown)

    @property
    def _example(self) -> str:
        """The full name of one of them."""
        full = by_bare_name(self.plan.setup.signals)
        return next((full[name] for name in full if name in self._telling), "component.output")

    def files(self) -> list[str]:
        """The result files of the allowed folders that can be replayed."""
        found = ((name, find_result(name, self.folders)) for name in list_results(self.folders))
        return [name for name, path in found if self._telling & set(by_bare_name(columns_of(path)))]

    def replay(self, name: str) -> None:
        """A result file of the allowed folders in place of the machine, which stands still meanwhile."""
        self.replay_file(find_result(name, self.folders), name)

    def replay_file(self, path: Path, name: str = "") -> None:
        """A result file wherever it lies: only for names that do not come from a page."""
        trace = read(path)
        if not len(trace.time):
            raise Problem(f"{path}: expected samples, found none")
        recording = self._replay(trace)
        found = SignalIndex(recording)
        if not any(found.knows(name) for name in self._telling):
            raise Problem(
                f"{path}: expected signals such as {self._example}, found"
                f" {', '.join(list(trace.signals)[:4]) or 'none'}"
            )
        self._show(recording, name or path.name)
        self._recording, self.span = recording, (float(trace.time[0]), float(trace.time[-1]))
        self.machine.play()

    def seek(self, t: float) -> None:
        """Another time of the file that is replayed [s]."""
        if self._recording is not None and math.isfinite(t):
            self._recording.seek(t)
            self.machine.exchanges += 1  # what was drawn has nothing to do with what follows

    def back(self) -> None:
        """From a replay to the live machine, which stands where it stood."""
        if self.file:
            self.machine.machine.close()
            self._show(self._live, "")

    def save(self) -> Path:
        """The session so far, as a result file in the first folder."""
        if not self.folders:
            raise Problem("save: no folder for results is open")
        stamp = time.strftime("%Y%m%d-%H%M%S")
        return write(self.whole(), self.folders[0] / f"session-{stamp}.parquet")

    def whole(self) -> Trace:
        """The trace of the session, from zero."""
        trace = self.machine.trace()
        if not len(trace.time):
            raise Problem("save: nothing has been recorded yet")
        return trace

    def close(self) -> None:
        """End everything."""
        self.machine.close()
        self._live.close()

    def _show(self, machine: Machine, file: str) -> None:
        self.machine.exchange(machine)
        self.file, self._recording, self.span = file, None, None
        self._read()

    def _read(self) -> None:
        self.index = SignalIndex(self.machine)
