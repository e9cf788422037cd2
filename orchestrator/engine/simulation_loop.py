"""A run in progress: what the loop in C works with, and blocks of its steps.

native/simulation_loop.c goes from communication point to communication point, native/communication_step.c
takes one communication step as the plan of the master says.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Sequence
from ctypes import c_double
from dataclasses import dataclass
from types import TracebackType
from typing import Any

import numpy as np

from orchestrator.engine.coupling_inputs import CouplingInputs
from orchestrator.engine.linear_prediction import LinearPrediction
from orchestrator.engine.masters import Plan
from orchestrator.engine.network import Network
from orchestrator.engine.recorder import EnergyMonitor, Recorder
from orchestrator.engine.time_grid import Grid

SAMPLE = 20  # steps after which it is known what the components cost
WORTH = 2e-5  # [s] per step: less than that is not worth waking threads, which takes some 5e-6 s
CORES = os.cpu_count() or 1  # for the components of one run
PATIENCE = 0.1  # [s], the longest time between two looks for an interrupt


@dataclass(frozen=True)
class StepControl:
    """How steps follow from their estimated error.

    first       step to try first [s]
    smallest    a step is not made shorter than this [s]; an error above the tolerance then stands
    largest     nor longer than this [s], but for the rounding of times: a share of 1e-9
    tolerance   of the error, a share of the magnitude of each signal; by_energy: of the power of each bond
    repeats     the components can go back
    """

    first: float
    smallest: float
    largest: float
    tolerance: float
    by_energy: bool = False
    repeats: bool = True


class SimulationLoop:
    """A run from its start to its end, in blocks of recorded points.

    state   `Simulation` of engine.h: time t [s], steps, passes, ...; who looks in between may raise `total`
    look    called between blocks; ends the run if the user wants that
    """

    def __init__(
        self,
        network: Network,
        plan: Plan,
        inputs: CouplingInputs,
        prediction: LinearPrediction | None,
        times: Grid,
        recorder: Recorder,
        energy: EnergyMonitor,
        control: StepControl | None = None,
    ) -> None:
        """All FMUs are initialised; control: None where all steps are equal."""
        self._network, self._plan, self._inputs = network, plan, inputs
        self._recorder, self._control = recorder, control
        self._binding, self.state = network.binding, network.binding.simulation
        self._components = [*network.components.values()]
        self.look: Callable[[], None] = lambda: None
        self._decides = not plan.sequential and len(self._components) > 1
        self._fill_times(times)
        self._plan_rollback(times)
        network.fill()
        if network.scenario:
            network.scenario.fill(self._binding, [inputs.ports.index(p) for p in network.scenario.moving])
        order = self._begin_prediction(prediction, times.start) if prediction else plan.order
        self._fill_plan(order, prediction)
        for part in (recorder, energy):
            part.fill(self._binding)
        self._binding.withdraw = self._withdraw

    # ---- the run

    def begin(self) -> None:
        """Make everything known at the start, and record it."""
        self._binding.call("simulation_begin")
        self._recorder.settle()

    def advance(self) -> None:
        """Go on until as many points are recorded as fit into a block, for PATIENCE, or to the end."""
        self.look()
        self._binding.call("simulation_advance")
        self._recorder.settle()
        if self._decides and self.state.steps >= SAMPLE:
            self._use_threads()

    def _use_threads(self) -> None:
        """Let the components step at the same time if that saves more than it costs."""
        self._decides = False
        each = [c.busy / self.state.steps for c in self._components]
        if sum(each) - max(each) > WORTH and all(c.in_c for c in self._components):
            self.state.threads = min(CORES, len(each))

    def close(self) -> None:
        """End the threads, free the states that were saved."""
        self._binding.call("simulation_close")
        self._network.forget()

    @property
    def busy(self) -> dict[str, float]:
        """Time in the steps of each component [s]."""
        return {name: component.busy for name, component in self._network.components.items()}

    def _withdraw(self) -> None:
        """Forget what the FMUs said and returned in the step that is going to be repeated."""
        for slave in self._network.slaves.values():
            slave.log.time = self.state.t
            slave.after_rollback()

    # ---- what C works with

    def _fill_times(self, times: Grid) -> None:
        sim = self.state
        sim.start, sim.step, sim.t, sim.total = times.start, times.step, times.start, times.steps
        sim.free, sim.patience, sim.shortest = times.free, PATIENCE, np.inf
        sim.events, sim.event_count = self._binding.at(np.array(times.events, float)), len(times.events)
        if c := self._control:
            first = min(max(c.first, c.smallest), c.largest)
            size = {"h": first, "smallest": c.smallest, "largest": c.largest, "repeats": c.repeats}
            made = self._binding.h.StepSize(**size, power=self._inputs.power)
            sim.step_size, sim.error_tolerance = self._binding.pointer(made), c.tolerance
            sim.by_energy = c.by_energy

    def _plan_rollback(self, times: Grid) -> None:
        """Which components have to go back, and whether all can."""
        iterates = self._plan.passes > 1 and len(self._plan.repeated) > 0
        saves = iterates or (self._control is not None and self._control.repeats)
        for c in self._components:
            face = c.slave.interface
            c.rollback = saves and face.rollback
            c.even = 0.0 if face.variable_step else times.step / c.factor
        self.state.saves = saves
        self.state.rollback = all(c.rollback and not c.even for c in self._components)

    def _begin_prediction(self, prediction: LinearPrediction, t: float) -> list[int]:
        """Linearise the components, with their outputs up to date; returns the order in which they step."""
        self._binding.call("simulation_exchange", c_double(t))
        order = prediction.begin()
        prediction.fill(self._binding)
        return order

    def _fill_plan(self, order: Sequence[int], prediction: LinearPrediction | None) -> None:
        """The plan, and what components exchange when they step one by one."""
        sim, plan, network, inputs = self.state, self._plan, self._network, self._inputs
        held = inputs.held(order) if plan.sequential else [[] for _ in order]
        for k, (name, component) in enumerate(network.components.items()):
            last = prediction is not None and k == order[-1]  # nobody waits for it
            component.held_inputs = network.input_writes(held[k])
            component.output_reads = network.output_reads(name) if plan.sequential and not last else []
            component.fill_calls(self._binding)
            component.made.repeated = k in plan.repeated
        at = self._binding.at
        sim.inputs = self._binding.pointer(inputs.array(self._binding))
        sim.input_count, sim.slopes = len(inputs.inputs), at(inputs.slopes)
        sim.order, sim.has_stepped = at(np.array(order, np.int32)), at(np.zeros(len(order), np.uint8))
        sim.degree, sim.passes, sim.corrected = plan.degree, plan.passes, plan.corrected
        sim.sequential, sim.tolerance = plan.sequential, plan.tolerance
        sim.bonds, sim.bond_count = at(np.array(inputs.bonds, np.int32).reshape(-1)), len(inputs.bonds)


class ProgressBar:
    """Shows how much of `total` [s] is simulated; silent when not wanted or when the run is short."""

    shown_after = 1.0  # [s]

    def __init__(self, total: float, wanted: bool) -> None:
        self._total, self._wanted = total, wanted
        self._began = time.perf_counter()
        self._bar: Any = None
        self._task: Any = None

    def __enter__(self) -> ProgressBar:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None
    ) -> None:
        if self._bar is not None:
            self._bar.stop()

    def update(self, done: float) -> None:
        """`done` [s] are simulated now."""
        if not self._wanted or (self._bar is None and time.perf_counter() - self._began < self.shown_after):
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
