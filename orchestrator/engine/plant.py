"""The connected components of a system in Model Exchange as one ODE, its linearised equations, its events.

With the states x, the inputs v and the outputs y of all components, and the external inputs u,

    dx/dt = f(t, x, v)     y = g(t, x, v)     v = L y + M u + constant

The components declare which outputs depend on which inputs. Without an algebraic loop a finite number of
substitutions v = L y + M u + constant solves the connections exactly. Otherwise Newton's method does. The
linearised equations contain K = (1 - L D)^-1, with the matrices D of the components on the diagonal of D;
docs/linearize.md derives them. `plant.c` of the engine evaluates the equations.

At an event all components enter event mode. There all connected values are copied, also those of variables
that are not continuous, and the discrete states of all components are updated, until nothing changes.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from orchestrator.base.errors import Problem
from orchestrator.data.table import Array
from orchestrator.engine.c_library import Binding, library
from orchestrator.engine.linear_system import Entry, JacobianColumn, Linearisation, column_structs
from orchestrator.engine.network import initialise
from orchestrator.engine.scenario import DrivenInputs, Scenario
from orchestrator.fmi.calls import Slave, calls_by_type
from orchestrator.fmi.description import Value
from orchestrator.fmi.instance import settle
from orchestrator.fmi.model_exchange import ExchangeFmu, open_exchange
from orchestrator.ssp.system import Connection, Inlet, Port, System

SAME_INPUT = 1e-9  # relative difference of equal inputs in different units: rounding
RELATIVE_STEP = 6e-6  # of central differences: the cube root of the rounding error


def differences(evaluate: Callable[[], None], knowns: Sequence[Array], unknowns: Sequence[Array]) -> Array:
    """Jacobian d(unknowns) / d(knowns) by central differences; `evaluate` updates the unknowns in place."""
    columns = []
    for known in knowns:
        for j, x in enumerate(known.tolist()):
            step, results = RELATIVE_STEP * max(abs(x), 1.0), []
            for value in (x + step, x - step):
                known[j] = value
                evaluate()
                results.append(np.concatenate([*unknowns]))
            columns.append((results[0] - results[1]) / ((x + step) - (x - step)))
            known[j] = x
    evaluate()
    return np.array(columns).T.reshape(sum(map(len, unknowns)), sum(map(len, knowns)))


class PlantComponent:
    """One component: its slices of the arrays of the plant, and its bound calls.

    starts   calls that read the states and the inputs
    writes, reads, rates   calls that set the inputs, get the outputs, get the time derivatives of the states
    """

    def __init__(self, slave: ExchangeFmu, nx: int, nv: int, ny: int) -> None:
        """nx, nv, ny: numbers of states, inputs and outputs of the components before it."""
        self.slave = slave
        self.inputs = [u.name for u in slave.interface.of("input") if u.is_continuous]
        self.outputs = [u.name for u in slave.interface.of("output") if u.is_continuous]
        self.x = slice(nx, nx + len(slave.interface.states))
        self.v, self.y = slice(nv, nv + len(self.inputs)), slice(ny, ny + len(self.outputs))

    def open(self, plant: Plant) -> None:
        """Bind the calls of the component to the arrays of the plant."""
        slave = cast(Slave, self.slave)
        v, y = plant.v[self.v], plant.y[self.y]
        linear = Linearisation(slave, self.inputs, self.outputs, plant.f[self.x])
        states = calls_by_type(slave, linear.states, plant.x[self.x], slave.reader)
        self.starts = [*states, *calls_by_type(slave, self.inputs, v, slave.reader)]
        self.writes = calls_by_type(slave, self.inputs, v, slave.writer)
        self.reads = calls_by_type(slave, self.outputs, y, slave.reader)
        self.rates, self.columns = linear.rate_reads, linear.columns

    def indices(self, nx: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Rows of its f and y, and columns of its x and v, in the Jacobian of a plant with nx states."""
        rows, columns = ((*_range(self.x), *(nx + i for i in _range(s))) for s in (self.y, self.v))
        return np.array(rows, np.int64), np.array(columns, np.int64)


def _range(part: slice) -> range:
    return range(part.start, part.stop)


class Matrices(NamedTuple):
    """The matrices A, B, C, D of a linear model."""

    a: Array
    b: Array
    c: Array
    d: Array


