"""The connected components of a system in Model Exchange as one ODE, its linearised equations, its events.

With the states x, the inputs v and the outputs y of all components, and the external inputs u,

    dx/dt = f(t, x, v)     y = g(t, x, v)     v = L y + M u + constant

The components declare which outputs depend on which inputs. Without an algebraic loop a finite number of
substitutions v = L y + M u + constant solves the connections exactly. Otherwise Newton's method does. The
linearised equations contain K = (1 - L D)^-1, with the matrices D of the components on the diagonal of D;
docs/linearize.md derives them.

At an event all components enter event mode. There all connected values are copied, also those of variables
that are not continuous, and the discrete states of all components are updated, until nothing changes.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple, Protocol, cast

import numpy as np
from numpy.typing import NDArray

from orchestrator.base.errors import Problem
from orchestrator.engine.linear_prediction import Linearisation
from orchestrator.engine.network import initialise
from orchestrator.fmi.calls import Call, Slave
from orchestrator.fmi.description import Value
from orchestrator.fmi.model_exchange import ExchangeFmu, open_exchange
from orchestrator.ssp.system import Connection, Inlet, Port, System

Array = NDArray[np.float64]
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


class StackedArrays(Protocol):
    """Stacked arrays of all components: states x, inputs v, outputs y, time derivatives f of the states."""

    x: Array
    v: Array
    y: Array
    f: Array


class PlantComponent:
    """One component: its slices of the stacked arrays, and its bound calls."""

    def __init__(self, slave: ExchangeFmu, x: slice, v: slice, y: slice) -> None:
        self.slave, self.x, self.v, self.y = slave, x, v, y
        self.inputs = [u.name for u in slave.interface.of("input") if u.is_continuous]
        self.outputs = [u.name for u in slave.interface.of("output") if u.is_continuous]

    def open(self, plant: StackedArrays) -> None:
        """Bind the calls of the component to the arrays of the plant."""
        f, x, v, y = plant.f[self.x], plant.x[self.x], plant.v[self.v], plant.y[self.y]
        self._linearisation = Linearisation(cast(Slave, self.slave), self.inputs, self.outputs, f, x)
        self.starts = [*self._linearisation.state_reads, *self._calls(self.slave.reader, self.inputs, v)]
        self.writes = self._calls(self.slave.writer, self.inputs, v)
        self.reads = [*self._linearisation.rate_reads, *self._calls(self.slave.reader, self.outputs, y)]
        self._plant = plant

    def _calls(self, make: Any, names: Sequence[str], values: Array) -> list[Call]:
        return [make(names, values)] if names else []

    def evaluate(self) -> None:
        """Set states and inputs, get state derivatives and outputs."""
        self.set_states()
        self.substitute()

    def set_states(self) -> None:
        """Set the states."""
        if self.x.stop > self.x.start:
            self.slave.set_states(self._plant.x[self.x])

    def substitute(self) -> None:
        """Set inputs, get state derivatives and outputs."""
        for call in self.writes:
            call()
        for call in self.reads:
            call()

    def jacobian(self) -> Array:
        """d(f, y) / d(x, v) of this component."""
        if self.slave.interface.directional_derivatives:
            return self._linearisation.matrix()
        p = self._plant
        return differences(self.evaluate, (p.x[self.x], p.v[self.v]), (p.f[self.x], p.y[self.y]))

    def feedthrough(self) -> Array:
        """dy / dv of this component; leaves the states as they are, as event mode requires."""
        if self.slave.interface.directional_derivatives:
            n = self.x.stop - self.x.start
            return self._linearisation.matrix()[n:, n:]
        return differences(self.substitute, (self._plant.v[self.v],), (self._plant.y[self.y],))


MAX_ITERATIONS = 30  # of Newton's method for the connections
MAX_EVENT_ITERATIONS = 100  # at one event
AGREEMENT = 1e-13  # tolerance of connected values, relative to their magnitude


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
    connected                 True for inputs with a connection or an external input
    nominal                   nominal values of the states
    next_event                time of the next time event [s]; infinite if there is none
    ended                     name of the component that requested the end of the simulation; empty if none
    """

    def __init__(self, system: System, inlets: Sequence[Inlet] = ()) -> None:
        self.system, self.inlets = system, inlets
        self.next_event, self.ended = np.inf, ""
        self.slaves: dict[str, ExchangeFmu] = {}
        self.members: list[PlantComponent] = []
        try:
            for name, component in self.system.components.items():
                self.slaves[name] = open_exchange(name, component.source)
        except BaseException:
            self.close()
            raise
        nx = nv = ny = 0
        for slave in self.slaves.values():
            member = PlantComponent(slave, slice(nx, 0), slice(nv, 0), slice(ny, 0))
            ends = nx + len(slave.interface.states), nv + len(member.inputs), ny + len(member.outputs)
            member.x, member.v, member.y = slice(nx, ends[0]), slice(nv, ends[1]), slice(ny, ends[2])
            nx, nv, ny = ends
            self.members.append(member)
        self.x, self.f, self.v, self.y = np.zeros(nx), np.zeros(nx), np.zeros(nv), np.zeros(ny)
        self.states = [Port(n, x) for n, s in self.slaves.items() for x in s.interface.states]
        self.inputs = [Port(m.slave.name, u) for m in self.members for u in m.inputs]
        self.outputs = [Port(m.slave.name, y) for m in self.members for y in m.outputs]
        self._wire()
        self._substitutions = self._count_substitutions()
        self._effective = np.array([*map(self._may_have_effect, self.inputs)], bool)
        self._inverse: Array | None = None

    def _wire(self) -> None:
        """Set L, M and the constant part of v."""
        at, of = ({p: i for i, p in enumerate(ports)} for ports in (self.inputs, self.outputs))
        self.connections, self.input_map = (
            np.zeros((len(at), len(of))),
            np.zeros((len(at), len(self.inlets))),
        )
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

    def _count_substitutions(self) -> int | None:
        """How many substitutions solve the connections, by the declared dependencies; None: a loop."""
        index = {p: i for i, p in enumerate(self.inputs)}
        through = np.zeros((len(self.outputs), len(self.inputs)))
        for row, port in enumerate(self.outputs):
            direct = self.slaves[port.component].interface.direct_inputs(port.variable)
            through[row, [index[p] for u in direct if (p := Port(port.component, u)) in index]] = 1.0
        step = (self.connections != 0.0).astype(float) @ through
        power = (step != 0.0).astype(float)
        for count in range(1, len(self.inputs) + 2):
            if not power.any():
                return count
            power = ((power @ step) != 0.0).astype(float)
        return None

    def start(self, span: tuple[float, float], driven: Mapping[Port, Value] | None = None) -> None:
        """Initialise the components as in a run, with their first event; ends in continuous-time mode.

        span     start and stop [s]
        driven   input -> value at the start, for inputs that a scenario drives
        """
        initialise(self.system, cast(Mapping[str, Slave], self.slaves), driven or {}, span)
        for member in self.members:
            member.open(self)
            for call in member.starts:
                call()
        self.constant[~self.connected] = self.v[~self.connected]
        self.nominal = np.array([_nominal(self, p) for p in self.states])
        self._external = self.input_map @ self.u + self.constant
        self._update_discrete_states()

    @property
    def u(self) -> Array:
        """The current values of the external inputs."""
        at = {p: i for i, p in enumerate(self.inputs)}
        first = [(at[inlet.targets[0][0]], inlet.targets[0][1]) for inlet in self.inlets]
        return np.array([(self.v[i] - linear.offset) / linear.factor for i, linear in first])

    def settle(self, x: Array, u: Array) -> None:
        """Set states and external inputs, and solve the connections v = L y + M u + constant for v."""
        self.x[:] = x
        self._external = self.input_map @ u + self.constant
        for member in self.members:
            member.evaluate()
        self._connect()

    def _connect(self) -> None:
        """Solve the connections; all components are evaluated with the present v. Problem if that fails."""
        for _ in range(self._substitutions or 0):
            before = self.v.copy()
            self.v[:] = self.connections @ self.y + self._external
            changed = (self.v != before) & self._effective
            members = [m for m in self.members if changed[m.v].any()]
            if not members:
                return
            for member in members:
                member.substitute()
        self._iterate()

    def _iterate(self) -> None:
        """Newton's method for the connections; K is kept while each iteration gains a digit."""
        last = np.inf
        for _ in range(MAX_ITERATIONS):
            expected = self.connections @ self.y + self._external
            residual = expected - self.v
            if not np.isfinite(residual).all():
                break
            magnitude = np.maximum(np.abs(expected), np.abs(self.connections) @ np.abs(self.y))
            relative = np.abs(residual[residual != 0.0]) / magnitude[residual != 0.0]
            largest = float(relative.max(initial=0.0))
            if largest <= AGREEMENT:
                return
            if self._inverse is None or largest > last / 10.0:
                self._inverse = self.loop_inverse(self._feedthrough())
            last = largest
            self.v += self._inverse @ residual
            for member in self.members:
                member.substitute()
        raise Problem(
            f"{self.system.name}: the equations of the connections did not converge: {self._worst(residual)}"
        )

    def _worst(self, residual: Array) -> str:
        k = int(np.argmax(np.where(np.isfinite(residual), np.abs(residual), np.inf)))
        return f"{self.inputs[k]} differs from its source by {residual[k]:.3g}"

    def evaluate(self) -> None:
        """Set states and inputs of all components, get state derivatives and outputs."""
        for member in self.members:
            member.evaluate()

    def _feedthrough(self) -> Array:
        """The block-diagonal matrix D of the unconnected components."""
        d = np.zeros((len(self.y), len(self.v)))
        for member in self.members:
            d[member.y, member.v] = member.feedthrough()
        return d

    def blocks(self) -> Matrices:
        """Block-diagonal matrices of the unconnected components, with respect to x and v."""
        nx, nv, ny = len(self.x), len(self.v), len(self.y)
        blocks = Matrices(*(np.zeros(s) for s in ((nx, nx), (nx, nv), (ny, nx), (ny, nv))))
        for m in self.members:
            jacobian, n = m.jacobian(), m.x.stop - m.x.start
            blocks.a[m.x, m.x], blocks.b[m.x, m.v] = jacobian[:n, :n], jacobian[:n, n:]
            blocks.c[m.y, m.x], blocks.d[m.y, m.v] = jacobian[n:, :n], jacobian[n:, n:]
        return blocks

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

    # ---- time and events

    def set_time(self, time: float) -> None:
        """Set the time [s]."""
        for slave in self.slaves.values():
            slave.set_time(time)

    @property
    def indicator_count(self) -> int:
        """Number of event indicators of all components."""
        return sum(slave.interface.event_indicators for slave in self.slaves.values())

    def indicators(self, into: Array) -> None:
        """Get the event indicators of all components, shape (indicator_count,)."""
        first = 0
        for slave in self.slaves.values():
            count = slave.interface.event_indicators
            slave.get_event_indicators(into[first : first + count])
            first += count

    def completed_step(self, time: float, x: Array) -> bool:
        """Tell the components that the solver has accepted a step, to a time [s]; True for an event.

        Inputs keep the values of the last evaluation.
        """
        self.x[:], event = x, False
        for member in self.members:
            if member.slave.interface.completed_step:
                member.slave.set_time(time)
                member.set_states()
                needed, ends = member.slave.completed_step()
                self.ended = member.slave.name if ends else self.ended
                event |= needed
        return event

    def event(self, set_discrete: Callable[[], None] = lambda: None) -> None:
        """Event mode of all components at the present time, from settled states; back to continuous time.

        set_discrete   sets external inputs that are not continuous
        """
        for slave in self.slaves.values():
            slave.enter_event_mode()
        set_discrete()
        self._update_discrete_states()

    def _update_discrete_states(self) -> None:
        """Copy values and update discrete states until nothing changes, and enter continuous-time mode."""
        updated = False
        for _ in range(MAX_EVENT_ITERATIONS):
            for member in self.members:
                member.substitute()
            self._connect()
            if not self._copied_discrete() and updated:
                break
            again, self.next_event = False, np.inf
            for name, slave in self.slaves.items():
                needed, ends, next_event = slave.fmu.update_discrete_states()
                self.ended, self.next_event = name if ends else self.ended, min(self.next_event, next_event)
                again |= needed
            updated = not again
        else:
            raise Problem(
                f"{self.system.name}: expected at most {MAX_EVENT_ITERATIONS} event iterations, got more:"
                " the discrete states do not settle"
            )
        for member in self.members:
            member.slave.enter_continuous_time_mode()
            for call in member.starts:
                call()
        self._inverse = None

    def _copied_discrete(self) -> bool:
        """Copy values along the connections of variables that are not continuous; False if none changed."""
        changed, at = False, {p: i for i, p in enumerate(self.inputs)}
        for c in self._discrete:
            value = self.slaves[c.source.component].get(c.source.variable)
            if isinstance(value, float) or self.system.variable(c.target).is_real:
                value = c.map(float(value))
            if c.target in at:
                changed |= bool(self.constant[at[c.target]] != value)
                self.constant[at[c.target]] = self._external[at[c.target]] = value
            elif self.slaves[c.target.component].get(c.target.variable) != value:
                self.slaves[c.target.component].set(c.target.variable, value)
                changed = True
        return changed

    def close(self) -> None:
        """Free all instances."""
        for slave in self.slaves.values():
            slave.close()


def _nominal(plant: Plant, port: Port) -> float:
    return plant.system.variable(port).nominal or 1.0
