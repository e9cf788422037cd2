"""One run: open the FMUs, initialise, step, record, judge, close."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from typing import NamedTuple

from orchestrator.coupling.drive import Drive
from orchestrator.coupling.grid import Grid
from orchestrator.coupling.initialise import initialise
from orchestrator.coupling.masters import plan
from orchestrator.coupling.network import Network
from orchestrator.coupling.pace import Pace
from orchestrator.coupling.remarks import remarks
from orchestrator.coupling.sweep import Sweep
from orchestrator.errors import Ended, Problem
from orchestrator.runs.card import Card
from orchestrator.runs.energy import Monitor
from orchestrator.runs.interrupts import Interrupts
from orchestrator.runs.march import March
from orchestrator.runs.marching import marching
from orchestrator.runs.progress import Progress
from orchestrator.runs.recorder import Recorder
from orchestrator.runs.result import Interrupted, Result, RunFailed
from orchestrator.settings import Coupling
from orchestrator.slaves.slave import Slave
from orchestrator.system.bonds import Bond, find_bonds, named_bond
from orchestrator.system.system import Component, System

CAUTIOUS = 1e-3  # of the first adaptive step, where it cannot be repeated and so has to be good at once

Opener = Callable[[Component], Slave]


class Opened(NamedTuple):
    """What a run works with once all FMUs are initialised."""

    network: Network
    sweep: Sweep
    recorder: Recorder
    monitor: Monitor
    march: March


@dataclass
class Job:
    """One system and one way to run it, on any time grid."""

    system: System
    drive: Drive | None
    coupling: Coupling
    record: Sequence[str] | None
    bonds: Iterable[tuple[str, str]] | None
    tolerance: float | None
    native: bool
    open: Opener

    def run(self, times: Grid, progress: bool) -> Result:
        """Open all FMUs, run, close them whatever happens."""
        with self.opened(times) as machine, Progress(times.stop - times.start, progress) as bar:
            notes = (*remarks(machine.network, machine.sweep.plan, self.coupling), *machine.sweep.notes)
            loop = _Loop(machine.network, machine.recorder, machine.monitor, times, bar, notes)
            return self._carry_out(loop, machine.march)

    @contextmanager
    def opened(self, times: Grid, recording: type[Recorder] = Recorder) -> Iterator[Opened]:
        """All FMUs open and initialised, ready for the first step; closed at the end whatever happens."""
        chosen = None if self.record is None else [self.system.port(name) for name in self.record]
        _check_single(self.system)
        with ExitStack() as stack:
            slaves: dict[str, Slave] = {}
            for name, component in self.system.components.items():
                slaves[name] = self.open(component)
                stack.callback(slaves[name].close)
            network = Network(self.system, slaves, self.drive, chosen, self.coupling.factors)
            sweep = Sweep(network, plan(self.system, self.coupling))
            driven = self.drive.initial(self.system, times.start) if self.drive else {}
            initialise(self.system, slaves, driven, (times.start, times.stop), self.tolerance)
            sweep.begin(times.start)
            monitor = Monitor(network, self._bonds(network))
            recorder = recording(network, times, chosen)
            stack.callback(network.forget)
            march = marching(self.native, network, sweep, times, recorder, monitor, *self._pace(sweep, times))
            stack.callback(march.close)
            yield Opened(network, sweep, recorder, monitor, march)

    def stricter(self) -> Job:
        """An adaptive run with a tenth of the tolerance."""
        c = self.coupling
        assert c.adaptive is not None
        passes = None if c.tolerance is None else c.tolerance / 10
        return replace(self, coupling=replace(c, adaptive=c.adaptive / 10, tolerance=passes))

    def _pace(self, sweep: Sweep, times: Grid) -> tuple[Pace | None, bool, float]:
        """What chooses the steps of an adaptive run, whether it looks at the energy, and the tolerance."""
        c = self.coupling
        if c.adaptive is None:
            if not guarded(self.system, c):
                return None, False, 1.0
            smallest = min(max(c.limits[0], times.least), times.step)
            return Pace(times.step, sweep.power, smallest, times.step, True), False, c.guarded
        if c.by_energy and not sweep.network.bonds:
            wanted = "a power bond with inputs that may move on both sides"
            raise Problem(f"control of the energy: expected {wanted}, got none")
        faces = {name: component.interface for name, component in self.system.components.items()}
        if even := [name for name, face in faces.items() if not face.varies]:
            told = f"{', '.join(even)}: the FMU takes steps of one length only"
            raise Problem(f"adaptive steps: expected FMUs that vary their steps, got {told}")
        rolls = all(face.rollback for face in faces.values())
        first = times.first if rolls else CAUTIOUS * times.first
        smallest, largest = c.limits
        pace = Pace(first, sweep.power, max(smallest, times.least), largest, rolls)
        return pace, c.by_energy, c.adaptive

    def _left_out(self) -> tuple[str, ...]:
        faces = {name: c.interface for name, c in self.system.components.items()}
        return tuple(f"{name}: {face.left_out}" for name, face in faces.items() if face.refused)

    def _bonds(self, network: Network) -> list[Bond]:
        """The bonds that are asked for, or those over which energy goes: both inputs change something."""
        if self.bonds is None:
            found = find_bonds(self.system)
            return [b for b in found if network.matters(b.effort) and network.matters(b.flow)]
        return [named_bond(self.system, *pair) for pair in self.bonds]

    def _carry_out(self, loop: _Loop, march: March) -> Result:
        """Run, and make a result of it even when it ends early."""
        began = time.perf_counter()
        try:
            with Interrupts() as interrupts:
                march.look = interrupts.look
                loop.go(march)
        except KeyboardInterrupt:
            raise Interrupted(self._result(loop, march, began, False)) from None
        except Ended as wish:
            loop.notes += (f"the run ends early: {wish}",)
        except Problem as problem:
            raise RunFailed(problem, self._result(loop, march, began, False)) from problem
        return self._result(loop, march, began, True)

    def _result(self, loop: _Loop, march: March, began: float, complete: bool) -> Result:
        logs = [s.log for s in loop.network.slaves.values()]
        trace = loop.recorder.trace(list(self.system.outputs.values()))
        reached = march.t - loop.times.start
        card = Card(
            master=self.coupling.text,
            step=loop.times.step if self.coupling.adaptive is None else reached / max(march.steps, 1),
            record_step=loop.times.every * loop.times.step if not loop.times.free else 0.0,
            steps=march.steps,
            simulated=reached,
            passes=march.passes,
            repeated=march.repeated,
            lengths=(march.shortest, march.longest),
            adaptive=self.coupling.adaptive,
            wall=time.perf_counter() - began,
            bonds=tuple(loop.monitor.energies()),
            warnings=tuple(line for log in logs for line in log.warnings(trace)),
            inside={name: slave.busy for name, slave in loop.network.slaves.items()},
            notes=(
                *(self.system.notes + self._left_out() + loop.network.notes),
                *(loop.times.notes + march.notes + loop.notes),
            ),
        )
        messages = sorted((m for log in logs for m in log.messages), key=lambda m: m.time)
        return Result(self.system, trace, card, tuple(messages), complete, self.coupling)


@dataclass
class _Loop:
    """The loop over the communication steps."""

    network: Network
    recorder: Recorder
    monitor: Monitor
    times: Grid
    bar: Progress
    notes: tuple[str, ...]

    def go(self, march: March) -> None:
        """From the start to the stop time; the recorder sees the first instant and every step."""
        march.begin()
        self.recorder.settle()
        while march.done < self.times.steps:
            try:
                march.block()
            except Problem:
                self.recorder.settle()  # a number that is not finite may be why a later step failed
                raise
            self.recorder.settle()
            if self.monitor.full:
                self.monitor.sum()
            self.bar.update(march.t - self.times.start)


def guarded(system: System, coupling: Coupling) -> bool:
    """Are steps divided where they would go wrong? All components must go back and vary their steps."""
    faces = [component.interface for component in system.components.values()]
    return coupling.guarded > 0 and all(face.rollback and face.varies for face in faces)


def _check_single(system: System) -> None:
    """Refuse two instances of an FMU that can have only one."""
    seen: dict[tuple[str, str], str] = {}
    for name, component in system.components.items():
        face = component.interface
        if face.only_one and (other := seen.setdefault((face.guid, face.identifier), name)) != name:
            raise Problem(f"{other} and {name}: expected one instance, their FMU can have no more, got two")