class Plant:
    """The running components of a system in Model Exchange; `close` frees them.

    x, v, y, f                current states, inputs, outputs of all components, and state derivatives
    states, inputs, outputs   the ports of x, v and y
    inlets                    external inputs, each with its targets, the inputs of components
    connections, input_map    the matrices L and M
    constant                  constant part of v
    external                  part of v that does not come from outputs
    connected                 True for inputs with a connection or an external input
    nominal                   nominal values of the states
    indicator_count           number of event indicators of all components
    next_event                time of the next time event [s]; infinite if there is none
    changed                   signals, not continuous, that have changed in the last event
    ended                     name of the component that requested the end of the simulation; empty if none
    """

    def __init__(
        self,
        system: System,
        inlets: Sequence[Inlet] = (),
        running: Mapping[str, ExchangeFmu] | None = None,
        binding: Binding | None = None,
    ) -> None:
        """running: its components, if they are instantiated; binding: one that was made before them."""
        self.system, self.inlets, self._binding = system, inlets, binding or Binding()
        self._binding.simulation.careful = True
        self.next_event, self.ended, self.changed = np.inf, "", list[str]()
        self.slaves = dict(running or {})
        self.members: list[PlantComponent] = []
        try:
            for name, component in self.system.components.items():
                if name not in self.slaves:
                    restore = self._binding.restore_environment
                    self.slaves[name] = open_exchange(name, component.source, restore)
        except BaseException:
            self.close()
            raise
        nx = nv = ny = 0
        for slave in self.slaves.values():
            self.members.append(member := PlantComponent(slave, nx, nv, ny))
            nx, nv, ny = member.x.stop, member.v.stop, member.y.stop
        self.x, self.f, self.v, self.y = np.zeros(nx), np.zeros(nx), np.zeros(nv), np.zeros(ny)
        self.states = [Port(n, x) for n, s in self.slaves.items() for x in s.interface.states]
        self.inputs = [Port(m.slave.name, u) for m in self.members for u in m.inputs]
        self.outputs = [Port(m.slave.name, y) for m in self.members for y in m.outputs]
        self.indicator_count = sum(slave.interface.event_indicators for slave in self.slaves.values())
        self._index = {p: i for i, p in enumerate(self.inputs)}
        self._wire()
        self._scenario: Any = None

    def _wire(self) -> None:
        """Set L, M and the constant part of v."""
        at, of = self._index, {p: i for i, p in enumerate(self.outputs)}
        self.connections = np.zeros((len(at), len(of)))
        self.input_map = np.zeros((len(at), len(self.inlets)))
        self.constant, self.connected = np.zeros(len(at)), np.zeros(len(at), bool)
        self._discrete: list[Connection] = []
        for c in self.system.connections:
            if c.source in of and c.target in at:
                self.connections[at[c.target], of[c.source]] = c.map.factor
                self.constant[at[c.target]], self.connected[at[c.target]] = c.map.offset, True
            elif self.system.variable(c.target).causality == "input":
                self.connected[[at[c.target]] if c.target in at else []] = True
                self._discrete.append(c)
        for j, inlet in enumerate(self.inlets):
            for port, linear in inlet.targets:
                self.input_map[at[port], j], self.connected[at[port]] = linear.factor, True
                self.constant[at[port]] = linear.offset

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes on FMUs without directional derivatives."""
        names = [name for name, slave in self.slaves.items() if not slave.interface.directional_derivatives]
        reason = "has no directional derivatives, finite differences are used"
        return tuple(f"{name}: the FMU {reason}" for name in names)

    def _may_have_effect(self, port: Port) -> bool:
        """May a state, an output or an event indicator depend on an input?"""
        interface = self.slaves[port.component].interface
        return interface.event_indicators > 0 or port.variable not in interface.unused_inputs

    def _count_substitutions(self) -> int:
        """How many substitutions solve the connections, by the declared dependencies; 0: a loop."""
        index = self._index
        through = np.zeros((len(self.outputs), len(self.inputs)), bool)
        for row, port in enumerate(self.outputs):
            direct = self.slaves[port.component].interface.direct_inputs(port.variable)
            through[row, [index[p] for u in direct if (p := Port(port.component, u)) in index]] = True
        power = step = self.connections.astype(bool) @ through
        for count, _ in enumerate(self.inputs, 1):
            if not power.any():
                return count
            power = power @ step
        return 0

    # ---- the structure of the C engine

    def _bind(self) -> None:
        """Fill `Plant` of engine.h."""
        binding, h, at = self._binding, self._binding.h, self._binding.at
        n = len(self.v)
        self._time, self.external, self._inverse = np.zeros(1), np.zeros(n), np.zeros((n, n))
        self._jacobian = np.zeros((len(self.x) + len(self.y), len(self.x) + n))
        self._indicators, self._completed = np.zeros(self.indicator_count), np.zeros((len(self.members), 2))
        self._residual = np.zeros(n)
        rows, sources = np.nonzero(self.connections)
        for member in self.members:
            member.open(self)
        columns = [*self._columns()]
        self._struct = h.Plant(
            members=binding.pointer(binding.array(h.PlantMember, [*map(self._member, self.members)])),
            states=binding.program([*self._state_calls()]),
            starts=binding.program([call for member in self.members for call in member.starts]),
            indicators=binding.program([*self._indicator_calls()]),
            completed=binding.program([*self._completion_calls()]),
            rows=at(rows.astype(np.int32)),
            sources=at(sources.astype(np.int32)),
            factors=at(self.connections[rows, sources]),
            effective=at(np.array([*map(self._may_have_effect, self.inputs)], np.uint8)),
            stale=at(np.zeros(len(self.members), np.int32)),
            **{name: at(getattr(self, name)) for name in ("v", "y", "external")},
            **{name: at(getattr(self, f"_{name}")) for name in ("time", "inverse", "jacobian")},
            residual=at(self._residual),
            results=at(self._completed),
            **{name: at(np.zeros(n)) for name in ("expected", "magnitude")},
            columns=binding.pointer(column_structs(binding, columns)),
            member_count=len(self.members),
            input_count=n,
            connection_count=len(rows),
            column_count=len(columns),
            rounds=self._count_substitutions(),
        )
        self._arguments = ctypes.byref(binding.simulation), ctypes.byref(self._struct)
        self._settle_in_c, self._complete_in_c = (
            partial(function, *self._arguments)
            for function in (library().plant_settle, library().plant_completed_step)
        )
        self._needs_completion = any(slave.interface.completed_step for slave in self.slaves.values())

    def _member(self, member: PlantComponent) -> Any:
        program = self._binding.program
        return self._binding.h.PlantMember(
            *(program(calls) for calls in (member.writes, member.reads, member.rates)),
            member.v.start,
            len(member.inputs),
        )

    def _state_calls(self) -> Iterator[Any]:
        for member in self.members:
            yield member.slave.exchange_call("SetTime", self._time)
            if member.x.stop > member.x.start:
                yield member.slave.exchange_call("SetContinuousStates", self.x[member.x])

    def _indicator_calls(self) -> Iterator[Any]:
        first = 0
        for slave in self.slaves.values():
            last = first + slave.interface.event_indicators
            if last > first:
                yield slave.exchange_call("GetEventIndicators", self._indicators[first:last])
            first = last

    def _completion_calls(self) -> Iterator[Any]:
        for member, results in zip(self.members, self._completed, strict=True):
            if member.slave.interface.completed_step:
                yield member.slave.exchange_call("CompletedIntegratorStep", results)

    def _columns(self) -> Iterator[tuple[JacobianColumn, list[Entry]]]:
        """All directional derivatives, with the places of their results in the Jacobian."""
        width = self._jacobian.shape[1]
        for member in self.members:
            rows, columns = member.indices(len(self.x))
            for column in member.columns:
                places = [(column.rows.index(i), rows[i] * width + columns[j]) for i, j in column.entries]
                yield column, [(index, int(place), 1.0) for index, place in places]

    def _call(self, function: str, *arguments: int) -> None:
        self._finish(getattr(library(), function)(*self._arguments, *arguments))

    def _finish(self, outcome: int) -> None:
        """Go on with Newton's method if it needs an inverse; raise the exception that an outcome means."""
        h = self._binding.h
        while outcome == h.NEEDS_INVERSE:
            self._inverse[:] = self.loop_inverse(self._feedthrough())
            self._struct.inverse_state = h.RENEWED
            outcome = library().plant_iterate(*self._arguments)
        if outcome == h.NOT_CONVERGED:
            reason = f"the equations of the connections did not converge: {self._worst()}"
            raise Problem(f"{self.system.name}: {reason}")
        if outcome:
            raise self._binding.problem or Problem("the run stopped")

    def _worst(self) -> str:
        k = int(np.argmax(np.where(np.isfinite(self._residual), np.abs(self._residual), np.inf)))
        return f"{self.inputs[k]} differs from its source by {self._residual[k]:.3g}"

    # ---- the equations

    def start(self, span: tuple[float, float], driven: Mapping[Port, Value] | None = None) -> None:
        """Initialise the components as in a run, with their first event; ends in continuous-time mode.

        span     start and stop [s]
        driven   input -> value at the start, for inputs that a scenario drives
        """
        initialise(self.system, cast(Mapping[str, Slave], self.slaves), driven or {}, span)
        self.begin(span[0])

    def begin(self, time: float) -> None:
        """Begin at a time [s] with components that are initialised."""
        self._bind()
        self._call("plant_start")
        self._time[:] = time
        self.constant[~self.connected] = self.v[~self.connected]
        self.nominal = np.array([self.system.variable(p).nominal or 1.0 for p in self.states])
        self.external[:] = self.input_map @ self.u + self.constant
        self._update_discrete_states()

    def memory(self) -> list[Any]:
        """See `Binding.memory`."""
        return self._binding.memory()

    def read(self) -> None:
        """Read states and inputs of components without connections, which keep these inputs."""
        self._call("plant_start")
        self.external[:] = self.v

    def drive(self, scenario: Scenario) -> None:
        """Let a scenario drive its continuous inputs from now on, whenever the plant is settled."""
        columns = {p: c for p, c in scenario.columns.items() if self.system.variable(p).is_continuous}
        driven = DrivenInputs(replace(scenario, columns=columns), self.system, self._index, {}, ())
        self._scenario = driven.fill(self._binding, ())

    def jumped(self, time: float) -> None:
        """The jumps of its scenario up to a time [s] have taken place."""
        if self._scenario:
            self._scenario.since, self._scenario.evaluated_at = time, np.nan

    @property
    def u(self) -> Array:
        """The current values of the external inputs; raises Problem if the targets of one differ."""
        at, result = self._index, list[float]()
        for inlet in self.inlets:
            found = {str(p): (self.v[at[p]] - linear.offset) / linear.factor for p, linear in inlet.targets}
            low, high = min(found.values()), max(found.values())
            if high - low > SAME_INPUT * max(abs(low), abs(high)):
                got = ", ".join(f"{name} = {value:g}" for name, value in found.items())
                raise Problem(f"input {inlet.name}: expected one value, got {got}; name them one by one")
            result.append(next(iter(found.values())))
        return np.array(result)

    def settle(self, x: Array, u: Array) -> None:
        """Set states and external inputs, and solve the connections v = L y + M u + constant for v."""
        self.external[:] = self.input_map @ u + self.constant
        self.settle_at(float(self._time[0]), x)

    def settle_at(self, time: float, x: Array) -> None:
        """Set time [s], states and the inputs that `drive` drives; solve the connections."""
        self._time[0], self.x[:] = time, x
        if outcome := self._settle_in_c():
            self._finish(outcome)

    def set_time(self, time: float) -> None:
        """Set the time [s] of the next evaluations."""
        self._time[0] = time

    def _feedthrough(self) -> Array:
        """The block-diagonal matrix D of the unconnected components; leaves the states as they are."""
        return self._jacobians(of_states=False)[len(self.x) :, len(self.x) :]

    def blocks(self) -> Matrices:
        """Block-diagonal matrices of the unconnected components, with respect to x and v."""
        halves = np.split(self._jacobians(of_states=True), [len(self.x)])
        return Matrices(*(part.copy() for half in halves for part in np.split(half, [len(self.x)], 1)))

    def _jacobians(self, of_states: bool) -> Array:
        """The Jacobian of all components; without directional derivatives by differences.

        of_states   with these differences also for states and rates, not only for inputs and outputs
        """
        self._call("plant_jacobian")
        for k, member in enumerate(self.members):
            if member.slave.interface.directional_derivatives:
                continue
            rows, columns = member.indices(len(self.x))
            knowns, unknowns = [self.x[member.x], self.v[member.v]], [self.f[member.x], self.y[member.y]]
            first = 0 if of_states else 1
            evaluate = partial(self._call, "plant_evaluate", k, of_states)
            found = differences(evaluate, knowns[first:], unknowns[first:])
            skipped = len(knowns[0]) * first
            self._jacobian[np.ix_(rows[skipped:], columns[skipped:])] = found
        return self._jacobian

    def matrices(self) -> Matrices:
        """A, B, C, D of the connected system, from the external inputs to all outputs."""
        a, b, c, d = self.blocks()
        inverse = self.loop_inverse(d)
        v_by_x, v_by_u = inverse @ (self.connections @ c), inverse @ self.input_map
        return Matrices(a + b @ v_by_x, b @ v_by_u, c + d @ v_by_x, d @ v_by_u)

    def loop_inverse(self, d: Array) -> Array:
        """K = (1 - L D)^-1; without an algebraic loop a finite sum, which has no rounding errors."""
        through = self.connections @ d
        total = power = np.eye(len(through))
        for _ in range(len(through)):
            power = through @ power
            if not power.any():
                return total
            total = total + power
        try:
            return np.asarray(np.linalg.solve(np.eye(len(through)) - through, np.eye(len(through))))
        except np.linalg.LinAlgError:
            raise Problem(f"{self.system.name}: the algebraic loop has no unique solution") from None

    # ---- events

    def indicators(self) -> Array:
        """The event indicators of all components, shape (indicator_count,)."""
        self._call("plant_indicators")
        return self._indicators.copy()

    def completed_step(self, time: float, x: Array) -> bool:
        """Tell the components that the solver has accepted a step, to a time [s]; True for an event.

        Inputs keep the values of the last evaluation.
        """
        if not self._needs_completion:
            return False
        self._time[0], self.x[:] = time, x
        if outcome := self._complete_in_c():
            self._finish(outcome)
        if not self._struct.requests:
            return False
        for member, (_, ends) in zip(self.members, self._completed, strict=True):
            self.ended = member.slave.name if ends else self.ended
        return bool(self._completed[:, 0].any())

    def event(self, set_discrete: Callable[[], None] = lambda: None) -> None:
        """Event mode of all components at the present time, from settled states; back to continuous time.

        set_discrete   sets external inputs that are not continuous
        """
        for slave in self.slaves.values():
            slave.fmu.call("EnterEventMode")
        set_discrete()
        self._update_discrete_states()

    def _update_discrete_states(self) -> None:
        """Copy values and update discrete states until nothing changes, and enter continuous-time mode."""
        self.changed.clear()
        updates = {name: slave.update for name, slave in self.slaves.items()}
        ended, times = settle(self.system.name, updates, self._copied_discrete)
        for name in (name for name, time in times.items() if np.isnan(time)):
            t = f"t = {self._time[0]:.9g} s"
            raise Problem(f"{name}: expected the next event after {t}, got nan s")
        self.ended, self.next_event = ended or self.ended, min(times.values(), default=np.inf)
        self.leave_events()

    def leave_events(self) -> None:
        """Enter continuous-time mode with the states and inputs of the components."""
        for member in self.members:
            member.slave.fmu.call("EnterContinuousTimeMode")
        self._call("plant_start")
        self._struct.inverse_state = self._binding.h.MISSING

    def _copied_discrete(self) -> list[str]:
        """Copy values along all connections; the sources of variables, not continuous, that have changed."""
        changed, at = list[str](), self._index
        for k in range(len(self.members)):
            self._call("plant_evaluate", k, False)
        self._call("plant_connect")
        for c in self._discrete:
            value = self.slaves[c.source.component].get(c.source.variable)
            value = c.carried(value, self.system.variable(c.target))
            if c.target in at:
                same = bool(self.constant[at[c.target]] == value)
                self.constant[at[c.target]] = self.external[at[c.target]] = value
            elif not (same := self.slaves[c.target.component].get(c.target.variable) == value):
                self.slaves[c.target.component].set(c.target.variable, value)
            changed += [str(c.source)] * (not same)
        self.changed += changed
        return changed

    def magnitudes(self) -> Array:
        """The magnitudes of the states for the tolerance of a solver, which the FMUs give and may change.

        Nominal values of the model description replace those that an FMU does not give.
        """
        result = np.zeros(len(self.x))
        for member in self.members:
            with suppress(Problem):
                member.slave.get_nominals(result[member.x])
        return np.where(np.isfinite(result) & (result > 0.0), result, self.nominal)

    def close(self) -> None:
        """Free all instances."""
        for slave in self.slaves.values():
            slave.close()
