"""One call that runs a system: open the FMUs, initialise, step, record, judge, close."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path

from orchestrator.archive import Location
from orchestrator.bonds import Bond, find_bonds, named_bond
from orchestrator.card import Card, compare
from orchestrator.drive import Drive, drive
from orchestrator.energy import Monitor
from orchestrator.errors import Problem
from orchestrator.grid import Grid, grid
from orchestrator.initialise import initialise
from orchestrator.interface import Value
from orchestrator.log import Message
from orchestrator.masters import find
from orchestrator.network import Network
from orchestrator.progress import Progress
from orchestrator.recorder import Recorder
from orchestrator.slave import Slave
from orchestrator.system import Component, System
from orchestrator.trace import Trace, read

Opener = Callable[[Component], Slave]


@dataclass(frozen=True)
class Result:
    """What a run leaves behind.

    trace      all outputs and fed inputs (or the chosen signals) at each communication point
    card       the accuracy card
    messages   what the FMUs logged
    complete   False when the run ended early; the trace then holds what was recorded until there
    """

    system: System
    trace: Trace
    card: Card
    messages: tuple[Message, ...] = ()
    complete: bool = True


class RunFailed(Problem):
    """A run that ended early because of a problem; `result` holds what was recorded."""

    def __init__(self, problem: Problem, result: Result) -> None:
        super().__init__(str(problem))
        self.result = result


class Interrupted(KeyboardInterrupt):
    """A run that the user stopped; `result` holds what was recorded."""

    def __init__(self, result: Result) -> None:
        super().__init__()
        self.result = result


def open_slave(component: Component) -> Slave:
    """An instance of the component's FMU."""
    if component.source is None:
        raise Problem(f"{component.name}: has no FMU file")
    from orchestrator.fmu import FmuSlave

    return FmuSlave(component.name, component.interface, component.source)


