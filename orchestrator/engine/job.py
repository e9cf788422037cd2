"""One run: open the FMUs, initialise, step, record, close; and how large its error is, by running again."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, replace

from orchestrator.base.coupling import Coupling
from orchestrator.base.errors import Ended, Problem
from orchestrator.base.interrupts import DeferredInterrupts
from orchestrator.engine.c_library import library
from orchestrator.engine.coupling_inputs import CouplingInputs, listed
from orchestrator.engine.initialisation import initialise
from orchestrator.engine.linear_prediction import LinearPrediction
from orchestrator.engine.masters import plan
from orchestrator.engine.network import Network
from orchestrator.engine.recorder import EnergyMonitor, Recorder
from orchestrator.engine.result import Card, Interrupted, Result, RunFailed, compare
from orchestrator.engine.scenario import Scenario
from orchestrator.engine.simulation_loop import ProgressBar, SimulationLoop, StepControl
from orchestrator.engine.time_grid import Grid
from orchestrator.fmi.calls import Slave
from orchestrator.ssp.power_bonds import Bond, find_bonds, named_bond
from orchestrator.ssp.system import Component, System

CAUTIOUS = 1e-3  # of the first adaptive step, where it cannot be repeated and so has to be good at once

Opener = Callable[[Component], Slave]


def open_slave(component: Component) -> Slave:
    """An instance of the component's FMU."""
    if component.source is None:
        raise Problem(f"{component.name}: has no FMU file")
    from orchestrator.fmi.cosimulation import CoSimulationFmu

    return CoSimulationFmu(component.name, component.interface, component.source, component.start)


@dataclass(frozen=True)
class Record:
    """What is recorded of a run.

    signals   names; default: all outputs, all inputs that are fed and all that are inputs of the system
    step      interval between recorded points [s], a multiple of the communication step; adaptive runs hit
              the points exactly; first and last are always recorded; default: every communication point
    bonds     power bonds as pairs of input names, whose energy error is watched; default: found from the
              units
    """

    signals: Sequence[str] | None = None
    step: float | None = None
    bonds: Sequence[tuple[str, str]] | None = None


@dataclass(frozen=True)
class Execution:
    """How a run is carried out.

    tolerance        relative tolerance handed to the FMUs
    error_estimate   run again at half and at twice the step, an adaptive run at a tenth of its tolerance, to
                     estimate the error of each signal at the recorded points
    progress         show a progress bar when the run takes longer than a second
    open             opens a component: an FMU, or any object with the methods of
                     `orchestrator.fmi.calls.Slave`
    """

    tolerance: float | None = None
    error_estimate: bool = False
    progress: bool = False
    open: Opener = open_slave


@dataclass
class Opened:
    """What a run works with once all FMUs are initialised; notes: on what its master does without."""

    network: Network
    recorder: Recorder
    energy: EnergyMonitor
    loop: SimulationLoop
    times: Grid
    notes: tuple[str, ...]


