"""A progress bar that appears only when a run takes longer than a second.

From communication point to communication point: the reference for native/march.c, which does it in C.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from math import isfinite
from types import TracebackType
from typing import Any

from orchestrator.base.errors import Discarded
from orchestrator.engine.communication_step import Pace, Sweep
from orchestrator.engine.network import Network
from orchestrator.engine.recorder import BLOCK, Monitor, Recorder
from orchestrator.engine.time_grid import Grid

PATIENCE = 1.0  # [s]


class Progress:
    """Shows how much of `total` [s] is simulated; silent when not wanted or when the run is short."""

    def __init__(self, total: float, wanted: bool) -> None:
        self._total, self._wanted = total, wanted
        self._began = time.perf_counter()
        self._bar: Any = None
        self._task: Any = None

    def __enter__(self) -> Progress:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None
    ) -> None:
        if self._bar is not None:
            self._bar.stop()

    def update(self, done: float) -> None:
        """`done` [s] are simulated now."""
        if not self._wanted or (self._bar is None and time.perf_counter() - self._began < PATIENCE):
            return
        if self._bar is None:
            self._open()
        self._bar.update(self._task, completed=done)

    def _open(self) -> None:
        from rich.console import Console
        from rich.progress import BarColumn, TextColumn, TimeRemainingColumn
        from rich.progress import Progress as Bar

        text = TextColumn("{task.completed:.2f} of {task.total:g} s simulated")
        console = Console(stderr=True)
        self._bar = Bar(text, BarColumn(), TimeRemainingColumn(), console=console, transient=True)
        self._task = self._bar.add_task("run", total=self._total)
        self._bar.start()


LEAST = 1e-9  # of a step: an FMU that gets no further than that gets nowhere


class March:
    """A run in progress.

    t          the communication point that is reached [s]
    done       how many steps of the grid are done
    total      of how many; who looks in between may raise it
    steps      communication steps that were taken and stand
    passes     passes over all components, of all steps
    repeated   steps that did not stand
    notes      remarks on how it is done
    keeps      the beginning of each step is kept, as far as the FMUs can
    goes_back  all of it, so that a shorter step can be tried
    look       called between steps; ends the run if the user wants that
    """

    def __init__(
        self,
        network: Network,
        sweep: Sweep,
        times: Grid,
        recorder: Recorder,
        monitor: Monitor,
        pace: Pace | None = None,
        by_energy: bool = False,
        tolerance: float = 1.0,
    ) -> None:
        """pace: of adaptive runs; by_energy: the tolerance is one of power."""
        self._network, self._sweep, self._times = network, sweep, times
        self._recorder, self._monitor, self._pace = recorder, monitor, pace
        self._by_energy, self._tolerance = by_energy, tolerance
        self.notes: tuple[str, ...] = ()
        self.look: Callable[[], None] = lambda: None
        self.t, self.total = times.start, times.steps
        self.done = self.steps = self.passes = self.repeated = 0
        self.shortest, self.longest = float("inf"), 0.0
        iterates = sweep.plan.passes > 1 and len(sweep.plan.repeated) > 0
        self.keeps = iterates or (pace is not None and pace.repeats)
        for part in network.parts:
            part.kept = self.keeps and part.slave.interface.rollback
            part.even = 0.0 if part.slave.interface.varies else times.step / part.factor
        self.goes_back = all(part.kept and not part.even for part in network.parts)
        self._event = 0  # the next one
        self._lost = False  # a step without a finite error stands
        self._shorter = 0.0  # an FMU could not go further than that [s]; 0: none said so

    def begin(self) -> None:
        """Make everything known at the start, and record it."""
        self._network.begin(self.t)
        self._monitor.begin()
        self._recorder.add(self.t)

    def block(self) -> None:
        """Go on until as many points are to be recorded as fit into a block, or to the end."""
        self._lost = False
        while self.done < self.total and self._recorder.filled < BLOCK and not self._monitor.full:
            self.look()
            self._next()
            if self._lost:  # whoever looks at the record will end the run
                break

    def close(self) -> None:
        """End what the run has started."""

    def _next(self) -> None:
        """One communication step; it may have to be repeated, which is another one."""
        times = self._times
        point = times.start + (self.done + 1) * times.step
        events = times.events
        while self._event < len(events) and events[self._event] <= self.t:
            self._event += 1
        target = min(point, events[self._event]) if self._event < len(events) else point
        room = target - self.t
        h = room if self._pace is None else self._pace.length(room)
        if self._shorter > 0.0:
            h = min(h, self._shorter)
        if not self._step(h):
            self.repeated += 1
            return
        self.t = target if h == room else self.t + h
        self._shorter = 0.0
        self.steps += 1
        self.shortest, self.longest = min(self.shortest, h), max(self.longest, h)
        if self.t == point:
            self.done += 1
        if self.t == point or times.free or self._lost:
            self._recorder.add(self.t)

    def _step(self, h: float) -> bool:
        """A step of length h; False if it does not stand."""
        network, monitor = self._network, self._monitor
        if self.keeps:
            network.keep()
        try:
            self._sweep.step(self.t, h)
        except Discarded as problem:
            if not self._go_back(problem.reached - self.t, h):
                raise
            return False
        self.passes += self._sweep.passes
        monitor.stepped(h)
        network.settle(self.t, h)
        if self._pace is not None:
            e = self._error(h) / self._tolerance
            if not self._pace.good(e, h):
                self._withdraw(self.t)
                network.restore(self.t)
                return False
            self._lost = not isfinite(e)
        self._sweep.accept(h)
        monitor.settled()
        return True

    def _error(self, h: float) -> float:
        return self._sweep.power_error(h) if self._by_energy else self._sweep.error(h)

    def _go_back(self, reached: float, h: float) -> bool:
        """To the beginning of a step that an FMU did only the first part of, `reached` [s] long."""
        shorter = reached if LEAST * h < min(reached, h - reached) else 0.5 * h  # neither part is noise
        if not self.goes_back or shorter <= LEAST * self._times.step:
            return False
        self._withdraw(self.t)
        self._network.restore(self.t)
        self._shorter = shorter
        return True

    def _withdraw(self, t: float) -> None:
        """Forget what the FMUs said and returned in the step from t [s] on, which is repeated."""
        for slave in self._network.slaves.values():
            slave.log.time = t
            slave.resume()
