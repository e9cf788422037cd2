"""The run in C: compiled on first use by the compiler of the package `ziglang`, kept in the user's cache.

A run in C, which offers what `March` offers; filling.py makes the structures that it works on.
"""

from __future__ import annotations

import ctypes
import os
from functools import cache
from pathlib import Path

import numpy as np

from orchestrator.base.compiler import SUFFIX, shared_library
from orchestrator.base.errors import Discarded, Problem
from orchestrator.engine.communication_step import Pace, Sweep
from orchestrator.engine.native import filling, structures
from orchestrator.engine.native.filling import Programs, foresight
from orchestrator.engine.network import Network
from orchestrator.engine.recorder import Monitor, Recorder
from orchestrator.engine.simulation_loop import March
from orchestrator.engine.time_grid import Grid

FOLDER = Path(__file__).parent
SOURCES = (
    *("calls.c", "driver.c", "foresight.c", "loop.c", "march.c", "pace.c", "signal.c", "sweep.c"),
    "threads.c",
)
FLAGS = (
    *("-std=gnu11", "-O2", "-g0", "-fPIC", "-shared", "-pthread", "-fvisibility=hidden"),
    *("-Wall", "-Wextra", "-Wconversion", "-Wshadow", "-Werror"),
    "-ffp-contract=off",  # the same numbers as in Python
    "-mcpu=baseline",  # the cache may be shared by machines whose processors know different instructions
)


@cache
def library() -> ctypes.CDLL | str:
    """The compiled code, or one line that tells why there is none."""
    code = {path.name: path.read_bytes() for path in FOLDER.glob("*.[ch]")}
    try:
        return ctypes.CDLL(str(shared_library(f"run{SUFFIX}", code, [*FLAGS, *SOURCES])))
    except (OSError, Problem) as error:
        return f"the compiled loop is not available, Python does it slower: {error}"


SAMPLE = 20  # steps after which it is known what the components cost
WORTH = 2e-5  # [s] per step: less than that is not worth waking threads, which takes some 5e-6 s
CORES = os.cpu_count() or 1  # for the components of one run
PATIENCE = 0.1  # [s], the longest time between two looks at the keyboard


class Compiled(March):
    """A run in progress whose steps are taken by native/march.c."""

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
        """Raises Foreign where a component is no FMU that C can call."""
        super().__init__(network, sweep, times, recorder, monitor, pace, by_energy, tolerance)
        self._programs = Programs()
        self._problem: BaseException | None = None
        self._steppings = [filling.stepping(part) for part in network.parts]
        self._run = structures.Run()
        code = library()
        self._march, self._finish = code.march, code.finish  # type: ignore[union-attr]
        self._decides = not sweep.plan.sequential and len(network.parts) > 1
        self._fill()

    # ---- the run

    def begin(self) -> None:
        """Make everything known at the start, and record it."""
        super().begin()
        for mine, known in zip(self._signals, self._network.signals, strict=False):
            mine.value, mine.slope0, mine.known = known.value, known.slope0, known.known
            mine.scale, mine.c, mine.tied, mine.slope = known.scale, known.c, known.tied, known.slope
        self._run.tied = self._programs.program(self._network.tied)
        self._run.t = self.t

    def block(self) -> None:
        """Go on until as many points are to be recorded as fit into a block, or to the end."""
        self.look()
        run = self._run
        run.recorder.filled, run.monitor.rows = self._recorder.filled, self._monitor.rows
        run.total = self.total
        verdict = self._march(ctypes.byref(run))
        self._recorder.filled, self._monitor.rows = run.recorder.filled, run.monitor.rows
        self.t, self.done, self.steps, self.passes = run.t, run.done, run.steps, run.all_passes
        self.repeated, self.shortest, self.longest = run.repeated, run.shortest, run.longest
        for part, mine in zip(self._network.parts, self._parts, strict=True):
            part.slave.busy, part.state = mine.busy, mine.state and ctypes.c_void_p(mine.state)
        if self._decides and self.steps >= SAMPLE:
            self._decide()
        if verdict:
            raise self._problem or Problem("the run stopped")

    def _decide(self) -> None:
        """Let the components step at the same time if that saves more than it costs."""
        self._decides = False
        each = [part.busy / self.steps for part in self._parts]
        if sum(each) - max(each) > WORTH:
            self._run.threads = min(CORES, len(each))

    def close(self) -> None:
        """End the threads."""
        self._finish(ctypes.byref(self._run))

    def _judge(self, where: int | None, part: int, status: int) -> int:
        """Called from C: what to do after a status that is not OK."""
        try:
            if status == structures.WITHDRAWN:
                self._withdraw(self._run.t)
            elif where in self._programs.judges:
                self._programs.judges[where].judge(status)
            else:
                step = self._steppings[part]
                states = {step.get_state: step.judge_get, step.set_state: step.judge_set}
                (states[where] if where else step.judge)(status)
        except Discarded as problem:
            self._problem, self._run.reached = problem, problem.reached
            return structures.DISCARDED
        except BaseException as problem:
            self._problem = problem
            return structures.STOP
        return structures.CONTINUE

    # ---- filling the structures

    def _fill(self) -> None:
        network, repeated = self._network, self._sweep.plan.repeated
        filling.fill_network(self._run, self._programs, network)
        self._signals = filling.signals(network.signals)
        made = [
            filling.part(self._programs, network, k, step, k in repeated)
            for k, step in enumerate(self._steppings)
        ]
        self._parts = (structures.Part * len(made))(*made)
        self._run.signals, self._run.signal_count = self._signals, len(network.signals)
        self._run.parts, self._run.part_count = self._parts, len(made)
        if network.driver:
            self._run.driver = ctypes.pointer(filling.driver(self._programs, network, network.driver))
        self._run.monitor = filling.monitor(self._programs, self._monitor)
        self._run.recorder = filling.recorder(self._programs, self._recorder)
        self._run.judge = structures.JUDGE(self._judge)
        self._fill_plan()
        self._fill_march()

    def _fill_plan(self) -> None:
        run, programs, plan = self._run, self._programs, self._sweep.plan
        run.turns = programs.at(np.array(self._sweep.turns, np.int32))
        run.stepped = programs.at(np.zeros(len(self._parts), np.uint8))
        run.degree, run.passes, run.corrected = plan.degree, plan.passes, plan.corrected
        run.sequential, run.tolerance = plan.sequential, plan.tolerance
        if self._sweep.foresight:
            run.foresight = ctypes.pointer(foresight(programs, self._sweep.foresight))

    def _fill_march(self) -> None:
        run, times = self._run, self._times
        if self._pace:
            run.pace = ctypes.pointer(filling.pace(self._pace))
        run.adaptive, run.by_energy, run.free = self._tolerance, self._by_energy, times.free
        run.events = self._programs.at(np.array(times.events, float))
        run.event_count = len(times.events)
        run.shortest = np.inf
        run.start, run.step, run.t, run.patience = times.start, times.step, times.start, PATIENCE
        run.keeps, run.goes_back = self.keeps, self.goes_back