@dataclass
class Job:
    """One system and one way to run it, on any time grid."""

    system: System
    scenario: Scenario | None
    coupling: Coupling
    record: Record = Record()
    execution: Execution = Execution()

    def run(self, times: Grid) -> Result:
        """Open all FMUs, run, close them whatever happens."""
        with self.opened(times) as opened:
            began = time.perf_counter()
            try:
                self._go(opened)
            except KeyboardInterrupt:
                raise Interrupted(self._result(opened, began, False)) from None
            except Ended as wish:
                opened.notes += (f"the run ends early: {wish}",)
            except Problem as problem:
                raise RunFailed(problem, self._result(opened, began, False)) from problem
            return self._result(opened, began, True)

    def _go(self, opened: Opened) -> None:
        """From the start to the stop time."""
        loop, times = opened.loop, opened.times
        shown = ProgressBar(times.stop - times.start, self.execution.progress)
        with shown as bar, DeferredInterrupts() as interrupts:
            loop.look = interrupts.check
            loop.begin()
            while loop.state.done < times.steps:
                try:
                    loop.advance()
                except Problem:
                    opened.recorder.settle()  # a number that is not finite may be why a later step failed
                    raise
                bar.update(loop.state.t - times.start)

    @contextmanager
    def opened(self, times: Grid, recorder_type: type[Recorder] = Recorder) -> Iterator[Opened]:
        """All FMUs open and initialised, ready for the first step; closed at the end whatever happens."""
        signals = self.record.signals
        chosen = None if signals is None else [self.system.port(name) for name in signals]
        library()  # a Problem where there is none, before anything is opened
        _check_single(self.system)
        with ExitStack() as stack:
            slaves: dict[str, Slave] = {}
            for name, component in self.system.components.items():
                slaves[name] = self.execution.open(component)
                stack.callback(slaves[name].close)
            network = Network(self.system, slaves, self.scenario, chosen, self.coupling.factors)
            way = plan(self.system, self.coupling)
            inputs, prediction = CouplingInputs(network, way), None
            if way.prediction:
                prediction = LinearPrediction(network, inputs, way.prediction, way.order)
            driven = self.scenario.initial(self.system, times.start) if self.scenario else {}
            initialise(self.system, slaves, driven, (times.start, times.stop), self.execution.tolerance)
            energy = EnergyMonitor(network, inputs.moving, self._bonds(network))
            recorder = recorder_type(network, times, chosen)
            control = self._control(inputs, times)
            stack.callback(network.forget)
            loop = SimulationLoop(network, way, inputs, prediction, times, recorder, energy, control)
            stack.callback(loop.close)
            notes = (*way.notes, *self._stuck(), *inputs.notes, *(prediction.notes if prediction else ()))
            yield Opened(network, recorder, energy, loop, times, notes)

    def stricter(self) -> Job:
        """An adaptive run with a tenth of the tolerance."""
        c = self.coupling
        assert c.adaptive is not None
        passes = None if c.tolerance is None else c.tolerance / 10
        return replace(self, coupling=replace(c, adaptive=c.adaptive / 10, tolerance=passes))

    def _control(self, inputs: CouplingInputs, times: Grid) -> StepControl | None:
        """What chooses the steps of an adaptive run, or divides those of a guarded one."""
        c = self.coupling
        if c.adaptive is None:
            if not guarded(self.system, c):
                return None
            smallest = min(max(c.step_limits[0], times.least), times.step)
            return StepControl(times.step, smallest, times.step, c.guard_tolerance)
        if c.controls_energy and not inputs.bonds:
            wanted = "a power bond with inputs that may move on both sides"
            raise Problem(f"control of the energy: expected {wanted}, got none")
        faces = {name: component.interface for name, component in self.system.components.items()}
        if even := [name for name, face in faces.items() if not face.variable_step]:
            got = f"{', '.join(even)}: the FMU takes steps of one length only"
            raise Problem(f"adaptive steps: expected FMUs that vary their steps, got {got}")
        rolls = all(face.rollback for face in faces.values())
        first = times.first if rolls else CAUTIOUS * times.first
        smallest, largest = c.step_limits
        return StepControl(first, max(smallest, times.least), largest, c.adaptive, c.controls_energy, rolls)

    def _stuck(self) -> tuple[str, ...]:
        """A note on components whose adaptive steps stand."""
        names = [name for name, c in self.system.components.items() if not c.interface.rollback]
        if self.coupling.adaptive is None or not names:
            return ()
        return (
            f"adaptive steps with too large an error stand: {listed(names)} cannot go back to a saved state",
        )

    def _bonds(self, network: Network) -> list[Bond]:
        """The bonds that are asked for, or those over which energy goes: both inputs change something."""
        if self.record.bonds is None:
            found = find_bonds(self.system)
            return [b for b in found if network.matters(b.effort) and network.matters(b.flow)]
        return [named_bond(self.system, *pair) for pair in self.record.bonds]

    def _result(self, opened: Opened, began: float, complete: bool) -> Result:
        network, times, state = opened.network, opened.times, opened.loop.state
        logs = [s.log for s in network.slaves.values()]
        trace = opened.recorder.trace(list(self.system.outputs.values()))
        faces = {name: c.interface for name, c in self.system.components.items()}
        left_out = tuple(
            f"{name}: {face.unsupported_note}" for name, face in faces.items() if face.unsupported
        )
        reached = state.t - times.start
        card = Card(
            master=self.coupling.text,
            step=times.step if self.coupling.adaptive is None else reached / max(state.steps, 1),
            record_step=times.every * times.step if not times.free else 0.0,
            steps=state.steps,
            simulated=reached,
            passes=state.all_passes,
            repeated=state.repeated,
            lengths=(state.shortest, state.longest),
            adaptive=self.coupling.adaptive,
            wall=time.perf_counter() - began,
            bonds=tuple(opened.energy.energies()),
            warnings=tuple(line for log in logs for line in log.warnings(trace)),
            inside=opened.loop.busy,
            notes=self.system.notes + left_out + network.notes + times.notes + opened.notes,
        )
        messages = sorted((m for log in logs for m in log.messages), key=lambda m: m.time)
        return Result(self.system, trace, card, tuple(messages), complete, self.coupling)


def guarded(system: System, coupling: Coupling) -> bool:
    """Are steps divided where they would go wrong? All components must go back and vary their steps."""
    faces = [component.interface for component in system.components.values()]
    return coupling.guard_tolerance > 0 and all(face.rollback and face.variable_step for face in faces)


def _check_single(system: System) -> None:
    """Refuse two instances of an FMU that can have only one."""
    seen: dict[tuple[str, str], str] = {}
    for name, component in system.components.items():
        face = component.interface
        if face.one_per_process and (other := seen.setdefault((face.guid, face.identifier), name)) != name:
            raise Problem(f"{other} and {name}: expected one instance, their FMU can have no more, got two")


def estimated(job: Job, times: Grid, result: Result) -> Card:
    """The card of a complete run with error estimates; what happens to the other runs does not harm it."""
    if times.free:
        note = "no error estimate: two adaptive runs only meet at the points of a record step, give one"
        return replace(result.card, notes=(*result.card.notes, note))
    adaptive = job.coupling.adaptive is not None
    try:
        finer = (job.stricter(), times) if adaptive else (job, times.finer())
        fine, coarse = finer[0].run(finer[1]).trace, None
        if not adaptive and times.steps >= 4:
            with suppress(RunFailed):
                coarse = job.run(times.coarser()).trace
    except RunFailed as failed:
        which = "a tenth of the tolerance" if adaptive else "half the step"
        note = f"no error estimate, the run at {which} failed: {failed}"
        return replace(result.card, notes=(*result.card.notes, note))
    except Interrupted:
        raise Interrupted(result) from None
    nominals = {str(p): job.system.variable(p).nominal for p in job.system.ports("output")}
    shown = result.trace.select(name for name in nominals if name in result.trace.signals)
    errors = compare(fine, shown, coarse, nominals)
    remarks = () if errors else ("no error estimate: no output moves",)
    return replace(result.card, errors=errors, notes=(*result.card.notes, *remarks))
