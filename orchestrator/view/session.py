"""The session that all pages show: a live machine or a replayed file, which can be exchanged and saved."""

import math
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from orchestrator.base.errors import Problem
from orchestrator.data.table import Array
from orchestrator.data.trace import read_trace
from orchestrator.data.trace_writer import write_trace
from orchestrator.drive.view_description import by_bare_name
from orchestrator.realtime.machine import RealTimeMachine
from orchestrator.realtime.replay import Replay
from orchestrator.realtime.setup import Machine, Setup
from orchestrator.view.choice import MachineChoice, ViewPlan, plan
from orchestrator.view.result_files import columns_of, find_result, list_results


def drive_of(session: Path) -> Path:
    """The scenario of a saved session."""
    return session.with_name(f"drive{session.stem.removeprefix('session')}.csv")


def columns(machine: Machine) -> Mapping[str, int]:
    """Bare name of a signal or an axis -> its column in a table of axes, then signals; an axis goes first."""
    axes, signals = list(machine.axes), list(machine.signals)
    places = {bare: len(axes) + signals.index(full) for bare, full in by_bare_name(signals).items()}
    return places | {bare: axes.index(full) for bare, full in by_bare_name(axes).items()}


class ExchangeableMachine:
    """A `Machine` that is another one, which can be exchanged: what is not here is that of `machine`.

    factor      the speed that was set last
    exchanges   number of exchanges; frames before and after an exchange are not related
    """

    def __init__(self, machine: Machine) -> None:
        self.machine, self.exchanges, self.factor = machine, 0, 1.0

    def __getattr__(self, name: str) -> Any:
        return getattr(self.machine, name)

    def exchange(self, machine: Machine) -> None:
        """Show another machine. The previous one is paused."""
        if self.machine.drives:
            self.machine.command({})
        self.machine.pause()
        machine.speed(self.factor)
        self.machine = machine
        self.exchanges += 1

    def speed(self, factor: float) -> None:
        self.machine.speed(factor)
        self.factor = factor

    def restart(self, setup: Setup | None = None) -> None:
        self.machine.restart(setup)
        self.exchanges += 1


class Session:
    """The machine that all pages show.

    plan      the latest choice
    machine   the machine that is shown: `live`, or a replay
    columns   bare name -> column in its frames, see `columns`
    title     title of the page
    file      name of the file that is replayed; empty for the live machine
    """

    def __init__(
        self,
        first: MachineChoice,
        folders: Sequence[Path] = (),
        simulate: Callable[[Setup], Machine] = RealTimeMachine,
    ) -> None:
        """folders: of result files, the first also for saving; simulate: starts the live machine."""
        self.folders = tuple(folders)
        self.plan: ViewPlan = plan(first)
        self.live = simulate(self.plan.setup)
        self.machine = ExchangeableMachine(self.live)
        self.file = ""
        self._recording: Replay | None = None
        self.columns = columns(self.machine)

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
    def span(self) -> tuple[float, float] | None:
        """First and last time of the replayed file [s]; None for the live machine."""
        return (self._recording.begin, self._recording.end) if self._recording else None

    def start(self, choice: MachineChoice) -> None:
        """Start the live machine with this choice."""
        new = plan(choice)
        self.live.restart(new.setup)
        self.plan = new
        self._show(self.live)
        self.live.play()

    def again(self) -> None:
        """Restart the current machine or replay."""
        self.machine.restart()
        self.machine.play()

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
        results = ((name, find_result(name, self.folders)) for name in list_results(self.folders))
        return [name for name, path in results if self._fits(by_bare_name(columns_of(path)))]

    def replay(self, name: str) -> None:
        """Show a result file of the open folders. The live machine is paused meanwhile."""
        self.replay_file(find_result(name, self.folders), name)

    def replay_file(self, path: Path, name: str = "") -> None:
        """Show any result file. Not for names that come from a page."""
        trace = read_trace(path)
        if not len(trace.time):
            raise Problem(f"{path}: expected samples, found none")
        recording = Replay(trace)
        if not self._fits(columns(recording)):
            (required, least), full = self._required, by_bare_name(self.plan.setup.signals)
            example = next((full[name] for name in full if name in required), "component.output")
            found = ", ".join(list(trace.signals)[:4]) or "none"
            many = f"{least} or more " if least > 1 else ""
            raise Problem(f"{path}: expected {many}signals such as {example}, found {found}")
        self._show(recording, name or path.name)
        self.machine.play()

    def seek(self, t: float) -> None:
        """Go to a time of the replayed file [s]."""
        if self._recording is not None and math.isfinite(t):
            self._recording.seek(t)
            self.machine.exchanges += 1  # frames before and after are not related

    def before(self, seconds: float) -> tuple[Array, Array, Array] | None:
        """Times, axes and values that the replayed file has in the seconds before now, also before a jump."""
        return self._recording.before(seconds) if self._recording else None

    def back(self) -> None:
        """Show the live machine again, as it was paused."""
        if self.file:
            self.machine.machine.close()
            self._show(self.live)

    def save(self, machine: Machine | None = None) -> Path:
        """Save the session, or that of another machine, as a result file in the first folder.

        What was driven is beside it, as a scenario (`drive_of`), unless it is a replay, or its beginning is
        no longer in memory.
        """
        if not self.folders:
            raise Problem("save: no folder for results is open")
        machine = machine or self.machine
        trace = machine.trace()
        if not len(trace.time):
            raise Problem("save: nothing has been recorded yet")
        stamp = time.strftime("%Y%m%d-%H%M%S")
        path = write_trace(trace, self.folders[0] / f"session-{stamp}.parquet")
        if machine.drives and machine.axes and trace.time[0] <= self.plan.begin + 1e-9:  # rounding
            write_trace(trace.select(machine.axes), drive_of(path))
        return path

    def repeated(self, saved: Path) -> str:
        """How to repeat a saved session; empty for a replay."""
        drive = drive_of(saved)
        if drive.is_file():
            return f"the same drive: {self.plan.choice.command(str(drive))}"
        return "its beginning is no longer in memory, so it cannot be repeated" if self.machine.drives else ""

    def close(self) -> None:
        """Close all machines."""
        self.machine.close()
        self.live.close()

    def _show(self, machine: Machine, file: str = "") -> None:
        self.machine.exchange(machine)
        self.file, self._recording = file, machine if isinstance(machine, Replay) else None
        self.columns = columns(self.machine)
