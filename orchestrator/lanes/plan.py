"""The plan of machines in lanes: how the models of a system are coupled, for native/group.cpp.

The machines of a group meet at communication points, and step by the plan of the engine's master. What lanes
do not have raises `NotInLanes`: other FMUs than native ones, algebraic loops, the master interface-jacobian.
"""

import ctypes
from collections.abc import Collection, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from typing import Any

import numpy as np

from orchestrator.base.processes import available_cores
from orchestrator.engine.c_library import engine_h
from orchestrator.engine.coupling_inputs import CouplingInputs
from orchestrator.engine.job import Job
from orchestrator.engine.masters import MASTERS, Plan
from orchestrator.engine.network import Network
from orchestrator.engine.open_job import step_control
from orchestrator.engine.time_grid import Grid
from orchestrator.lanes.compiled import NotInLanes, compiled_model, header, lane_count
from orchestrator.ssp.system import Connection, Port, System

MASTERS_IN_LANES = ("jacobi", "gauss-seidel", "hermite")
DRIVEN = -1  # in place of the source of an input that the scenario drives


class Lanes:
    """A system in lanes: its models, and the plan of all groups of machines.

    job       the run of one machine
    signals   recorded variables
    models    compiled, by component; index: component -> its number
    plan      `Plan` of group.h
    """

    def __init__(self, job: Job, times: Grid, signals: Sequence[Port]) -> None:
        """Raises NotInLanes if the system or its coupling is not supported."""
        self.job, self.system, self.times, self.signals = job, job.system, times, signals
        _check_coupling(job, times)
        with ThreadPoolExecutor(available_cores()) as threads:  # several compilers at once
            self.models = list(threads.map(compiled_model, self.system.components.values()))
        self.index = {name: k for k, name in enumerate(self.system.components)}
        self._alive: list[Any] = []
        with ExitStack() as stack:
            slaves = {}
            for name, component in self.system.components.items():
                slaves[name] = job.execution.open(component)
                stack.callback(slaves[name].close)
            self._network = Network(self.system, slaves, job.scenario, signals)
            self._plan = MASTERS[job.coupling.master](self.system, job.coupling)
            self._inputs = CouplingInputs(self._network, self._plan)
            self._control = step_control(job, self._inputs, times)
            self.plan = self._filled()

    def reference(self, port: Port) -> int:
        """The value reference of a variable."""
        return self.models[self.index[port.component]].names[port.variable]

    def step_sizes(self) -> Any:
        """The control of the steps of each machine of a new group; None: equal steps."""
        if (c := self._control) is None:
            return None
        first = min(max(c.first, c.smallest), c.largest)
        limits = {"h": first, "smallest": c.smallest, "largest": c.largest, "repeats": 1}
        struct = engine_h().StepSize(**limits, power=self._inputs.power)
        return (engine_h().StepSize * lane_count())(*[struct] * lane_count())

    # ---- structures

    def _array(self, kind: Any, values: Sequence[Any]) -> int:
        """The address of a C array."""
        array = (kind * max(len(values), 1))(*values)
        self._alive.append(array)
        return ctypes.addressof(array)

    def _numbers(self, values: Any, dtype: Any = np.int32) -> int:
        array = np.ascontiguousarray(values, dtype)
        self._alive.append(array)
        return array.ctypes.data

    def _filled(self) -> Any:
        h, plan, count = header(), self._plan, len(self.models)
        program, ordered = self._exchange()
        inputs = self._coupling_inputs()
        held = self._inputs.held(plan.order) if plan.sequential else [[] for _ in range(count)]
        used = {s.source_component for s in self._inputs.inputs} if plan.needs_slopes else set()
        signals = [h.Signal(self.index[p.component], self.reference(p)) for p in self.signals]
        components = [self.index[port.component] for port in self._inputs.ports]
        return h.Plan(
            models=self._numbers([ctypes.addressof(m.struct) for m in self.models], np.uint64),
            inputs=self._array(h.Input, inputs),
            connections=self._array(h.Connection, ordered),
            held=self._array(h.Connection, [self._connection(c) for group in held for c in group]),
            exchange=self._array(h.Instruction, program),
            order=self._numbers(plan.order),
            first_input=self._numbers(np.searchsorted(components, range(count + 1))),
            first_held=self._numbers(np.cumsum([0, *map(len, held)])),
            repeated=self._numbers([k in plan.repeated for k in range(count)]),
            needs_slopes=self._numbers([k in used for k in range(count)]),
            signals=self._array(h.Signal, signals),
            events=self._numbers(self.times.events, np.float64),
            event_count=len(self.times.events),
            start=self.times.start,
            step=self.times.step,
            steps=self.times.steps,
            every=self.times.every,
            pass_tolerance=plan.tolerance,
            component_count=count,
            input_count=len(inputs),
            connection_count=len(ordered),
            exchange_count=len(program),
            signal_count=len(signals),
            degree=plan.degree,
            sequential=plan.sequential,
            passes=plan.passes,
            initial_rounds=self._network.order.count + 1,
            adaptive=self._control is not None,
            guard=self._control.tolerance if self._control else 0.0,
            **self._scenario(),
        )

    def _connection(self, c: Connection, checked: bool = False) -> Any:
        ends = self.index[c.source.component], self.reference(c.source), *self._input(c.target)
        return header().Connection(*ends, c.map.factor, c.map.offset, checked)

    def _input(self, port: Port) -> tuple[int, int]:
        """The number of the component and of its input."""
        k = self.index[port.component]
        return k, self.reference(port) - self.models[k].struct.parameters

    def _coupling_inputs(self) -> list[Any]:
        """The inputs that the master varies or watches."""
        h, by_target = header(), {c.target: c for c in self._network.connections}
        position = {k: i for i, k in enumerate(self._plan.order)}
        rows = []
        for port, s in zip(self._inputs.ports, self._inputs.inputs, strict=True):
            driven, (target, number) = s.source_component == DRIVEN, self._input(port)
            outside = h.Connection(DRIVEN, 0, target, number, 1.0, 0.0, 0)
            connection = outside if driven else self._connection(by_target[port])
            in_order = not driven and position[s.source_component] < position[target]
            rows.append(h.Input(connection, s.scale, s.requested_degree, s.order, s.autonomous, in_order))
        return rows

    def _scenario(self) -> dict[str, Any]:
        """The members of the plan for a scenario."""
        driven = self._network.driven
        if driven is None:
            return {}
        if len(driven.discrete) or len(driven.integers):
            raise NotInLanes("the scenario drives inputs that are not continuous")
        columns = zip(driven.continuous, driven.columns, driven.factor, driven.offset, strict=True)
        rates = {port: self._input(rate)[1] for rate, port in self._network.rates.items()}
        drives = [
            header().Drive(
                column, *self._input(port), self._inputs.ports.index(port), rates.get(port, -1), 0, *linear
            )
            for port, column, *linear in columns
        ]
        arrays = dict(zip(("time", "base", "slopes", "anchor"), driven.table.arrays, strict=True))
        return {
            "drives": self._array(header().Drive, drives),
            "drive_count": len(drives),
            "samples": len(arrays["time"]),
            "width": arrays["base"].shape[1],
            **{name: self._numbers(array, np.float64) for name, array in arrays.items()},
        }

    # ---- the exchange of values after a step

    def _exchange(self) -> tuple[list[Any], list[Any]]:
        """The instructions of an exchange, and the connections in the order in which they are copied.

        A component computes its outputs again if an input on which they depend directly is not settled, when
        as many of its sources as possible are known.
        """
        h, network, system = header(), self._network, self.system
        if network.loops:
            raise NotInLanes(network.loops[0].cycle.text)
        source = {c.target: c.source for c in network.connections}
        settled, known = _settled(system, self._plan, self._inputs, network.rates)
        needed = {*source.values()} | {*network.order.stages}.intersection(self.signals)
        checked = {u for y in needed for u in _direct(system, y)} - settled
        pending, program, ordered = needed - known, list[Any](), list[Any]()

        def copy(outputs: set[Port]) -> None:
            copied = [c for c in network.connections if c.source in outputs]
            program.append(h.Instruction(h.COPY, len(ordered), len(copied)))
            ordered.extend(self._connection(c, c.target in checked) for c in copied)

        copy(known)
        while pending:
            waiting = {name: {y for y in pending if y.component == name} for name in self.index}
            ready = {
                name: {y for y in outputs if pending.isdisjoint(source.get(u) for u in _direct(system, y))}
                for name, outputs in waiting.items()
            }
            name = max(ready, key=lambda n: (len(ready[n]) > 0, ready[n] == waiting[n], len(ready[n])))
            program.append(h.Instruction(h.OUTPUTS, self.index[name], 0))
            pending -= ready[name]
            copy(ready[name])
        rates = {
            k
            for p in self.signals
            if self.models[k := self.index[p.component]].is_derivative(self.reference(p))
        }
        return program + [h.Instruction(h.DERIVATIVES, k, 0) for k in sorted(rates)], ordered


