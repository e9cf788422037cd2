"""The running system: where its values stand, and the calls that exchange them at a communication point.

All Real variables that are exchanged or recorded stand in one float64 array, all others in one int32 array.
A component's variables that are read (or set) together stand side by side, so that each get or set is one
call into the FMU on a slice. The exchange at a communication point runs through the stages of
`dependencies.output_order`: read the outputs that are known, carry them over, set the inputs they feed.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orchestrator.engine.algebraic_loop import AlgebraicLoop
from orchestrator.engine.c_library import Binding
from orchestrator.engine.component import RunningComponent
from orchestrator.engine.scenario import Scenario
from orchestrator.fmi.calls import Buffer, Call, Slave, function_type
from orchestrator.ssp.dependencies import OutputOrder, output_order
from orchestrator.ssp.system import Connection, Port, System


@dataclass(frozen=True)
class Block:
    """Variables of one component and one kind that are read or set in the same stages; a slice of a bank."""

    component: str
    kind: str
    stages: tuple[int, ...]
    ports: tuple[Port, ...]
    first: int


class Bank:
    """One array of values and where each port stands in it."""

    def __init__(self, dtype: Any) -> None:
        self.blocks: list[Block] = []
        self.index: dict[Port, int] = {}
        self.values: Buffer = np.zeros(0, dtype)

    def add(self, system: System, stages: Mapping[Port, tuple[int, ...]]) -> list[Block]:
        """Append ports, grouped into blocks."""
        groups: dict[tuple[str, str, tuple[int, ...]], list[Port]] = {}
        for port, when in stages.items():
            groups.setdefault((port.component, function_type(system.variable(port)), when), []).append(port)
        added = []
        for (component, kind, when), ports in groups.items():
            added.append(Block(component, kind, when, tuple(ports), len(self.index)))
            self.index.update({port: len(self.index) + i for i, port in enumerate(ports)})
        self.blocks += added
        self.values = np.zeros(len(self.index), self.values.dtype)
        return added

    def slice(self, block: Block) -> Buffer:
        """The values of one block, as a view."""
        return self.values[block.first : block.first + len(block.ports)]

    def places(self, ports: Iterable[Port]) -> NDArray[np.int64]:
        """Positions of ports in `values`."""
        return np.array([self.index[p] for p in ports], dtype=np.int64)


class Link:
    """Connections that carry values from outputs to inputs within a bank; calling it does so."""

    def __init__(self, bank: Bank, connections: Sequence[Connection]) -> None:
        self.source = bank.places(c.source for c in connections)
        self.target = bank.places(c.target for c in connections)
        self.values = bank.values
        self.factor = np.array([c.map.factor for c in connections]).astype(bank.values.dtype)
        self.offset = np.array([c.map.offset for c in connections]).astype(bank.values.dtype)

    def __call__(self) -> None:
        self.values[self.target] = self.values[self.source] * self.factor + self.offset

    def instruction(self, binding: Binding) -> Any:
        """The same for C, where factors of 1 with offsets of 0 are left out."""
        h = binding.h
        plain = np.all(self.factor == 1) and np.all(self.offset == 0)
        made = h.Link(
            **binding.all_at(self, "source target" if plain else "source target factor offset"),
            count=len(self.source),
            bank=binding.bank(self.values),
        )
        return h.Instruction(h.LINK, 0, binding.pointer(made))


FIRST = -1  # the stage of inputs that a scenario sets, before all others
TIED = -2  # from here on downwards: the stages of ports that algebraic loops read and set

Blocks = list[tuple[Bank, Block]]


class Network:
    """FMUs, the banks of their values, and the calls of an exchange.

    binding          what C works with
    components       by name
    scenario         the inputs that a scenario drives
    real, whole      banks of the Real values and of all others (Integer, Enumeration, Boolean)
    used             shape (2, real values): what moving inputs were at both ends of a step, else not a number
    connections      those that feed inputs
    loops            what may be algebraic loops
    exchange_calls   all calls of one exchange, in order, but for those that a scenario makes first
    """

    def __init__(
        self,
        system: System,
        slaves: Mapping[str, Slave],
        scenario: Scenario | None = None,
        probes: Iterable[Port] | None = None,
        factors: Mapping[str, int] | None = None,
    ) -> None:
        """probes: what is wanted besides what connections carry; default: all outputs, all that is exposed.

        factors: how many steps components take in one communication step.
        """
        self.system, self.slaves, self.binding = system, slaves, Binding()
        self.components = {
            name: RunningComponent(s, (factors or {}).get(name, 1)) for name, s in slaves.items()
        }
        self.order: OutputOrder = output_order(system)
        self.connections = [c for c in system.connections if system.variable(c.target).causality == "input"]
        self.real, self.whole = Bank(np.float64), Bank(np.int32)
        reads, writes = self._place(probes, scenario.columns if scenario else ())
        self.used = np.full((2, len(self.real.values)), np.nan)
        self.loops = [AlgebraicLoop(self.binding, slaves, cycle) for cycle, _ in self.order.cycles]
        self.exchange_calls = self._exchange(reads, writes)
        self.scenario = DrivenInputs(self, scenario) if scenario else None

    def matters(self, port: Port) -> bool:
        """Does anything that others use depend on this input?"""
        face = self.slaves[port.component].interface
        used = {c.source.variable for c in self.connections if c.source.component == port.component}
        return port.variable not in face.unused_inputs and face.may_affect(port.variable, used)

    def bank(self, port: Port) -> Bank:
        """The bank that holds this port's value."""
        return self.real if self.system.variable(port).is_real else self.whole

    def reader(self, bank: Bank, block: Block) -> Call:
        """The call that reads a block."""
        return self.slaves[block.component].reader([p.variable for p in block.ports], bank.slice(block))

    def writer(self, bank: Bank, block: Block) -> Call:
        """The call that sets a block."""
        return self.slaves[block.component].writer([p.variable for p in block.ports], bank.slice(block))

    def output_reads(self, component: str) -> list[Call]:
        """Calls that read all connected outputs of a component, for sequential masters."""
        sources = {c.source for c in self.connections}
        return [
            self.reader(bank, b)
            for bank in (self.real, self.whole)
            for b in bank.blocks
            if b.component == component and sources & set(b.ports)
        ]

    def input_writes(self, connections: Sequence[Connection]) -> list[Call]:
        """Calls that carry the values of connections over and set the inputs."""
        calls: list[Call] = []
        for bank in (self.real, self.whole):
            links = [c for c in connections if self.bank(c.target) is bank]
            calls += [Link(bank, links)] if links else []
        return calls + self.writers({c.target for c in connections})

    def writers(self, ports: set[Port]) -> list[Call]:
        """Calls that set the blocks which hold these ports."""
        blocks = [(bank, b) for bank in (self.real, self.whole) for b in bank.blocks]
        return [self.writer(bank, b) for bank, b in blocks if ports & set(b.ports)]

    @property
    def notes(self) -> tuple[str, ...]:
        """What to say about the exchange after a run."""
        return self.order.notes + tuple(loop.note for loop in self.loops)

    def fill(self) -> None:
        """Give C the components, the values, their exchange, and the scenario."""
        binding, sim, h = self.binding, self.binding.simulation, self.binding.h
        saved = self.real.values.copy(), self.whole.values.copy()
        binding.components = [*self.components.values()]
        made = binding.array(h.Component, [h.Component()] * len(self.components))
        for one, component in zip(made, binding.components, strict=False):
            component.fill(binding, one)
        sim.components, sim.component_count = binding.pointer(made), len(self.components)
        sim.real, sim.whole = binding.at(self.real.values), binding.at(self.whole.values)
        sim.real_saved, sim.whole_saved = (binding.at(values) for values in saved)
        sim.reals, sim.wholes, sim.used = len(saved[0]), len(saved[1]), binding.at(self.used)
        sim.exchange = binding.program(self.exchange_calls)
        sim.loops = binding.at(np.array([loop.address for loop in self.loops], np.uint64))
        sim.loop_count, sim.rounds_at_start = len(self.loops), self.order.count + 1

    def forget(self) -> None:
        """Free the states that were saved."""
        for component in self.components.values():
            component.forget()

    # ---- building

    def _place(self, probes: Iterable[Port] | None, driven: Iterable[Port]) -> tuple[Blocks, Blocks]:
        """Give every output, probe and fed input its place; returns the blocks to read and to set."""
        last = max(self.order.count - 1, 0)
        wanted = set(self.order.stages if probes is None else probes) | {c.source for c in self.connections}
        numeric = {p for p in wanted if self.system.variable(p).kind != "String"}
        outputs = {p: s for p, s in self.order.stages.items() if p in numeric}
        inputs = {c.target: self.order.stages[c.source] for c in self.connections}
        for i, (cycle, _) in enumerate(self.order.cycles):  # in blocks of their own, which no stage touches
            outputs |= {c.source: (TIED - i,) for c in cycle.connections}
            inputs |= {c.target: (TIED - i,) for c in cycle.connections}
        inputs |= {p: (FIRST,) for p in driven}
        more = self.system.exposed if probes is None else probes
        outputs |= {p: (last,) for p in more if p not in outputs and p not in inputs}
        reads, writes = Blocks(), Blocks()
        for bank in (self.real, self.whole):
            for stages, blocks in ((outputs, reads), (inputs, writes)):
                own = {p: s for p, s in stages.items() if self.bank(p) is bank}
                blocks += [(bank, b) for b in bank.add(self.system, own)]
        return reads, writes

    def _exchange(self, reads: Blocks, writes: Blocks) -> list[Call]:
        """All calls of one exchange, in order."""
        calls: list[Any] = []
        tied = {c.target for loop in self.loops for c in loop.cycle.connections}
        for loop in self.loops:
            loop.bind(self.real.places(loop.inputs), self.real.places(loop.outputs))
        for stage in range(max(self.order.count, 1)):
            calls += [self.reader(bank, b) for bank, b in reads if stage in b.stages]
            solved = zip(self.loops, self.order.cycles, strict=True)
            calls += [loop for loop, (_, stages) in solved if stage in stages]
            for bank in (self.real, self.whole):
                links = [c for c in self.connections if stage in self.order.stages[c.source]]
                links = [c for c in links if self.bank(c.source) is bank and c.target not in tied]
                calls += [Link(bank, links)] if links else []
            calls += [self.writer(bank, b) for bank, b in writes if stage in b.stages]
        return calls


