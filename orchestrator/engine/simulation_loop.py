"""The loop over communication steps: fills the C structures for it and runs it in blocks of recorded points.

native/simulation_loop.c has the loop, native/communication_step.c takes one communication step according to
the plan of the master.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from ctypes import c_double
from dataclasses import dataclass

import numpy as np

from orchestrator.engine.coupling_inputs import CouplingInputs
from orchestrator.engine.linear_prediction import LinearPrediction
from orchestrator.engine.masters import Plan
from orchestrator.engine.network import Network
from orchestrator.engine.recorder import EnergyMonitor, Recorder
from orchestrator.engine.time_grid import Grid

TIMED_STEPS = 20  # number of steps whose times decide about threads
MIN_SAVING = 2e-5  # [s] of wall time per step; with less, threads are not used: waking one takes about 5e-6 s
CORES = os.cpu_count() or 1  # number of threads for the components of one run, at most
ADVANCE_TIME = 0.1  # [s] of wall time that one call of `advance` takes, at most


@dataclass(frozen=True)
class StepControl:
    """Parameters of adaptive steps, whose length follows from their estimated error.

    first       first step to try [s]
    smallest    shortest step [s]; it is accepted with any error
    largest     longest step [s], except for the rounding of times: 1e-9 of it
    tolerance   of the error, relative to the magnitude of each signal; by_energy: to the power of each bond
    repeats     the components can go back to the beginning of a step
    """

    first: float
    smallest: float
    largest: float
    tolerance: float
    by_energy: bool = False
    repeats: bool = True


class SimulationLoop:
    """A run from its start to its end, in blocks of recorded points.

    state   `Simulation` of engine.h: time t [s], steps, passes, ...; a caller of `advance` may increase
            `total`
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
        """network: all FMUs are initialised; control: None if all steps are equal."""
        self._network, self._plan, self._inputs = network, plan, inputs
        self._recorder, self._control = recorder, control
        self._binding, self.state = network.binding, network.binding.simulation
        self._components = [*network.components.values()]
        self._threads_undecided = not plan.sequential and len(self._components) > 1
        self._fill_times(times)
        self._plan_rollback(times)
        network.fill()
        if driven := network.driven:
            driven.fill(self._binding, [inputs.ports.index(p) for p in driven.continuous])
        order = self._begin_prediction(prediction, times.start) if prediction else plan.order
        self._fill_plan(order, prediction)
        recorder.fill(self._binding)
        energy.fill(self._binding)
        self._binding.withdraw = self._withdraw_messages

    # ---- the run

    def begin(self) -> None:
        """Exchange all values at the start, and record them."""
        self._binding.call("simulation_begin")
        self._recorder.collect()

    def advance(self) -> None:
        """Step until a block of points or estimated errors is full, for ADVANCE_TIME, or to the end."""
        self._binding.call("simulation_advance")
        self._recorder.collect()
        if self._threads_undecided and self.state.steps >= TIMED_STEPS:
            self._decide_about_threads()

    def _decide_about_threads(self) -> None:
        """Use threads for the components if they save more time than they cost."""
        self._threads_undecided = False
        times = [c.busy_seconds / self.state.steps for c in self._components]
        if sum(times) - max(times) > MIN_SAVING and all(c.stepped_in_c for c in self._components):
            self.state.threads = min(CORES, len(times))

    def close(self) -> None:
        """End the threads and free saved states."""
        self._binding.call("simulation_close")
        self._network.free_saved_states()

    @property
    def busy_seconds(self) -> dict[str, float]:
        """Wall time in the steps of each component [s]."""
        return {name: component.busy_seconds for name, component in self._network.components.items()}

    def _withdraw_messages(self) -> None:
        """Withdraw messages and statuses of the FMUs in a step that is going to be repeated."""
        for slave in self._network.slaves.values():
            slave.log.time = self.state.t
            slave.after_rollback()

    # ---- structures for C

    def _fill_times(self, times: Grid) -> None:
        sim = self.state
        sim.start, sim.step, sim.t, sim.total = times.start, times.step, times.start, times.steps
        sim.free, sim.patience, sim.shortest = times.free, ADVANCE_TIME, np.inf
        sim.events, sim.event_count = self._binding.at(np.array(times.events, float)), len(times.events)
        if c := self._control:
            first = min(max(c.first, c.smallest), c.largest)
            limits = {"h": first, "smallest": c.smallest, "largest": c.largest, "repeats": c.repeats}
            struct = self._binding.h.StepSize(**limits, power=self._inputs.power)
            sim.step_size, sim.error_tolerance = self._binding.pointer(struct), c.tolerance
            sim.by_energy = c.by_energy

    def _plan_rollback(self, times: Grid) -> None:
        """Decide which components save their states or step in halves, and whether all can go back."""
        iterates = self._plan.passes > 1 and len(self._plan.repeated) > 0
        saves = iterates or (self._control is not None and self._control.repeats)
        for c in self._components:
            interface = c.slave.interface
            c.rollback = saves and interface.rollback
            c.fixed_step = 0.0 if interface.variable_step else times.step / c.substeps
            c.halved = self._plan.halves and c.substeps == 1 and interface.variable_step
        self.state.saves = saves
        self.state.rollback = all(c.rollback and not c.fixed_step for c in self._components)

    def _begin_prediction(self, prediction: LinearPrediction, t: float) -> list[int]:
        """Exchange all values, linearise the components; returns the order in which they step."""
        self._binding.call("simulation_exchange", c_double(t))
        order = prediction.begin()
        prediction.fill(self._binding)
        return order

    def _fill_plan(self, order: Sequence[int], prediction: LinearPrediction | None) -> None:
        """Fill the plan, the coupling inputs, and the calls between the steps of two components."""
        sim, plan, network, inputs = self.state, self._plan, self._network, self._inputs
        held = inputs.held(order) if plan.sequential else [[] for _ in order]
        for k, (name, component) in enumerate(network.components.items()):
            # of the last one no component uses the outputs in the same step
            last = prediction is not None and k == order[-1] and not component.halved
            component.held_inputs = network.copy_and_set_calls(held[k])
            reads_outputs = plan.sequential and not last
            component.output_reads = network.get_output_calls(name) if reads_outputs else []
            component.fill_inputs_and_outputs(self._binding)
            component.struct.repeated = k in plan.repeated
        at = self._binding.at
        sim.inputs = self._binding.pointer(inputs.array(self._binding))
        sim.input_count = len(inputs.inputs)
        sim.order, sim.has_stepped = at(np.array(order, np.int32)), at(np.zeros(len(order), np.uint8))
        sim.degree, sim.passes, sim.corrected = plan.degree, plan.passes, plan.corrected
        sim.sequential, sim.tolerance = plan.sequential, plan.tolerance
        sim.bonds, sim.bond_count = at(np.array(inputs.bonds, np.int32).reshape(-1)), len(inputs.bonds)
