"""A run in C: fills the structures of native/run.h from a network, and offers what `March` offers."""

from __future__ import annotations

import ctypes
import os
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orchestrator.coupling import signal
from orchestrator.coupling.bank import Link
from orchestrator.coupling.driver import Driver
from orchestrator.coupling.grid import Grid
from orchestrator.coupling.loop import Loop
from orchestrator.coupling.network import Network
from orchestrator.coupling.pace import Pace
from orchestrator.coupling.part import Part
from orchestrator.coupling.sweep import Sweep
from orchestrator.errors import Discarded, Problem
from orchestrator.runs import layout, native
from orchestrator.runs.energy import ROWS, Monitor
from orchestrator.runs.foresights import Foreteller
from orchestrator.runs.loops import Filler, Judge
from orchestrator.runs.march import March
from orchestrator.runs.recorder import BLOCK, Recorder
from orchestrator.slaves.access import Access, Stepping
from orchestrator.slaves.slave import Call

DRIVEN = (  # what a driver keeps in arrays
    *("columns", "targets", "factor", "offset"),
    *("steady_columns", "steady", "steady_factor", "steady_offset", "held_columns", "held"),
)
KINDS = {layout.Access: layout.ACCESS, layout.Link: layout.LINK, layout.Loop: layout.LOOP}
SAMPLE = 20  # steps after which it is known what the components cost
WORTH = 2e-5  # [s] per step: less than that is not worth waking threads, which takes some 5e-6 s
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
        """Raises TypeError where a component is no FMU that C can call, see `stepping`."""
        super().__init__(network, sweep, times, recorder, monitor, pace, by_energy, tolerance)
        self._judges: dict[int, Judge] = {}
        self._alive: list[Any] = []  # what C has the addresses of
        self._problem: BaseException | None = None
        self._steppings = [stepping(part) for part in network.parts]
        self._run = layout.Run()
        library = native.library()
        self._march, self._finish = library.march, library.finish  # type: ignore[union-attr]
        self._decides = not sweep.plan.sequential and len(network.parts) > 1
        self._fill()

    # ---- the run

    def begin(self) -> None:
        """Make everything known at the start, and record it."""
        super().begin()
        for mine, known in zip(self._signals, self._network.signals, strict=False):
            mine.value, mine.slope0, mine.known = known.value, known.slope0, known.known
            mine.scale, mine.c, mine.tied, mine.slope = known.scale, known.c, known.tied, known.slope
        self._run.tied = self._program(self._network.tied)
        self._run.t = self.t

    def block(self) -> None:
        """Go on until as many points are to be recorded as fit into a block, or to the end."""
        self.look()
        run = self._run
        run.recorder.filled, run.monitor.rows = self._recorder.filled, self._monitor.rows
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
            self._run.threads = min(os.cpu_count() or 1, len(each))

    def close(self) -> None:
        """End the threads."""
        self._finish(ctypes.byref(self._run))

    def _judge(self, where: int | None, part: int, status: int) -> int:
        """Called from C: what to do after a status that is not OK."""
        try:
            if status == layout.WITHDRAWN:
                self._withdraw(self._run.t)
            elif where in self._judges:
                self._judges[where].judge(status)
            else:
                step = self._steppings[part]
                states = {step.get_state: step.judge_get, step.set_state: step.judge_set}
                (states[where] if where else step.judge)(status)
        except Discarded as problem:
            self._problem, self._run.reached = problem, problem.reached
            return layout.DISCARDED
        except BaseException as problem:
            self._problem = problem
            return layout.STOP
        return layout.CONTINUE

    # ---- filling the structures

    def _fill(self) -> None:
        run, network, plan, times = self._run, self._network, self._sweep.plan, self._times
        kept = network.real.values.copy(), network.whole.values.copy()
        run.real, run.whole = self._at(network.real.values), self._at(network.whole.values)
        run.real_kept, run.whole_kept = self._at(kept[0]), self._at(kept[1])
        run.used, run.slopes = self._at(network.used), self._at(network.slopes)
        run.reals, run.wholes = len(kept[0]), len(kept[1])
        run.exchange = self._program(network.exchange_calls)
        self._signals = (layout.Signal * max(len(network.signals), 1))()
        self._signals_of(network.signals)
        run.signals, run.signal_count = self._signals, len(network.signals)
        numbers = range(len(network.parts))
        parts = map(self._part, numbers, network.parts, self._steppings)
        self._parts = (layout.Part * len(network.parts))(*parts)
        run.parts, run.part_count = self._parts, len(network.parts)
        if network.driver:
            run.driver = ctypes.pointer(self._driver(network.driver))
        run.monitor, run.recorder = self._monitored(), self._recorded()
        run.turns = self._at(np.array(self._sweep.turns, np.int32))
        if self._sweep.foresight:
            made = Foreteller(self._filler()).foresight(self._sweep.foresight)
            run.foresight = ctypes.pointer(made)
        run.stepped = self._at(np.zeros(len(network.parts), np.uint8))
        run.degree, run.passes, run.corrected = plan.degree, plan.passes, plan.corrected
        run.sequential, run.tolerance = plan.sequential, plan.tolerance
        run.bonds, run.bond_count = self._at(self._bonds()), len(network.bonds)
        if self._pace:
            run.pace = ctypes.pointer(self._paced(self._pace))
        run.adaptive, run.by_energy, run.free = self._tolerance, self._by_energy, times.free
        run.events, run.event_count = self._at(np.array(times.events, float)), len(times.events)
        run.shortest = np.inf
        run.start, run.step, run.t, run.patience = times.start, times.step, times.start, PATIENCE
        run.total, run.keeps, run.goes_back = times.steps, self.keeps, self.goes_back
        run.judge = layout.JUDGE(self._judge)

    def _filler(self) -> Filler:
        return Filler(self._at, self._program, self._judges)

    def _at(self, array: NDArray[Any]) -> int:
        """The address of an array that C uses."""
        if not array.flags.c_contiguous:
            raise ValueError("expected a contiguous array")
        self._alive.append(array)
        return array.ctypes.data

    def _program(self, calls: Sequence[Call]) -> layout.Program:
        """Calls as instructions; a function that is no access, link or loop cannot be one."""
        instructions = (layout.Instruction * max(len(calls), 1))()
        for instruction, call in zip(instructions, calls, strict=False):
            what = self._instruction(call)
            instruction.kind = KINDS[type(what)]
            self._alive.append(what)
            instruction.what = ctypes.addressof(what)
        return layout.Program(len(calls), instructions)

    def _instruction(self, call: Call) -> layout.Link | layout.Access | layout.Loop:
        if isinstance(call, Link):
            return self._link(call)
        if isinstance(call, Access):
            return self._access(call)
        if isinstance(call, Loop):
            return self._filler().loop(call)
        raise TypeError(f"{call!r} cannot be called from C")

    def _access(self, call: Access) -> layout.Access:
        made = layout.Access(
            function=call.address,
            component=call.component,
            references=self._at(call.references),
            orders=None if call.orders is None else self._at(call.orders),
            own=self._at(call.own),
            values=self._at(call.values),
            count=len(call.names),
            fmi=call.fmi,
            type=[np.dtype(kind) for kind in layout.TYPES].index(call.own.dtype),
            bank=layout.REAL if call.values.dtype == np.float64 else layout.WHOLE,
            sets=call.sets,
        )
        self._judges[ctypes.addressof(made)] = call
        return made

    def _link(self, call: Link) -> layout.Link:
        return layout.Link(
            source=self._at(call.source),
            target=self._at(call.target),
            factor=None if call.plain else self._at(call.factor),
            offset=None if call.plain else self._at(call.offset),
            count=len(call.source),
            bank=layout.REAL if call.values.dtype == np.float64 else layout.WHOLE,
        )

    def _signals_of(self, signals: Sequence[signal.Signal]) -> None:
        for mine, one in zip(self._signals, signals, strict=False):
            for name in (field[0] for field in layout.Signal._fields_):
                if name != "c":
                    setattr(mine, name, getattr(one, name))

    def _part(self, k: int, part: Part, step: Stepping) -> layout.Part:
        signals = self._network.signals
        first = signals.index(part.signals[0]) if part.signals else 0
        results = dict(zip(("event", "terminate", "early", "last"), step.results, strict=False))
        return layout.Part(
            component=step.component,
            do_step=step.do_step,
            get_state=step.get_state,
            set_state=step.set_state,
            flags=step.flags,
            clock=self._at(step.clock),
            fmi=step.fmi,
            final=not part.kept,
            kept=part.kept,
            repeated=k in self._sweep.plan.repeated,
            even=part.even,
            factor=part.factor,
            first=first,
            count=len(part.signals),
            revalued=len(part.values) > 0,
            rough=part.rough,
            values=self._at(part.values),
            derivatives=self._at(part.derivatives),
            writers=self._program(part.writers),
            reads=self._program(part.reads),
            newest=self._program(part.newest),
            tell=self._program([part.tell] if part.tell else []),
            **results,
        )

    def _bonds(self) -> NDArray[np.int32]:
        """Of each power bond the numbers of the signals of effort and flow."""
        place = {id(s): i for i, s in enumerate(self._network.signals)}
        pairs = [[place[id(effort)], place[id(flow)]] for effort, flow in self._network.bonds]
        return np.array(pairs, np.int32).reshape(-1)

    def _paced(self, pace: Pace) -> layout.Pace:
        return layout.Pace(
            h=pace.h,
            smallest=pace.smallest,
            largest=pace.largest,
            power=pace.power,
            repeats=pace.repeats,
        )

    def _driver(self, driver: Driver) -> layout.Driver:
        table = driver.table
        arrays = dict(
            zip(("time", "base", "slopes", "anchor"), (self._at(a) for a in table.arrays), strict=True)
        )
        places = {s.target: i for i, s in enumerate(self._network.signals)}
        signals = np.array([places[int(t)] for t in driver.targets], np.int32)
        return layout.Driver(
            **arrays,
            samples=len(table.arrays[0]),
            width=table.arrays[1].shape[1],
            **{name: self._at(getattr(driver, name)) for name in DRIVEN},
            coming=self._at(np.zeros(len(signals))),
            middle=self._at(np.zeros(len(signals))),
            signals=self._at(signals),
            count=len(signals),
            steady_count=len(driver.steady),
            held_count=len(driver.held),
            when=np.nan,
            writers=self._program(driver.writers),
        )

    def _monitored(self) -> layout.Monitor:
        m = self._monitor
        return layout.Monitor(
            places=self._at(m.places),
            spread=self._at(m.spread),
            moved=self._at(m.moved.view(np.uint8)),
            seen=self._at(m.seen),
            step=self._at(m.step),
            first=self._at(m.first),
            last=self._at(m.last),
            truth=self._at(m.true),
            count=len(m.places),
            room=ROWS,
            readers=self._program(m.readers),
        )

    def _recorded(self) -> layout.Recorder:
        r = self._recorder
        return layout.Recorder(
            places=None if r.places is None else self._at(r.places),
            whole_places=self._at(r.whole_places),
            time=self._at(r.fresh.time),
            reals=self._at(r.fresh.reals),
            wholes=self._at(r.fresh.wholes),
            count=r.fresh.reals.shape[1],
            whole_count=r.fresh.wholes.shape[1],
            room=BLOCK,
        )


def stepping(part: Part) -> Stepping:
    """What it takes to step a component from C; TypeError if it is no FMU, or not stepped as FMUs are."""
    found = getattr(part.slave, "stepping", None)
    if found is None:
        raise TypeError(f"{part.slave.name} cannot be stepped from C")
    return found(part.kept)  # type: ignore[no-any-return]