class DrivenInputs:
    """The inputs that a scenario drives, for native/scenario.c.

    moving    those that are continuous, which move at a straight line over a step; other Real ones are steady
              and keep the value of the last sample, as those do that are no Real numbers and are held
    """

    def __init__(self, network: Network, scenario: Scenario) -> None:
        kinds = {port: network.system.variable(port) for port in scenario.columns}
        moving = self.moving = [p for p, v in kinds.items() if v.is_continuous]
        held = [p for p, v in kinds.items() if not v.is_real]
        steady = [p for p in kinds if p not in moving and p not in held]
        self.table, self.writers = scenario.table, network.writers(set(kinds))
        self.targets, self.steady = network.real.places(moving), network.real.places(steady)
        self.held = network.whole.places(held)
        columns = scenario.columns
        self.columns, self.steady_columns, self.held_columns = (
            np.array([columns[p][0] for p in ports], dtype=np.int64) for ports in (moving, steady, held)
        )
        maps = [[columns[p][1] for p in ports] for ports in (moving, steady)]
        self.factor, self.steady_factor = (np.array([m.factor for m in each]) for each in maps)
        self.offset, self.steady_offset = (np.array([m.offset for m in each]) for each in maps)
        self.coming, self.middle = np.zeros(len(moving)), np.zeros(len(moving))

    def fill(self, binding: Binding, inputs: Sequence[int]) -> None:
        """Give them to C; inputs: the numbers of the moving ones among the coupling inputs."""
        arrays = zip(("time", "base", "slopes", "anchor"), self.table.arrays, strict=True)
        made = binding.h.Scenario(
            **{name: binding.at(array) for name, array in arrays},
            **binding.all_at(self, "columns targets factor offset steady_columns steady held_columns held"),
            **binding.all_at(self, "steady_factor steady_offset coming middle"),
            samples=len(self.table.arrays[0]),
            width=self.table.arrays[1].shape[1],
            inputs=binding.at(np.array(inputs, np.int32)),
            count=len(self.moving),
            steady_count=len(self.steady),
            held_count=len(self.held),
            when=np.nan,
            writers=binding.program(self.writers),
        )
        binding.simulation.scenario = binding.pointer(made)
