"""One run of a system in this process: opening the FMUs, the loop over communication steps, closing them.

The loop runs in blocks of recorded points. native/simulation_loop.c has it, native/communication_step.c takes
one communication step according to the plan of the master.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from copy import copy
from ctypes import c_double
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orchestrator.base.errors import Ended, Problem
from orchestrator.base.files import archive_kept_open
from orchestrator.base.interrupts import DeferredInterrupts
from orchestrator.base.text import first_names
from orchestrator.data.trace_writer import TraceSink
from orchestrator.engine.c_library import Allocate, Binding, in_process, library
from orchestrator.engine.coupling_inputs import CouplingInputs
from orchestrator.engine.events import Instants
from orchestrator.engine.job import ENDS_EARLY, Job, guarded, open_slave
from orchestrator.engine.linear_system import ErrorPropagation, LinearPrediction
from orchestrator.engine.looks import Looks
from orchestrator.engine.network import Network, initialise
from orchestrator.engine.own_master import Components
from orchestrator.engine.recorder import EnergyMonitor, Recorder
from orchestrator.engine.result import Event, RunEnd
from orchestrator.engine.saved_run import asked, resume, save
from orchestrator.engine.saved_run import check as check_saved
from orchestrator.engine.time_grid import Grid
from orchestrator.fmi.calls import Slave
from orchestrator.fmi.cosimulation import RunningFmu
from orchestrator.ssp.dependencies import (
    divides_at_events,
    influential_events,
    late_notes,
    locates_events,
    uses_events,
)
from orchestrator.ssp.masters import plan_with_events
from orchestrator.ssp.power_bonds import Bond, bond_of, find_bonds
from orchestrator.ssp.system import Port, System

FIRST_FRACTION = 1e-3  # of the first adaptive step if it cannot be repeated, so that its error is small
FEWEST_STEPS = 2  # between two evaluations of the estimated errors


def run_job(
    job: Job,
    sink: TraceSink,
    between: Callable[[float], bool] = lambda _: False,
    at_end: Callable[[RunEnd], None] = lambda _: None,
    allocate: Allocate = in_process,
    cores: int | None = None,
) -> RunEnd:
    """Open all FMUs, run in this process, and close them in any case.

    sink       receives the recorded rows and the estimated errors
    between    called with the time [s] between blocks of steps; returns True to end the run
    at_end     called before the FMUs are closed
    allocate   see `Binding`
    cores      for the components, at most; None: all
    """
    with simulation(job, sink, allocate) as loop:
        loop.cores = cores or CORES
        if resumed := job.options.resume:
            loop.begin(resumed=True)
            resume(Path(resumed), job, loop)
            of_part = f"rows and wall time are those from t = {loop.state.t:.9g} s on, the state in {resumed}"
            loop.notes += (of_part,)
        began = time.perf_counter()
        problem, interrupted = None, False
        try:
            _step_to_end(job, loop, sink, between)
        except KeyboardInterrupt:
            interrupted = True
        except Ended as ended:
            loop.notes += (f"{ENDS_EARLY}{ended}",)
            _record_end(job, loop, ended.reached)
        except Problem as raised:
            problem = raised
        loop.recorder.finish()
        if loop.errors:
            loop.errors.collect(sink)
        if job.options.accuracy is None:  # which compares runs
            loop.notes += loop.looks.notes
        if loop.state.pause < np.inf:
            loop.notes += (f"no state is saved: the run ended before t = {loop.state.pause:.9g} s",)
        state, network = loop.state, loop.network
        end = RunEnd(
            t=state.t,
            steps=state.steps,
            passes=state.all_passes,
            repeated=state.repeated,
            lengths=(state.shortest, state.longest),
            wall=time.perf_counter() - began,
            bonds=tuple(loop.energy.energies()),
            errors=loop.errors.errors() if loop.errors else {},
            inside=loop.inside,
            unseen=loop.looks.found(state.t - job.times.start),
            events=loop.events,
            texts=tuple(network.texts.changes),
            logs=tuple(copy(s.log) for s in network.slaves.values()),
            notes=network.notes + job.times.notes + loop.notes + loop.late_notes + loop.recorder.notes,
            problem=problem,
            interrupted=interrupted,
        )
        at_end(end)
    return end


def _step_to_end(job: Job, loop: SimulationLoop, sink: TraceSink, between: Callable[[float], bool]) -> None:
    """Step from the start to the stop time."""
    with DeferredInterrupts() as interrupts:
        state = loop.state
        if not job.options.resume:
            loop.begin()
        saved = asked(job.options, job.times)
        state.pause = saved[1] if saved else np.inf
        while state.done < state.total:
            interrupts.check()
            try:
                loop.advance()
            except Problem:
                loop.recorder.collect()  # raises if a value is not finite: the cause of the failure
                raise
            if loop.errors:
                loop.errors.collect(sink)
            if state.t >= state.pause and saved:
                save(saved[0], job, loop)
                loop.notes += (f"the state at t = {state.t:.9g} s is in {saved[0]}",)
                state.pause = np.inf
            if between(state.t):
                state.total = state.done


def _record_end(job: Job, loop: SimulationLoop, t: float) -> None:
    """Record the time [s] at which an FMU ended the run inside a step (FMI 2.0.5, 4.2.2: fmi2Terminated).

    In a system of several FMUs the others are not there, so its last row is the last communication point.
    """
    t = float(loop.times.aligned(np.array([t]))[0])
    if len(loop.network.slaves) == 1 and t > loop.state.t:
        loop.recorder.collect()
        loop.recorder.end_at(t, job.scenario.initial(job.system, t) if job.scenario else {})
        loop.state.t = t


@contextmanager
def simulation(job: Job, sink: TraceSink, allocate: Allocate = in_process) -> Iterator[SimulationLoop]:
    """Open and initialise all FMUs, ready for the first step; they are closed at the end in any case."""
    signals = job.signals
    selected = None if signals is None else [job.system.port(name) for name in signals]
    for port in selected or ():
        if not (variable := job.system.variable(port)).is_number:
            raise Problem(
                f"record {port}: expected a number, got a {variable.kind}, of which changes are told"
            )
    library()  # raises Problem if there is none, before any FMU is opened
    _check_instances(job.system)
    events, located = uses_events(job.system, job.coupling), locates_events(job.system, job.coupling)
    divides = divides_at_events(job.system)
    with ExitStack() as stack:
        slaves: dict[str, Slave] = {}
        binding = Binding(allocate)
        stack.callback(binding.restore_environment)
        with archive_kept_open():
            for name, component in job.system.components.items():
                face = component.interface
                own = bool(job.coupling.method.step)
                if face.event_mode and not (events and (located or divides or own or face.has_clocks)):
                    component = replace(component, interface=replace(face, event_mode=False))
                slaves[name] = slave = (job.options.open or open_slave)(component)
                stack.callback(slave.close)
                binding.restore_environment(slave)
                if isinstance(slave, RunningFmu):
                    slave.fmu.after = binding.restore_environment
        factors = job.coupling.factors
        network = Network(job.system, slaves, job.scenario, selected, factors, binding, events)
        stack.callback(network.free_saved_states)
        loop = SimulationLoop(job, network, sink, selected)
        stack.callback(loop.close)
        yield loop


def step_control(job: Job) -> StepControl | None:
    """Parameters of adaptive steps, or of the divided steps of a guarded run; None: equal steps."""
    c, times = job.coupling, job.times
    if c.adaptive is None:
        if not guarded(job.system, c):
            return None
        smallest = min(max(c.step_limits[0], times.shortest_step), times.step)
        return StepControl(times.step, smallest, times.step, c.guard_tolerance)
    interfaces = {name: component.interface for name, component in job.system.components.items()}
    if fixed := [name for name, interface in interfaces.items() if not interface.variable_step]:
        got = f"{', '.join(fixed)}: the FMU has a fixed step"
        raise Problem(f"adaptive steps: expected FMUs with a variable step, got {got}")
    repeats = all(interface.rollback for interface in interfaces.values())
    first, (smallest, largest) = times.first if repeats else FIRST_FRACTION * times.first, c.step_limits
    smallest = max(smallest, times.shortest_step)
    return StepControl(first, smallest, largest, c.adaptive, repeats)


def _rollback_notes(job: Job) -> tuple[str, ...]:
    """A note on components that prevent the repetition of adaptive steps."""
    names = [name for name, c in job.system.components.items() if not c.interface.rollback]
    if job.coupling.adaptive is None or not names:
        return ()
    cause = f"{first_names(names)} cannot restore a saved state"
    return (f"adaptive steps with too large an error are not repeated: {cause}",)


def bonds_of(job: Job, network: Network) -> list[Bond]:
    """The requested bonds; default: those from units whose two inputs influence their components."""
    bonds = job.options.bonds
    if bonds is None:
        influences = network.is_influential
        return [b for b in find_bonds(job.system) if influences(b.effort) and influences(b.flow)]
    return [bond_of(job.system, *pair) for pair in bonds]


def _check_instances(system: System) -> None:
    """Refuse two instances of an FMU that can be instantiated only once per process."""
    single: dict[tuple[str, str], str] = {}
    for name, component in system.components.items():
        interface = component.interface
        if interface.one_per_process:
            other = single.setdefault((interface.model.token, interface.identifier), name)
            if other != name:
                raise Problem(f"{other} and {name}: expected one instance of their FMU at most, got two")


TIMED_STEPS = 20  # number of steps whose times decide about threads
MIN_SAVING = 2e-5  # [s] of wall time per step; with less, threads are not used: waking one takes about 5e-6 s
CORES = os.cpu_count() or 1  # default number of threads for the components of one run, at most
ADVANCE_TIME = 0.1  # [s] of wall time that one call of `advance` takes, at most


@dataclass(frozen=True)
class StepControl:
    """Parameters of adaptive steps, whose length follows from their estimated error.

    first       first step to try [s]
    smallest    shortest step [s]; it is accepted with any error
    largest     longest step [s], except for the rounding of times: 1e-9 of it
    tolerance   of the error, relative to the magnitude of each signal
    repeats     the components can go back to the beginning of a step
    """

    first: float
    smallest: float
    largest: float
    tolerance: float
    repeats: bool = True

    def struct(self, h: Any, power: int) -> Any:
        """`StepSize` of the header `h`; power: of the step to which the error is proportional."""
        first = min(max(self.first, self.smallest), self.largest)
        limits = {"h": first, "first": first, "smallest": self.smallest, "largest": self.largest}
        return h.StepSize(**limits, repeats=self.repeats, power=power)


class SimulationLoop:
    """A run whose FMUs it initialises, from its start to its end, in blocks of recorded points.

    state    `Simulation` of engine.h: time t [s], steps, passes, ...; a caller of `advance` may increase
             `total`
    errors   the estimate of errors during the run; None if there is none
    cores    number of threads for the components, at most
    notes    remarks on its master
    """

    errors: ErrorPropagation | None = None
    cores = CORES

    def __init__(self, job: Job, network: Network, sink: TraceSink, selected: Sequence[Port] | None) -> None:
        """selected: the recorded signals; None: all."""
        of_state = check_saved(job)
        self.network, self.times = network, job.times
        self._binding, self.state = network.binding, network.binding.simulation
        master = job.coupling.method
        estimate, plan = job.options.error_estimate, master.planned(job.system, job.coupling)
        if influential_events(job.system):  # the estimate is one of a linear system
            estimate = False
        plan = plan.with_estimate(fast=estimate == "fast") if estimate else plan
        if network.with_events and len(network.components) > 1:
            plan = plan_with_events(plan, job.system)
        self._plan = plan
        if master.step:
            network.binding.master = partial(Components(network).over, master)
            self.state.in_python = True
        self._inputs = inputs = CouplingInputs(network, plan)
        prediction = LinearPrediction(network, inputs, plan, plan.prediction) if plan.prediction else None
        self._initialise(job)
        self.energy = EnergyMonitor(network, inputs.varying, bonds_of(job, network))
        self.recorder = Recorder(network, job.times, sink, selected)
        self._control = step_control(job)
        self._components = [*network.components.values()]
        self._threads_undecided = not (plan.sequential or master.step) and len(self._components) > 1
        self._instants = Instants(network, inputs, job, sink) if network.with_events else None
        self.looks = Looks(network, looked=not (network.with_events or master.step))
        self._fill(prediction)
        if estimate and not master.step:
            errors = ErrorPropagation(network, inputs, max(job.times.every, FEWEST_STEPS))
            if not errors.missing:
                errors.fill(self._binding)
                self.errors = errors
        self.notes = (*of_state, *late_notes(job.system, job.coupling), *plan.notes, *_rollback_notes(job))
        self.notes += (*inputs.notes, *(prediction.notes if prediction else ()))

    def _initialise(self, job: Job) -> None:
        """Initialise all FMUs."""
        slaves, times = self.network.slaves, self.times
        driven = job.scenario.initial(job.system, times.start) if job.scenario else {}
        tolerances = {n: job.options.tolerance or s.interface.tolerance for n, s in slaves.items()}
        stop = max(map(times.announced_stop, (1, *job.coupling.factors.values())))
        if job.options.save_state:  # an FMU may keep it with its state
            stop = np.inf
        initialise(job.system, slaves, driven, (times.start, stop), tolerances)
        self._binding.logs = [slave.log for slave in slaves.values()]

    @property
    def inside(self) -> dict[str, float]:
        """Wall time in the steps of each component [s]; empty if Python takes the steps."""
        components = {} if self.state.in_python else self.network.components
        return {name: c.struct.busy * self.state.tick for name, c in components.items()}

    @property
    def events(self) -> tuple[Event, ...]:
        """The events so far, by time."""
        inside = {name: getattr(slave, "happened", ()) for name, slave in self.network.slaves.items()}
        found = [Event(t, (name,)) for name, times in inside.items() for t in times]
        found += self._instants.happened if self._instants else ()
        return tuple(sorted(found, key=lambda event: event.time))

    @property
    def late_notes(self) -> tuple[str, ...]:
        """Notes on the events so far that did not act at their times."""
        return self._instants.notes if self._instants else ()

    # ---- the run

    def begin(self, resumed: bool = False) -> None:
        """Exchange all values at the start, and record them; resumed: a saved run goes on instead."""
        ended = None
        if self._instants:
            try:
                self._instants.begin()
            except Ended as raised:  # after the row of the start
                ended = raised
        self._binding.call("simulation_begin")
        if not resumed:
            self.recorder.collect()
        if ended:
            raise ended

    def saved(self) -> dict[str, Any]:
        """What a saved state has of the loop besides its memory."""
        texts = [[str(port), text] for port, text in self.network.texts.last.items()]
        events = self._instants.saved() if self._instants else []
        return {"t": self.state.t, "events": events, "texts": texts, "changes": self.network.texts.changes}

    def restore(self, memory: Sequence[NDArray[Any]], saved: Mapping[str, Any]) -> None:
        """Go on from a saved state; `resume` follows when its FMUs have theirs."""
        parts = self._binding.memory()
        if [part.nbytes for part in parts] != [part.nbytes for part in memory]:
            raise Problem(
                f"expected the memory of the saved run, {len(memory)} arrays, got {len(parts)} others"
            )
        for part, content in zip(parts, memory, strict=True):
            part[:] = content.view(part.dtype)
        texts, system = self.network.texts, self.network.system
        texts.last = {system.port(name): text for name, text in saved["texts"]}
        texts.changes = [(t, name, text) for t, name, text in saved["changes"]]
        if self._instants:
            self._instants.resume(saved["events"])
        if self.times.free:  # the only point of the grid is the stop time, which may be another one
            self.state.done, self.state.step = 0, self.times.step

    def resume(self) -> None:
        """After `restore` of all: inputs jump where another scenario has other values; the first row."""
        self._binding.call("simulation_resume")
        self.recorder.resume()

    def advance(self) -> None:
        """Step until a block of points or estimated errors is full, for ADVANCE_TIME, or to the end."""
        self._binding.call("simulation_advance")
        self.recorder.collect()
        if self._threads_undecided and self.state.steps >= TIMED_STEPS:
            self._decide_about_threads()

    def _decide_about_threads(self) -> None:
        """Use threads for the components if they save more time than they cost."""
        self._threads_undecided = False
        times = [c.struct.busy * self.state.tick / self.state.steps for c in self._components]
        if sum(times) - max(times) > MIN_SAVING and all(c.stepping for c in self._components):
            self.state.threads = min(self.cores, len(times))

    def close(self) -> None:
        """End the threads and free saved states."""
        self._binding.call("simulation_close")
        self._binding.components = ()
        self.network.free_saved_states()

    def _withdraw_messages(self) -> None:
        """Withdraw messages and statuses of the FMUs in a step that is going to be repeated."""
        for slave in self.network.slaves.values():
            slave.log.time = self.state.t
            slave.after_rollback()
        self.network.texts.withdraw(self.state.t)

    # ---- structures for C

    def _fill(self, prediction: LinearPrediction | None) -> None:
        """Fill all structures but that of the errors."""
        binding, network, order = self._binding, self.network, self._plan.order
        self._fill_times(self.times)
        self._plan_rollback()
        network.fill()
        self.state.careful = self.state.in_python or not all(c.stepping for c in self._components)
        if driven := network.driven:
            driven.fill(binding, [self._inputs.ports.index(p) for p in driven.continuous])
        if prediction:
            binding.call("simulation_exchange", c_double(self.times.start))
            order = prediction.begin()
            if self._instants and self._plan.prediction:
                leading = order[: self._plan.prediction.leading_count]
                last = [k for k in self._plan.order if self._components[k].struct.events and k not in leading]
                order = [*(k for k in order if k not in last), *last]
            prediction.fill(binding)
        self._fill_plan(order, prediction)
        self.recorder.fill(binding)
        self.energy.fill(binding)
        self.looks.fill(binding)
        if self._instants:
            self._instants.fill()
            binding.instant, binding.inside = self._instants, self._instants.inside
        binding.withdraw = self._withdraw_messages

    def _fill_times(self, times: Grid) -> None:
        sim = self.state
        sim.start, sim.step, sim.t, sim.total = times.start, times.step, times.start, times.steps
        sim.free, sim.patience, sim.shortest = times.free, ADVANCE_TIME, np.inf
        sim.divided, sim.divided_count = self._binding.constant(np.array(times.divided)), len(times.divided)
        sim.pause = np.inf
        if c := self._control:
            sim.step_size = self._binding.pointer(c.struct(self._binding.h, self._inputs.power))
            sim.error_tolerance = c.tolerance

    def _plan_rollback(self) -> None:
        """Decide which components save their states or step in halves, and whether all can go back."""
        iterates = self._plan.passes > 1 and len(self._plan.repeated) > 0
        repeats = self._control is not None and self._control.repeats
        saves = iterates or repeats or self._instants is not None
        pairs = [(c, c.slave.interface) for c in self._components]
        for c, interface in pairs:
            c.struct.rollback = interface.rollback and (saves or c.slave.name in self.looks.go_back)
            c.struct.halved = self._plan.halves and c.struct.substeps == 1 and interface.variable_step
        self.state.saves = saves
        self.state.rollback = saves and all(c.struct.rollback and i.variable_step for c, i in pairs)

    def _fill_plan(self, order: Sequence[int], prediction: LinearPrediction | None) -> None:
        """Fill the plan, the coupling inputs, and the calls between the steps of two components."""
        sim, plan, network, inputs = self.state, self._plan, self.network, self._inputs
        held = inputs.held(order) if plan.sequential and not plan.parallel else [[] for _ in order]
        for k, (name, component) in enumerate(network.components.items()):
            # of the last one no component uses the outputs in the same step
            last = prediction is not None and k == order[-1] and not component.struct.halved
            component.held_inputs = network.copy_and_set_calls(held[k])
            reads_outputs = plan.sequential and not last
            read = network.connected_outputs(name) if reads_outputs else set()
            component.output_reads = network.get_calls(read)
            # without feed-through outputs are the same before these inputs are set exactly: FMI 2.0, 4.2.4
            direct = (u for y in read for u in component.slave.interface.direct_inputs(y.variable))
            wide = component.simplified
            needed = wide if component.slope_reads else wide.intersection(direct)
            component.struct.simplifies_inputs = len(needed) > 0
            component.fill_inputs_and_outputs(self._binding)
            component.struct.repeated = k in plan.repeated
        at = self._binding.at
        sim.inputs = self._binding.pointer(inputs.array(self._binding))
        sim.input_count = len(inputs.inputs)
        sim.order, sim.has_stepped = at(np.array(order, np.int32)), at(np.zeros(len(order), np.uint8))
        sim.degree, sim.passes = plan.degree, plan.passes
        sim.sequential, sim.tolerance, sim.parallel = plan.sequential, plan.tolerance, plan.parallel
