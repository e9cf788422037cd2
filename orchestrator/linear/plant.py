"""The components of a system in model exchange, joined: all states, all inputs, and what the wires do.

With the states x of all components, v all their inputs, y all their outputs and u the inputs from outside,

    dx/dt = f(x, v)     y = g(x, v)     v = L y + M u + constant

and, linearised, K = 1 / (1 - L D) with the components' own D: docs/linearize.md has the equations.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple, Protocol, cast

import numpy as np
from numpy.typing import NDArray

from orchestrator.base.errors import Problem
from orchestrator.engine.initialisation import initialise
from orchestrator.engine.linear_prediction import Linearisation
from orchestrator.fmi.calls import Call, Slave
from orchestrator.fmi.model_exchange import ExchangeFmu, open_exchange
from orchestrator.linear.cut_system import CutSystem
from orchestrator.ssp.system import Port

Array = NDArray[np.float64]
RELATIVE_STEP = (
    6e-6  # of the size of a value: the cube root of the rounding, where both errors of a difference meet
)


def differences(look: Callable[[], None], knowns: Sequence[Array], unknowns: Sequence[Array]) -> Array:
    """d(unknowns) / d(knowns), where `look` computes the one from the other, in place."""
    columns = []
    for known in knowns:
        for j, here in enumerate(known.tolist()):
            step, looks = RELATIVE_STEP * max(abs(here), 1.0), []
            for value in (here + step, here - step):
                known[j] = value
                look()
                looks.append(np.concatenate([*unknowns]))
            columns.append((looks[0] - looks[1]) / ((here + step) - (here - step)))
            known[j] = here
    look()
    return np.array(columns).T.reshape(sum(map(len, unknowns)), -1)


class StackedArrays(Protocol):
    """The arrays of all components: states, inputs, outputs, and time derivatives of the states."""

    x: Array
    v: Array
    y: Array
    f: Array


class PlantComponent:
    """One component: its places in the stacked arrays, and its calls."""

    def __init__(self, slave: ExchangeFmu, x: slice, v: slice, y: slice) -> None:
        self.slave, self.x, self.v, self.y = slave, x, v, y
        face = slave.interface
        self.inputs = [u.name for u in face.of("input") if u.is_continuous]
        self.outputs = [u.name for u in face.of("output") if u.is_continuous]

    def open(self, plant: StackedArrays) -> None:
        """Bind the calls to the arrays of the plant."""
        f, x, v, y = plant.f[self.x], plant.x[self.x], plant.v[self.v], plant.y[self.y]
        self._tangent = Linearisation(cast(Slave, self.slave), self.inputs, self.outputs, f, x)
        self.starts = [*self._tangent.state_reads, *self._rows(self.slave.reader, self.inputs, v)]
        self.writes = self._rows(self.slave.writer, self.inputs, v)
        self.reads = [*self._tangent.rate_reads, *self._rows(self.slave.reader, self.outputs, y)]
        self._plant = plant

    def _rows(self, make: Any, names: Sequence[str], values: Array) -> list[Call]:
        return [make(names, values)] if names else []

    def evaluate(self) -> None:
        """Set states and inputs, read derivatives and outputs."""
        self.slave.set_states(self._plant.x[self.x])
        for call in (*self.writes, *self.reads):
            call()

    def jacobian(self) -> Array:
        """d(f, y) / d(x, v) of this component."""
        if self.slave.interface.directional_derivatives:
            return self._tangent.matrix()
        p = self._plant
        return differences(self.evaluate, (p.x[self.x], p.v[self.v]), (p.f[self.x], p.y[self.y]))


MAX_ITERATIONS = (
    30  # of Newton's method over the wires; without feed-through loops as many as stages are enough
)
AGREEMENT = 1e-13  # of the size of a signal: rounding


class Matrices(NamedTuple):
    """A, B, C, D."""

    a: Array
    b: Array
    c: Array
    d: Array


class Plant:
    """The running components of a system; `close` frees them.

    x, v, y, f      states, inputs, outputs of all components, and time derivatives of the states, now
    states, ports   names; inputs and outputs as ports
    """

    def __init__(self, choice: CutSystem) -> None:
        self.cut, self.system = choice, choice.system
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

    def _wire(self) -> None:
        """L, M and what is constant of v."""
        at, of = ({p: i for i, p in enumerate(ports)} for ports in (self.inputs, self.outputs))
        self.connections, self.input_map = (
            np.zeros((len(at), len(of))),
            np.zeros((len(at), len(self.cut.inputs))),
        )
        self.constant, self.connected = np.zeros(len(at)), np.zeros(len(at), bool)
        for c in self.system.connections:
            if c.source in of and c.target in at:
                self.connections[at[c.target], of[c.source]] = c.map.factor
                self.constant[at[c.target]], self.connected[at[c.target]] = c.map.offset, True
        for j, inlet in enumerate(self.cut.inputs):
            for port, linear in inlet.targets:
                self.input_map[at[port], j], self.connected[at[port]] = linear.factor, True
                self.constant[at[port]] = linear.offset

    @property
    def notes(self) -> tuple[str, ...]:
        """What to say about the components."""
        plain = [name for name, slave in self.slaves.items() if not slave.interface.directional_derivatives]
        text = "gives no directional derivatives, so these are finite differences"
        return tuple(f"{name}: the FMU {text}" for name in plain)

    def start(self, span: tuple[float, float]) -> None:
        """Initialise as a run does, over the wires of the start, too; `span` in [s]."""
        initialise(self.system, cast(Mapping[str, Slave], self.slaves), {}, span)
        for member in self.members:
            member.open(self)
            for call in member.starts:
                call()
        self.constant[~self.connected] = self.v[~self.connected]
        self.nominal = np.array([_nominal(self, p) for p in self.states])

    @property
    def u(self) -> Array:
        """What the inputs from outside are now."""
        at = {p: i for i, p in enumerate(self.inputs)}
        first = [(at[inlet.targets[0][0]], inlet.targets[0][1]) for inlet in self.cut.inputs]
        return np.array([(self.v[i] - linear.offset) / linear.factor for i, linear in first])

    def settle(self, x: Array, u: Array) -> None:
        """Set states and inputs, and make all agree over the wires: v = L y + M u + constant."""
        self.x[:] = x
        outside = self.input_map @ u + self.constant
        for _ in range(MAX_ITERATIONS):
            self.evaluate()
            wanted = self.connections @ self.y + outside
            off = wanted - self.v
            if not np.isfinite(off).all():
                break
            if (
                np.abs(off)
                <= AGREEMENT * np.maximum(np.abs(wanted), np.abs(self.connections) @ np.abs(self.y))
            ).all():
                return
            self.v += self.loop_inverse(self.blocks().d) @ off
        raise Problem(f"{self.system.name}: its wires cannot be made to agree: {self._worst(off)}")

    def _worst(self, off: Array) -> str:
        k = int(np.argmax(np.where(np.isfinite(off), np.abs(off), np.inf)))
        return f"{self.inputs[k]} is off by {off[k]:.3g}"

    def evaluate(self) -> None:
        """Set states and inputs as they stand in the arrays, read derivatives and outputs."""
        for member in self.members:
            member.evaluate()

    def blocks(self) -> Matrices:
        """The components' own matrices, side by side, with respect to all their inputs."""
        nx, nv, ny = len(self.x), len(self.v), len(self.y)
        found = Matrices(*(np.zeros(s) for s in ((nx, nx), (nx, nv), (ny, nx), (ny, nv))))
        for m in self.members:
            jacobian, n = m.jacobian(), m.x.stop - m.x.start
            found.a[m.x, m.x], found.b[m.x, m.v] = jacobian[:n, :n], jacobian[:n, n:]
            found.c[m.y, m.x], found.d[m.y, m.v] = jacobian[n:, :n], jacobian[n:, n:]
        return found

    def matrices(self) -> Matrices:
        """A, B, C, D from the inputs from outside to all outputs."""
        own = self.blocks()
        closed = self.loop_inverse(own.d)
        of_x, of_u = closed @ (self.connections @ own.c), closed @ self.input_map
        return Matrices(own.a + own.b @ of_x, own.b @ of_u, own.c + own.d @ of_x, own.d @ of_u)

    def loop_inverse(self, d: Array) -> Array:
        """K = 1 / (1 - L D). Without a loop of direct feed-through a finite sum, without rounding."""
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
            raise Problem(f"{self.system.name}: a loop of direct feed-through has no one solution") from None

    def set_time(self, time: float) -> None:
        """Set the time [s]."""
        for slave in self.slaves.values():
            slave.set_time(time)

    def close(self) -> None:
        """Free all instances."""
        for slave in self.slaves.values():
            slave.close()


def _nominal(plant: Plant, port: Port) -> float:
    return plant.system.variable(port).nominal or 1.0
