"""The session that all pages show: a live machine, which can be started anew and saved."""

import math
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from orchestrator.base.errors import Problem
from orchestrator.data.trace import read_trace
from orchestrator.data.trace_writer import write_trace
from orchestrator.drive.page import replay_data
from orchestrator.drive.view_description import by_bare_name
from orchestrator.realtime.machine import RealTimeMachine
from orchestrator.realtime.setup import Setup
from orchestrator.view.choice import MachineChoice, ViewPlan, plan
from orchestrator.view.result_files import columns_of, find_result, list_results


def drive_of(session: Path) -> Path:
    """The scenario of a saved session."""
    return session.with_name(f"drive{session.stem.removeprefix('session')}.csv")


def columns(machine: RealTimeMachine) -> Mapping[str, int]:
    """Bare name of a signal or an axis -> its column in a table of axes, then signals; an axis goes first."""
    axes, signals = list(machine.axes), list(machine.signals)
    places = {bare: len(axes) + signals.index(full) for bare, full in by_bare_name(signals).items()}
    return places | {bare: axes.index(full) for bare, full in by_bare_name(axes).items()}


class Session:
    """The machine that all pages show.

    plan      the latest choice
    machine   the live machine
    columns   bare name -> column in its frames, see `columns`
    starts    number of its starts; frames before and after a start are not related
    factor    the speed that was set last
    file      what a page replays that names no file
    """

    def __init__(
        self,
        first: MachineChoice,
        folders: Sequence[Path] = (),
        simulate: Callable[[Setup], RealTimeMachine] = RealTimeMachine,
        file: Path | None = None,
    ) -> None:
        """folders: of result files, the first also for saving; simulate: starts the machine."""
        self.folders, self.file = tuple(folders), file
        self.plan: ViewPlan = plan(first)
        self.machine = simulate(self.plan.setup)
        self.starts, self.factor, self.columns = 0, 1.0, columns(self.machine)

    @property
    def title(self) -> str:
        """System, pose and variants."""
        choice = self.plan.choice
        swaps = [f"{part} {variant}" for part, variant in choice.swap.items()]
        sets = [f"{name}={value}" for name, value in choice.set.items()]
        return ", ".join([choice.system.name, *([choice.pose] if choice.pose else []), *swaps, *sets])

    def start(self, choice: MachineChoice) -> None:
        """Start the machine with this choice."""
        new = plan(choice)
        self.machine.restart(new.setup)
        self.plan = new
        self.starts, self.columns = self.starts + 1, columns(self.machine)
        self.machine.play()

    def again(self) -> None:
        """Start the machine again."""
        self.machine.restart()
        self.starts += 1
        self.machine.play()

    def speed(self, factor: float) -> None:
        """Set the speed relative to real time."""
        self.machine.speed(factor)
        self.factor = factor

    @property
    def _required(self) -> tuple[set[str], int]:
        """Names of which a result file must have so many: a value of a joint; without a drawing half of the
        shown signals, so that a run of another machine with some equal names is none of this one."""
        if scene := self.plan.description.scene:
            return set(scene.signals), 1
        shown = set(by_bare_name(self.plan.setup.signals))
        return shown, max(1, math.ceil(len(shown) / 2))

    def _fits(self, names: Iterable[str]) -> bool:
        required, least = self._required
        return len(required & set(names)) >= least

    def files(self) -> list[str]:
        """Names of the result files in the open folders that can be replayed."""
        results = list_results(self.folders)
        return [name for name, path in results.items() if self._fits(by_bare_name(columns_of(path)))]

    def recording(self, name: str) -> dict[str, Any]:
        """What a page needs to replay a result file of the open folders; without a name that of `file`."""
        path = find_result(name, self.folders) if name or self.file is None else self.file
        trace = read_trace(path)
        if not len(trace.time):
            raise Problem(f"{path}: expected samples, found none")
        if not self._fits(by_bare_name(trace.signals)):
            (required, least), full = self._required, by_bare_name(self.plan.setup.signals)
            example = next((full[name] for name in full if name in required), "component.output")
            found = ", ".join(list(trace.signals)[:4]) or "none"
            many = f"{least} or more " if least > 1 else ""
            raise Problem(f"{path}: expected {many}signals such as {example}, found {found}")
        return replay_data(self.plan.description, self.plan.parameters, trace, f"Replay: {path.name}")

    def save(self) -> Path:
        """Save the session as a result file in the first folder.

        What was driven is beside it, as a scenario (`drive_of`), unless its beginning is no longer in memory.
        """
        if not self.folders:
            raise Problem("save: no folder for results is open")
        trace = self.machine.trace()
        if not len(trace.time):
            raise Problem("save: nothing has been recorded yet")
        stamp = time.strftime("%Y%m%d-%H%M%S")
        path = write_trace(trace, self.folders[0] / f"session-{stamp}.parquet")
        if self.machine.axes and trace.time[0] <= self.plan.begin + 1e-9:  # rounding
            write_trace(trace.select(self.machine.axes), drive_of(path))
        return path

    def repeated(self, saved: Path) -> str:
        """How to repeat a saved session."""
        drive = drive_of(saved)
        if drive.is_file():
            return f"the same drive: {self.plan.choice.command(str(drive))}"
        return "its beginning is no longer in memory, so it cannot be repeated"

    def close(self) -> None:
        """Close the machine."""
        self.machine.close()
