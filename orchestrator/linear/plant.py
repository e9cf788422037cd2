"""The connected components of a system in Model Exchange, and their linearised equations.

With the states x, the inputs v and the outputs y of all components, and the external inputs u,

    dx/dt = f(x, v)     y = g(x, v)     v = L y + M u + constant

The linearised equations contain K = (1 - L D)^-1, with the matrices D of the components on the diagonal of
D; docs/linearize.md derives them.
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
from orchestrator.fmi.model_exchange import ExchangeFmu, open_exchange
from orchestrator.linear.cut_system import CutSystem
from orchestrator.ssp.system import Port

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
    return np.array(columns).T.reshape(sum(map(len, unknowns)), -1)


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
        self.slave.set_states(self._plant.x[self.x])
        for call in (*self.writes, *self.reads):
            call()

    def jacobian(self) -> Array:
        """d(f, y) / d(x, v) of this component."""
        if self.slave.interface.directional_derivatives:
            return self._linearisation.matrix()
        p = self._plant
        return differences(self.evaluate, (p.x[self.x], p.v[self.v]), (p.f[self.x], p.y[self.y]))


MAX_ITERATIONS = 30  # of Newton's method for the connections
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
    connections, input_map    the matrices L and M
    constant                  constant part of v
    connected                 True for inputs with a connection or an external input
    nominal                   nominal values of the states
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
        """Set L, M and the constant part of v."""
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
        """Notes on FMUs without directional derivatives."""
        names = [name for name, slave in self.slaves.items() if not slave.interface.directional_derivatives]
        reason = "has no directional derivatives, finite differences are used"
        return tuple(f"{name}: the FMU {reason}" for name in names)

    def start(self, span: tuple[float, float]) -> None:
        """Initialise the components as in a run; `span`: (start, stop) [s]."""
        initialise(self.system, cast(Mapping[str, Slave], self.slaves), {}, span)
        for member in self.members:
            member.open(self)
            for call in member.starts:
                call()
        self.constant[~self.connected] = self.v[~self.connected]
        self.nominal = np.array([_nominal(self, p) for p in self.states])

    @property
    def u(self) -> Array:
        """The current values of the external inputs."""
        at = {p: i for i, p in enumerate(self.inputs)}
        first = [(at[inlet.targets[0][0]], inlet.targets[0][1]) for inlet in self.cut.inputs]
        return np.array([(self.v[i] - linear.offset) / linear.factor for i, linear in first])

    def settle(self, x: Array, u: Array) -> None:
        """Set states and external inputs, and solve the connections v = L y + M u + constant for v."""
        self.x[:] = x
        external = self.input_map @ u + self.constant
        for _ in range(MAX_ITERATIONS):
            self.evaluate()
            expected = self.connections @ self.y + external
            residual = expected - self.v
            if not np.isfinite(residual).all():
                break
            magnitude = np.maximum(np.abs(expected), np.abs(self.connections) @ np.abs(self.y))
            if (np.abs(residual) <= AGREEMENT * magnitude).all():
                return
            self.v += self.loop_inverse(self.blocks().d) @ residual
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
