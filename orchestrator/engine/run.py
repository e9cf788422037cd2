"""Which of the two loops a run takes: the one in C, or the one in Python.

One run: open the FMUs, initialise, step, record, judge, close.

How large the error of a run is, by running again at other steps.

One call that runs a system: what the user gave becomes a system, a time grid and a job.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

from orchestrator.base.coupling import Coupling
from orchestrator.base.errors import Ended, Problem
from orchestrator.base.files import Location, folder, there
from orchestrator.base.interrupts import DeferredInterrupts
from orchestrator.data.trace import Trace, check_suffix, read, write
from orchestrator.engine.communication_step import Pace, Sweep
from orchestrator.engine.initialisation import initialise, remarks
from orchestrator.engine.masters import plan
from orchestrator.engine.native import compiled
from orchestrator.engine.native.compiled import Compiled
from orchestrator.engine.native.filling import Foreign
from orchestrator.engine.network import Network
from orchestrator.engine.recorder import Monitor, Recorder
from orchestrator.engine.result import Card, Interrupted, Result, RunFailed, compare, write_facts
from orchestrator.engine.scenario import Drive, drive
from orchestrator.engine.simulation_loop import March, Progress
from orchestrator.engine.time_grid import RECORD, Grid, communication_step, divided, free_grid, grid, thinned
from orchestrator.fmi.calls import Slave
from orchestrator.fmi.description import Value
from orchestrator.ssp.load import load
from orchestrator.ssp.parameters import with_sets
from orchestrator.ssp.power_bonds import Bond, find_bonds, named_bond
from orchestrator.ssp.system import Component, System


def marching(fast: bool, network: Network, *others: object) -> March:
    """A run that is ready to begin, in C if that is wanted and possible; `others` as in `March`."""
    library = compiled.library() if fast else None
    if fast and not isinstance(library, str):
        with suppress(Foreign):
            return Compiled(network, *others)  # type: ignore[arg-type]
    march = March(network, *others)  # type: ignore[arg-type]
    march.notes = (library,) if isinstance(library, str) else ()
    return march


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
            with DeferredInterrupts() as interrupts:
                march.look = interrupts.check
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


def estimated(job: Job, times: Grid, result: Result, progress: bool) -> Card:
    """The card of a complete run with error estimates; what happens to the other runs does not harm it."""
    if times.free:
        note = "no error estimate: two adaptive runs only meet at the points of a record step, give one"
        return replace(result.card, notes=(*result.card.notes, note))
    adaptive = job.coupling.adaptive is not None
    try:
        finer = (job.stricter(), times) if adaptive else (job, times.finer())
        fine, coarse = finer[0].run(finer[1], progress).trace, None
        if not adaptive and times.steps >= 4:
            with suppress(RunFailed):
                coarse = job.run(times.coarser(), progress).trace
    except RunFailed as failed:
        which = "a tenth of the tolerance" if adaptive else "half the step"
        note = f"no error estimate, the run at {which} failed: {failed}"
        return replace(result.card, notes=(*result.card.notes, note))
    except Interrupted:
        raise Interrupted(result) from None
    nominals = {str(p): job.system.variable(p).nominal for p in job.system.ports("output")}
    shown = result.trace.select(name for name in nominals if name in result.trace.signals)
    errors = compare(fine, shown, coarse, nominals)
    told = () if errors else ("no error estimate: no output moves",)
    return replace(result.card, errors=errors, notes=(*result.card.notes, *told))


__all__ = ["Interrupted", "Result", "RunFailed", "open_slave", "run"]  # what a caller of `run` needs


def open_slave(component: Component) -> Slave:
    """An instance of the component's FMU."""
    if component.source is None:
        raise Problem(f"{component.name}: has no FMU file")
    from orchestrator.fmi.cosimulation import FmuSlave

    return FmuSlave(component.name, component.interface, component.source, component.start)