def run(
    system: System | str | Path,
    scenario: Trace | str | Path | Location | None = None,
    master: str = "jacobi",
    step: float | None = None,
    start: float | None = None,
    stop: float | None = None,
    set: Mapping[str, Value | str] | None = None,
    record: Sequence[str] | None = None,
    bonds: Iterable[tuple[str, str]] | None = None,
    tolerance: float | None = None,
    error_estimate: bool = False,
    progress: bool = False,
    open: Opener = open_slave,
) -> Result:
    """Co-simulate a system.

    system          a System, or the path of an .ssp, .ssd or .fmu file
    scenario        inputs over time: a Trace, or a .csv or .parquet file; columns name system inputs or
                    component.variable
    master          "jacobi" or "gauss-seidel"
    step            communication step [s]; default: the smallest that an FMU suggests, else 1e-3
    start, stop     [s]; default: stop at the end of the scenario, else what the system or the FMUs suggest
    set             start values {component.variable: value}, in the FMU's units
    record          names of the signals to record; default: all outputs and fed inputs
    bonds           power bonds as pairs of input names; default: found from the units
    tolerance       relative tolerance handed to the FMUs
    error_estimate  run again at half and at twice the step to estimate the error of each signal
    progress        show a progress bar when the run takes longer than a second
    open            makes the slave of a component (for tests and other kinds of components)

    Raises Problem for a mistake, RunFailed or Interrupted when a started run ends early.
    """
    from orchestrator.ssp import load

    whole = (system if isinstance(system, System) else load(system)).with_start(set or {})
    driven = _scenario(whole, scenario)
    times = grid(whole, driven[1] if driven else None, step, start, stop)
    job = _Job(whole, driven[0] if driven else None, master, record, bonds, tolerance, open)
    result = job.run(times, progress)
    if not error_estimate:
        return result
    fine = job.run(replace(times, step=times.step / 2, steps=2 * times.steps), progress)
    coarse = None
    if times.steps >= 4:
        try:
            coarse = job.run(replace(times, step=times.step * 2, steps=times.steps // 2), progress)
        except RunFailed:
            coarse = None
    errors = compare(fine.trace, result.trace, coarse.trace if coarse else None)
    return replace(result, card=replace(result.card, errors=errors))


def _scenario(system: System, scenario: Trace | str | Path | Location | None) -> tuple[Drive, Trace] | None:
    if scenario is None:
        return None
    trace = scenario if isinstance(scenario, Trace) else read(scenario)
    label = "scenario" if isinstance(scenario, Trace) else str(scenario)
    return drive(system, trace, label), trace


@dataclass
class _Job:
    """One system and one way to run it, on any time grid."""

    system: System
    drive: Drive | None
    master: str
    record: Sequence[str] | None
    bonds: Iterable[tuple[str, str]] | None
    tolerance: float | None
    open: Opener

    def run(self, times: Grid, progress: bool) -> Result:
        """Open all FMUs, run, close them whatever happens."""
        prepare = find(self.master)
        chosen = None if self.record is None else [self.system.port(name) for name in self.record]
        with ExitStack() as stack:
            slaves: dict[str, Slave] = {}
            for name, component in self.system.components.items():
                slaves[name] = self.open(component)
                stack.callback(slaves[name].close)
            network = Network(self.system, slaves, self.drive, chosen or ())
            driven = self.drive.initial(self.system, times.start) if self.drive else {}
            initialise(self.system, slaves, driven, (times.start, times.stop), self.tolerance)
            monitor = Monitor(network, self._bonds())
            recorder = Recorder(network, times.steps + 1, chosen)
            bar = stack.enter_context(Progress(times.stop - times.start, progress))
            loop = _Loop(network, recorder, monitor, times, bar)
            return self._judge(loop, lambda: loop.go(prepare(network)))

    def _bonds(self) -> list[Bond]:
        if self.bonds is None:
            return find_bonds(self.system)
        return [named_bond(self.system, *pair) for pair in self.bonds]

    def _judge(self, loop: _Loop, go: Callable[[], None]) -> Result:
        """Run, and make a result of it even when it ends early."""
        began = time.perf_counter()
        try:
            go()
        except KeyboardInterrupt:
            raise Interrupted(self._result(loop, began, False)) from None
        except Problem as problem:
            raise RunFailed(problem, self._result(loop, began, False)) from problem
        return self._result(loop, began, True)

    def _result(self, loop: _Loop, began: float, complete: bool) -> Result:
        logs = [s.log for s in loop.network.slaves.values()]
        trace = loop.recorder.trace(list(self.system.outputs.values()))
        done = max(len(trace.time) - 1, 0)
        card = Card(
            master=self.master,
            step=loop.times.step,
            steps=done,
            simulated=done * loop.times.step,
            wall=time.perf_counter() - began,
            bonds=tuple(loop.monitor.energies()),
            warnings=tuple(line for log in logs for line in log.warnings()),
            notes=self.system.notes + loop.network.order.notes + loop.times.notes,
        )
        messages = sorted((m for log in logs for m in log.messages), key=lambda m: m.time)
        return Result(self.system, trace, card, tuple(messages), complete)


BLOCK = 256  # steps between looks at the clock and checks for NaN


@dataclass
class _Loop:
    """The loop over the communication steps."""

    network: Network
    recorder: Recorder
    monitor: Monitor
    times: Grid
    bar: Progress

    def go(self, step: Callable[[float, float], None]) -> None:
        """From the start to the stop time; records the first instant and every step."""
        times, record = self.times, self.recorder.add
        self.network.exchange(times.start)
        self.monitor.begin()
        record(times.start)
        checked, t = self.recorder.check(0), times.start
        for first in range(1, times.steps + 1, BLOCK):
            for n in range(first, min(first + BLOCK, times.steps + 1)):
                after = times.start + n * times.step
                step(t, after - t)
                t = after
                record(t)
            checked = self.recorder.check(checked)
            self.bar.update(t - times.start)