def _check_coupling(job: Job, times: Grid) -> None:
    """Raise NotInLanes for settings of the master that lanes do not have."""
    c = job.coupling
    reasons = {
        f"the master {c.master}": c.master not in MASTERS_IN_LANES,
        "corrected inputs": c.correct,
        "several steps of a component in a communication step": any(n > 1 for n in c.factors.values()),
        "control of the energy": c.adaptive is not None and c.controls_energy,
        "adaptive steps without a record step": times.free,
    }
    if found := next((reason for reason, applies in reasons.items() if applies), None):
        raise NotInLanes(found)


def _direct(system: System, output: Port) -> list[Port]:
    """The inputs on which an output depends directly."""
    names = system.components[output.component].interface.direct_inputs(output.variable)
    return [Port(output.component, name) for name in names]


def _settled(
    system: System, plan: Plan, inputs: CouplingInputs, rates: Collection[Port]
) -> tuple[set[Port], set[Port]]:
    """Inputs that end a step at their final value, and outputs that depend directly on no others.

    These inputs are open, driven, or end at an output of this kind of a component that steps before.
    `rates` are inputs that get the slope of a driven one.
    """
    source = {c.target: c.source for c in system.connections}
    varied = inputs.varying - {*inputs.driven}
    names, settled, known, before = list(system.components), set[Port](), set[Port](), set[str]()
    for k in plan.order:
        interface = system.components[names[k]].interface
        for port in (Port(names[k], v.name) for v in interface.of("input")):
            follows = port in varied and source[port].component in before and source[port] in known
            if port not in rates and (port in inputs.driven or port not in source or follows):
                settled.add(port)
        ports = (Port(names[k], name) for name in interface.variables)
        known |= {port for port in ports if settled.issuperset(_direct(system, port))}
        if plan.sequential:
            before.add(names[k])
    return settled, known