def run(
    system: System | str | Path,
    scenario: Trace | str | Path | Location | None = None,
    master: str | Coupling | None = None,
    step: float | None = None,
    start: float | None = None,
    stop: float | None = None,
    swap: Mapping[str, str | Path] | None = None,
    parameters: Sequence[str | Path] = (),
    set: Mapping[str, Value | str] | None = None,
    record: Sequence[str] | None = None,
    record_step: float | None = None,
    bonds: Iterable[tuple[str, str]] | None = None,
    tolerance: float | None = None,
    error_estimate: bool = False,
    progress: bool = False,
    native: bool = True,
    open: Opener = open_slave,
) -> Result:
    """Co-simulate a system.

    system          a System, or the path of an .ssp, .ssd or .fmu file
    scenario        inputs over time: a Trace, or a .csv or .parquet file; columns name inputs of the system,
                    component.variable, or all component inputs of one name; a column replaces the connection
                    to its input
    master          a name, such as "hermite", or a Coupling, such as Coupling("hermite", passes=2); default:
                    what the system suggests, see `System.coupling`, else "gauss-seidel"
    step            communication step [s], of adaptive runs the first to try; default: with no `master` given
                    what the system suggests, else the smallest that an FMU does, else 1e-3
    start, stop     [s]; default: stop at the end of the scenario, else what the system or the FMUs suggest
    swap            other FMUs {component: name of a variant, or path of an .fmu file}; they are checked
    parameters      parameter sets: names of those in the SSP's resources, or .ssv files; later ones win
    set             start values {name: value}, in the units of the FMU, before a swap, named like the columns
                    of a scenario
    record          names of the signals to record; default: all outputs, all inputs that are fed and all that
                    are inputs of the system, fed or not
    record_step     interval between recorded points [s], a multiple of the step; adaptive runs hit the points
                    exactly; first and last are always recorded; default: every communication point
    bonds           power bonds as pairs of input names; default: found from the units
    tolerance       relative tolerance handed to the FMUs
    error_estimate  run again at half and at twice the step, an adaptive run at a tenth of its tolerance, to
                    estimate the error of each signal at the recorded points
    progress        show a progress bar when the run takes longer than a second
    native          False: the loop in Python, which gives the same numbers and is slower
    open            makes the slave of a component (for tests and other kinds of components)

    Raises Problem for a mistake, RunFailed or Interrupted when a started run ends early.
    """
    from orchestrator.ssp.load import load

    whole = (system if isinstance(system, System) else load(system)).swapped(swap or {})
    if master is not None:
        whole = whole.coupled(master if isinstance(master, Coupling) else Coupling(master))
    whole = replace(whole, notes=whole.notes + whole.suggestion.notes(step is not None))
    whole = with_sets(whole, parameters).with_start(set or {})
    driven = _scenario(whole, scenario)
    if driven:
        whole = driven[0].released(whole)
        whole = replace(whole, notes=whole.notes + driven[0].overruled(whole, set or {}))
    coupling = whole.coupling or Coupling()
    coupling.check(whole.components)
    trace, span = driven[1] if driven else None, (start, stop, record_step)
    if coupling.adaptive is None:
        times = grid(whole, trace, step, *span)
        if driven and guarded(whole, coupling):
            times = divided(times, driven[0].table.corners())
    else:
        times = free_grid(whole, trace, step, *span, driven[0].table.corners() if driven else ())
    job = Job(whole, driven[0] if driven else None, coupling, record, bonds, tolerance, native, open)
    result = job.run(times, progress)
    return replace(result, card=estimated(job, times, result, progress)) if error_estimate else result


def _scenario(system: System, scenario: Trace | str | Path | Location | None) -> tuple[Drive, Trace] | None:
    if scenario is None:
        return None
    trace = scenario if isinstance(scenario, Trace) else read(scenario)
    label = "scenario" if isinstance(scenario, Trace) else str(scenario)
    return drive(system, trace, label), trace


def run_to_file(system: Path, scenario: Path | None, out: Path, **options: Any) -> None:
    """Co-simulate, write the trace, print the accuracy card; an aborted run leaves its trace too."""
    save(simulated(system, scenario, out, **options), out, given(scenario=scenario, **options))


def given(coupling: Mapping[str, Any] | None = None, **options: Any) -> dict[str, Any]:
    """What the user asked for, in one mapping, to note beside a trace."""
    return {**options, **(coupling or {})}


def simulated(
    system: Path,
    scenario: Path | Trace | None,
    out: Path,
    step: float | None = None,
    record_step: float | None = None,
    coupling: Mapping[str, Any] | None = None,
    everywhere: bool = True,
    cut: Sequence[str] = (),
    swap: Mapping[str, str] | None = None,
    **options: Any,
) -> Result:
    """Co-simulate with a progress bar; a run that ends early is saved to the file `out`.

    record_step   [s]; default: 5 ms or as near below it as the step allows, at least one step
    coupling      choices that the user makes, named like the fields of `Coupling`
    everywhere    without a record step an adaptive run records every communication point, else every 5 ms
    cut           patterns of the inputs whose connections are left out, before anything else
    swap          other FMUs: component -> name of a variant, or path
    """
    check_suffix(out)
    loaded = load(there(system)).without(*cut).swapped(swap or {})
    loaded = loaded.coupled(coupling) if coupling else loaded
    if record_step is None and loaded.coupling and loaded.coupling.adaptive is not None:
        interval = None if everywhere else RECORD
    else:
        interval = thinned(communication_step(loaded, step)) if record_step is None else record_step
    folder(out.parent)
    try:
        return run(loaded, scenario, step=step, record_step=interval, progress=True, **options)
    except (RunFailed, Interrupted) as ended:
        own = {"step": step, "record_step": record_step, "cut": cut, "swap": swap}
        file = None if isinstance(scenario, Trace) else scenario
        save(ended.result, out, given(coupling, scenario=file, **own, **options))
        raise


def save(result: Result, out: Path, given: Mapping[str, Any]) -> None:
    """Write the trace and, beside it, what the run was; print the card."""
    write(result.trace, out)
    write_facts(result, out, given)
    print(result.card.text())
    end = f"up to t = {result.trace.time[-1]:.6g} s " if len(result.trace.time) else ""
    kept = "" if result.complete else f"the run ended early; what was recorded {end}is kept in "
    print(f"\n{kept}{contents(result, out)}")


def contents(result: Result, out: Path) -> str:
    """The file of a trace and what is in it."""
    trace, card = result.trace, result.card
    thin = card.record_step > card.step or (card.adaptive is not None and card.record_step > 0)
    every = f", every {card.record_step:g} s" if thin else ""
    return f"{out}: {len(trace.signals)} signals, {len(trace.time)} rows{every}"
