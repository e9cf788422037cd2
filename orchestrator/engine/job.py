"""One run of a system, from opening to closing the FMUs."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from copy import copy
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Literal

from orchestrator.base.errors import Ended, Problem
from orchestrator.base.interrupts import DeferredInterrupts
from orchestrator.base.processes import machine_memory
from orchestrator.base.text import first_names
from orchestrator.data.trace_writer import PointSink, TraceSink
from orchestrator.engine.c_library import Allocate, Binding, bytearray_of, library
from orchestrator.engine.coupling_inputs import CouplingInputs
from orchestrator.engine.error_propagation import ErrorPropagation, EstimatedError
from orchestrator.engine.linear_prediction import LinearPrediction
from orchestrator.engine.masters import MASTERS
from orchestrator.engine.network import Network, initialise
from orchestrator.engine.recorder import BondEnergy, EnergyMonitor, Recorder
from orchestrator.engine.result import Card
from orchestrator.engine.scenario import Scenario
from orchestrator.engine.simulation_loop import SimulationLoop, StepControl
from orchestrator.engine.time_grid import Grid
from orchestrator.fmi.calls import Slave
from orchestrator.fmi.messages import WARNING, Log
from orchestrator.ssp.coupling import Coupling
from orchestrator.ssp.power_bonds import Bond, bond_of, find_bonds
from orchestrator.ssp.provenance import Provenance
from orchestrator.ssp.system import Component, System
from orchestrator.worker.process import WorkerLimits

ENDS_EARLY = "the run ends early: "  # begins the note on a run that an FMU asked to end
FIRST_FRACTION = 1e-3  # of the first adaptive step if it cannot be repeated, so that its error is small

FEWEST_STEPS = 2  # between two evaluations of the estimated errors

Opener = Callable[[Component], Slave]


def open_slave(component: Component) -> Slave:
    """Instantiate the FMU of a component for Co-Simulation."""
    if component.source is None:
        raise Problem(f"{component.name}: expected an FMU file, got none")
    from orchestrator.fmi.cosimulation import CoSimulationFmu

    return CoSimulationFmu(component.name, component.interface, component.source, component.start)


@dataclass(frozen=True)
class Record:
    """Selection of signals, points and power bonds to record.

    signals   names; default: all outputs, all connected inputs and all inputs of the system
    step      interval between recorded points [s], a multiple of the communication step; adaptive runs hit
              the points exactly; the first and the last point are always recorded; default: every
              communication point
    bonds     power bonds, as pairs of input names, whose energy error is recorded; default: those that follow
              from the units
    """

    signals: Sequence[str] | None = None
    step: float | None = None
    bonds: Sequence[tuple[str, str]] | None = None


@dataclass(frozen=True)
class Execution:
    """Options of `run` that do not change the system, by the same names.

    error_estimate   "fast": without a measurement that needs two steps of each FMU by `hermite` and
                     `interface-jacobian`
    time_limit       of all runs of a command together, see `begun`
    memory_limit     [GB]
    open             a function other than `open_slave` needs this process
    deadline         end of the time limit, by `time.monotonic` [s]
    """

    tolerance: float | None = None
    error_estimate: bool | Literal["fast"] = False
    accuracy: float | None = None
    accuracy_of: Sequence[str] = ()
    progress: bool = False
    isolate: bool = True
    time_limit: float = math.inf
    memory_limit: float = math.inf
    open: Opener = open_slave
    deadline: float = math.inf

    def begun(self) -> Execution:
        """These options from now on: the time limit ends all runs that follow."""
        time_limit, memory_limit = (
            math.inf if limit is None else limit for limit in (self.time_limit, self.memory_limit)
        )
        deadline = time.monotonic() + time_limit
        return replace(self, time_limit=time_limit, memory_limit=memory_limit, deadline=deadline)

    @property
    def late(self) -> bool:
        """Has the time limit passed?"""
        return time.monotonic() >= self.deadline

    @property
    def worker_limits(self) -> WorkerLimits:
        """The limits of a process; their time begins with the command."""
        memory = min(1e9 * self.memory_limit, machine_memory())
        return WorkerLimits(total_time=self.time_limit, memory=memory)

    @property
    def began(self) -> float:
        """When the command began, by `time.monotonic` [s]; of use only with a time limit."""
        return self.deadline - self.time_limit

    @property
    def isolated(self) -> bool:
        """Is the run in a process of its own?"""
        return self.isolate and self.open is open_slave

    def check(self) -> None:
        """Refuse options that have no effect, and limits that cannot be enforced."""
        if self.accuracy_of and self.accuracy is None:
            raise Problem(f"accuracy_of {self.accuracy_of[0]}: expected an accuracy, got none")
        if self.error_estimate not in (True, False, "fast"):
            raise Problem(f'error_estimate: expected True, False or "fast", got {self.error_estimate!r}')
        for name, limit in (("time_limit", self.time_limit), ("memory_limit", self.memory_limit)):
            if not limit > 0:
                raise Problem(f"{name}: expected a positive number, got {limit:g}")
            if limit < math.inf and not self.isolated:
                raise Problem(
                    f"{name}: expected a run in its own process, got one in the calling process "
                    "(isolate=False)"
                )


@dataclass
class OpenJob:
    """The objects of a run whose FMUs are initialised.

    errors   the estimate of errors during the run; None if there is none
    notes    remarks on its master
    """

    network: Network
    recorder: Recorder
    energy: EnergyMonitor
    loop: SimulationLoop
    times: Grid
    errors: ErrorPropagation | None
    notes: tuple[str, ...]


@dataclass
class RunEnd:
    """How a run ended, without its rows.

    t             simulated until this time [s]
    steps, ...    as in `Card`
    errors        estimated during the run, by output
    logs          messages of the FMUs
    notes         remarks on the run
    problem       why the run ended early; None if it is complete
    interrupted   the user ended it
    died          the process of the run has ended
    """

    t: float
    steps: int = 0
    passes: int = 0
    repeated: int = 0
    lengths: tuple[float, float] = (0.0, 0.0)
    wall: float = 0.0
    bonds: tuple[BondEnergy, ...] = ()
    errors: Mapping[str, EstimatedError] = field(default_factory=dict)
    inside: Mapping[str, float] = field(default_factory=dict)
    logs: tuple[Log, ...] = ()
    notes: tuple[str, ...] = ()
    problem: Problem | None = None
    interrupted: bool = False
    died: bool = False

    @property
    def complete(self) -> bool:
        """Did the run reach its stop time, or the time at which an FMU asked to end it?"""
        return self.problem is None and not self.interrupted


@dataclass
class Job:
    """A system and all choices for a run except the time grid; provenance: of its files and values."""

    system: System
    scenario: Scenario | None
    coupling: Coupling
    record: Record = Record()
    execution: Execution = Execution()
    provenance: Provenance = field(default_factory=Provenance)

    def run(
        self,
        times: Grid,
        sink: PointSink,
        between: Callable[[float], None] = lambda _: None,
        at_end: Callable[[RunEnd], None] = lambda _: None,
        allocate: Allocate = bytearray_of,
    ) -> RunEnd:
        """Open all FMUs, run in this process, and close them in any case.

        sink       receives the recorded rows and the estimated errors
        between    called with the time [s] between blocks of steps; a KeyboardInterrupt ends the run
        at_end     called before the FMUs are closed
        allocate   see `Binding`
        """
        with self.opened(times, sink, allocate) as opened:
            began = time.perf_counter()
            problem, interrupted = None, False
            try:
                self._step_to_end(opened, sink, between)
            except KeyboardInterrupt:
                interrupted = True
            except Ended as ended:
                opened.notes += (f"{ENDS_EARLY}{ended}",)
                self._record_end(opened, ended.reached)
            except Problem as raised:
                problem = raised
            opened.recorder.finish()
            if opened.errors:
                opened.errors.collect(sink)
            state, network = opened.loop.state, opened.network
            end = RunEnd(
                t=state.t,
                steps=state.steps,
                passes=state.all_passes,
                repeated=state.repeated,
                lengths=(state.shortest, state.longest),
                wall=time.perf_counter() - began,
                bonds=tuple(opened.energy.energies()),
                errors=opened.errors.errors() if opened.errors else {},
                inside=opened.loop.busy_seconds,
                logs=tuple(copy(s.log) for s in network.slaves.values()),
                notes=network.notes + times.notes + opened.notes,
                problem=problem,
                interrupted=interrupted,
            )
            at_end(end)
        return end

    def _step_to_end(self, opened: OpenJob, sink: PointSink, between: Callable[[float], None]) -> None:
        """Step from the start to the stop time."""
        loop = opened.loop
        with DeferredInterrupts() as interrupts:
            loop.begin()
            while loop.state.done < opened.times.steps:
                interrupts.check()
                try:
                    loop.advance()
                except Problem:
                    opened.recorder.collect()  # raises if a value is not finite: the cause of the failure
                    raise
                if opened.errors:
                    opened.errors.collect(sink)
                between(loop.state.t)

    def _record_end(self, opened: OpenJob, t: float) -> None:
        """Record the time [s] at which an FMU ended the run inside a step (FMI 2.0.5, 4.2.2: fmi2Terminated).

        In a system of several FMUs the others are not there, so its last row is the last communication point.
        """
        state = opened.loop.state
        if len(opened.network.slaves) == 1 and t > state.t:
            opened.recorder.collect()
            opened.recorder.end_at(t, self.scenario.initial(self.system, t) if self.scenario else {})
            state.t = t

    @contextmanager
    def opened(self, times: Grid, sink: PointSink, allocate: Allocate = bytearray_of) -> Iterator[OpenJob]:
        """Open and initialise all FMUs, ready for the first step; they are closed at the end in any case."""
        signals = self.record.signals
        selected = None if signals is None else [self.system.port(name) for name in signals]
        library()  # raises Problem if there is none, before any FMU is opened
        _check_instances(self.system)
        with ExitStack() as stack:
            slaves: dict[str, Slave] = {}
            binding = Binding(allocate)
            binding.call("environment_begin")
            stack.callback(binding.call, "environment_check")
            for name, component in self.system.components.items():
                slaves[name] = self.execution.open(component)
                stack.callback(slaves[name].close)
                _restore_environment(binding, slaves[name])
            network = Network(self.system, slaves, self.scenario, selected, self.coupling.factors, binding)
            plan = MASTERS[self.coupling.master](self.system, self.coupling)
            if self.execution.error_estimate:
                plan = plan.with_estimate(fast=self.execution.error_estimate == "fast")
            inputs, prediction = CouplingInputs(network, plan), None
            if plan.prediction:
                prediction = LinearPrediction(network, inputs, plan.prediction, plan.order)
            driven = self.scenario.initial(self.system, times.start) if self.scenario else {}
            span, restore = (times.start, times.stop), partial(_restore_environment, binding)
            tolerances = {n: self.execution.tolerance or s.interface.tolerance for n, s in slaves.items()}
            initialise(self.system, slaves, driven, span, tolerances, restore)
            binding.changed = partial(_warn_of_change, [*slaves.values()])
            energy = EnergyMonitor(network, inputs.varying, self._bonds(network))
            recorder = Recorder(network, times, sink, selected)
            control = self.control(inputs, times)
            stack.callback(network.free_saved_states)
            loop = SimulationLoop(network, plan, inputs, prediction, times, recorder, energy, control)
            errors = self._error_propagation(network, inputs, times)
            stack.callback(loop.close)
            notes = (
                *plan.notes,
                *self._rollback_notes(),
                *inputs.notes,
                *(prediction.notes if prediction else ()),
            )
            yield OpenJob(network, recorder, energy, loop, times, errors, notes)

    def _error_propagation(
        self, network: Network, inputs: CouplingInputs, times: Grid
    ) -> ErrorPropagation | None:
        """The estimate of errors during the run, filled; None if not wanted, or if an FMU prevents it."""
        if not self.execution.error_estimate:
            return None
        errors = ErrorPropagation(network, inputs, max(times.every, FEWEST_STEPS))
        if errors.missing:
            return None
        errors.fill(network.binding)
        return errors

    def card(self, times: Grid, end: RunEnd, sink: TraceSink) -> Card:
        """The accuracy card of a run that has ended."""
        adaptive, simulated = self.coupling.adaptive, end.t - times.start
        left_out = tuple(
            f"{name}: {c.interface.unsupported_note}"
            for name, c in self.system.components.items()
            if c.interface.unsupported
        )
        return Card(
            master=self.coupling.text,
            step=times.step if adaptive is None else simulated / max(end.steps, 1),
            record_step=times.every * times.step if not times.free else 0.0,
            steps=end.steps,
            simulated=simulated,
            passes=end.passes,
            repeated=end.repeated,
            lengths=end.lengths,
            adaptive=adaptive,
            wall=end.wall,
            bonds=end.bonds,
            warnings=(*self.system.warnings, *(line for log in end.logs for line in log.warnings(sink))),
            inside=end.inside,
            notes=self.system.notes + left_out + end.notes,
        )

    def stricter(self) -> Job:
        """The same adaptive run at a tenth of its tolerance."""
        c = self.coupling
        assert c.adaptive is not None
        tolerance = None if c.tolerance is None else c.tolerance / 10
        return replace(self, coupling=replace(c, adaptive=c.adaptive / 10, tolerance=tolerance))

    def control(self, inputs: CouplingInputs, times: Grid) -> StepControl | None:
        """Parameters of adaptive steps, or of the divided steps of a guarded run; None: equal steps."""
        c = self.coupling
        if c.adaptive is None:
            if not guarded(self.system, c):
                return None
            smallest = min(max(c.step_limits[0], times.shortest_step), times.step)
            return StepControl(times.step, smallest, times.step, c.guard_tolerance)
        if c.controls_energy and not inputs.bonds:
            expected = "a power bond with inputs that may vary on both sides"
            raise Problem(f"control of the energy: expected {expected}, got none")
        interfaces = {name: component.interface for name, component in self.system.components.items()}
        if fixed := [name for name, interface in interfaces.items() if not interface.variable_step]:
            got = f"{', '.join(fixed)}: the FMU has a fixed step"
            raise Problem(f"adaptive steps: expected FMUs with a variable step, got {got}")
        repeats = all(interface.rollback for interface in interfaces.values())
        first = times.first if repeats else FIRST_FRACTION * times.first
        smallest, largest = c.step_limits
        return StepControl(
            first, max(smallest, times.shortest_step), largest, c.adaptive, c.controls_energy, repeats
        )

    def _rollback_notes(self) -> tuple[str, ...]:
        """A note on components that prevent the repetition of adaptive steps."""
        names = [name for name, c in self.system.components.items() if not c.interface.rollback]
        if self.coupling.adaptive is None or not names:
            return ()
        cause = f"{first_names(names)} cannot restore a saved state"
        return (f"adaptive steps with too large an error are not repeated: {cause}",)

    def _bonds(self, network: Network) -> list[Bond]:
        """The requested bonds; default: those from units whose two inputs influence their components."""
        if self.record.bonds is None:
            influences = network.is_influential
            return [b for b in find_bonds(self.system) if influences(b.effort) and influences(b.flow)]
        return [bond_of(self.system, *pair) for pair in self.record.bonds]


def _restore_environment(binding: Binding, slave: Slave) -> None:
    """Restore the floating-point environment after calls of one FMU."""
    binding.changed = partial(_warn_of_change, [slave])
    binding.call("environment_check")


def _warn_of_change(slaves: Sequence[Slave], index: int) -> None:
    """Give a warning to the FMU that changed the floating-point environment; index -1: one of all."""
    first, *others = slaves if index < 0 else [slaves[index]]
    who = " or ".join(["the FMU", *(slave.name for slave in others)])
    text = f"{who} changed the floating-point environment (rounding, flushing to zero or traps), now restored"
    if all(message.text != text for message in first.log.messages):
        first.log.add(WARNING, text)


def guarded(system: System, coupling: Coupling) -> bool:
    """Are steps with too large an error divided? All components need rollback and steps of any length."""
    interfaces = [component.interface for component in system.components.values()]
    return coupling.guard_tolerance > 0 and all(i.rollback and i.variable_step for i in interfaces)


def _check_instances(system: System) -> None:
    """Refuse two instances of an FMU that can be instantiated only once per process."""
    single: dict[tuple[str, str], str] = {}
    for name, component in system.components.items():
        interface = component.interface
        if interface.one_per_process:
            other = single.setdefault((interface.guid, interface.identifier), name)
            if other != name:
                raise Problem(f"{other} and {name}: expected one instance of their FMU at most, got two")
