"""Clocks of FMI 3.0 for Co-Simulation: which tick in an instant, and the variables that belong to them.

Tick k of a periodic clock is at start + shift + k interval, in fractions of the numbers of the FMU: clocks
meet exactly and none drifts. Clocks that are due within the tolerance of an instant tick together. A
triggered input clock ticks with the clock that is connected to it, before discrete states are updated.
Variables of a clock are set and read only while it ticks, sources before the inputs that they feed, the
inputs of an FMU before its outputs; in between others see their last values.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

from orchestrator.base.text import grouped
from orchestrator.engine.network import Network
from orchestrator.fmi.clocks import ClockCalls, Schedule
from orchestrator.fmi.cosimulation import RunningFmu
from orchestrator.fmi.description import FmuVariable
from orchestrator.fmi.instance import MAX_EVENT_ITERATIONS, Unsettled
from orchestrator.ssp.dependencies import strongly_connected
from orchestrator.ssp.system import Port


@dataclass
class Stage:
    """A part of an instant: clocks that tick at its beginning, then variables, then clocks that are asked.

    inputs     input clocks that may tick
    programs   those that set or read variables, in order, with the clocks of which one has to tick
    outputs    output clocks
    """

    inputs: set[Port] = field(default_factory=set)
    programs: list[tuple[set[Port], Any]] = field(default_factory=list)
    outputs: list[Port] = field(default_factory=list)


class Clocks:
    """The clocks of a run."""

    def __init__(self, network: Network, start: float) -> None:
        self._network, self._schedule, system = network, (schedule := Schedule(start)), network.system
        self.finish, self.saved, self.resume = schedule.finish, schedule.saved, schedule.resume
        self._variables = dict[Port, set[Port]]()  # variable -> its clocks
        self._calls = dict[Port, tuple[ClockCalls, FmuVariable]]()  # of clocks
        self._given = dict[Port, Any]()  # input -> what it was set to in this instant
        self.pending, self._active = set[Port](), set[Port]()
        self._wires = grouped(
            [c for c in system.connections if system.variable(c.source).kind == "Clock"], lambda c: c.source
        )
        self._sources = {c.target: c.source for c in system.connections}
        recorded = {*network.reals.index, *network.integers.index}
        for name, component in system.components.items():
            of_component = component.interface.variables.values()
            own_clocks = {v.reference: Port(name, v.name) for v in of_component if v.kind == "Clock"}
            for v in of_component:
                own = Port(name, v.name)
                if v.kind == "Clock" or not v.clocked:
                    continue
                driven = own in network.held_values and own not in self._sources
                if component.has_start(v.name) and not driven:  # until its clock ticks
                    network.store(own, component.value(v.name))
                needed = own in recorded and v.causality != "input"
                if needed or v.causality == "output" or own in network.held_values:
                    self._variables[own] = {own_clocks[r] for r in v.clocks if r in own_clocks}
            slave = network.slaves[name]
            assert isinstance(slave, RunningFmu)
            for port in own_clocks.values():
                if (clock := system.variable(port)).causality in ("input", "output"):
                    self._calls[port] = slave.clocks, clock
                    schedule.add(port, slave.clocks, clock)
        self._circular = False
        self._stages = self._staged(self._levels([*self._calls, *self._variables]))
        self._joined = dict[tuple[Any, ...], Any]()

    def _is_input(self, port: Port) -> bool:
        return self._network.system.variable(port).causality == "input"

    def _levels(self, ports: list[Port]) -> list[list[Port]]:
        """Clocks and their variables, each behind what it depends on.

        All outputs of an FMU follow its inputs, as it may refuse these in an instant once an output was read;
        if FMUs exchange values both ways, only those that they declare. What remains circular is repeated.
        """
        inputs = grouped(filter(self._is_input, ports), lambda port: port.component)
        after = {p: self._before(p, inputs.get(p.component, ())) & {*ports} for p in ports}
        level = dict[Port, int]()
        for group in strongly_connected(after):
            if len(group) > 1:
                components = self._network.system.components
                for p in group:
                    direct = components[p.component].interface.direct_inputs(p.variable)
                    known = [u for u in inputs.get(p.component, ()) if u.variable in direct]
                    after[p] = self._before(p, known) & {*ports}
                group, parts = [], strongly_connected({p: after[p] & {*group} for p in group})
                for part in parts:
                    group += self._opened(part, after)
            for p in group:
                level[p] = 1 + max((level.get(q, -1) for q in after[p]), default=-1)
        return [[p for p in ports if level[p] == k] for k in range(max(level.values(), default=-1) + 1)]

    def _opened(self, part: list[Port], after: dict[Port, set[Port]]) -> list[Port]:
        """Ports that depend on each other in an order: FMU by FMU, inputs before outputs."""
        if len(part) > 1:
            self._circular = True
            place = {p: (p.component, not self._is_input(p), p in self._variables) for p in part}
            part.sort(key=lambda p: place[p])
            for p in part:
                after[p] = after[p] - {*part} | {q for q in part if place[q] < place[p]}
        return part

    def _before(self, port: Port, inputs: Iterable[Port]) -> set[Port]:
        """What a clock or a variable depends on; inputs: of its FMU, on which an output depends.

        Inputs that are set in one call depend on the sources of all of them.
        """
        clocks = self._variables.get(port, set())
        if not self._is_input(port):
            return clocks | {*inputs}
        together = self._network.together(port)
        return clocks | {self._sources[p] for p in together if p in self._sources}

    def _staged(self, levels: list[list[Port]]) -> list[Stage]:
        """The stages of an instant: as few as clocks allow that tick with others, which are asked before."""
        stages = [Stage()]
        for ports in levels:
            clocks = [p for p in ports if p in self._calls]
            ticking = {*filter(self._is_input, clocks)}
            if stages[-1].outputs or ticking & {*self._sources}:
                stages.append(Stage())
            stages[-1].inputs |= ticking
            stages[-1].outputs += [p for p in clocks if p not in ticking]
            variables = [p for p in ports if p in self._variables]
            of = grouped(variables, lambda p: (not self._is_input(p), *sorted(self._variables[p])))
            for (reads, *_), same in sorted(of.items()):
                program = self._program_of(same, bool(reads))
                stages[-1].programs.append((self._variables[same[0]], program))
        return stages

    def _program_of(self, ports: list[Port], reads: bool) -> Any:
        """The program that reads variables, or sets inputs from their sources."""
        network, texts = self._network, [p for p in ports if not self._network.system.variable(p).is_number]
        calls: list[Any] = [*(network.get_calls if reads else network.set_calls)({*ports})]
        if calls and not reads:
            if self._circular:
                program = network.binding.program(calls)
                calls = [partial(self._set_numbers, network.together(ports[0]), program)]
            calls = [*network.copies([c for c in network.connections if c.target in ports]), *calls]
        texts_of = self._read_text if reads else self._set_text
        return network.binding.program([*calls, *(partial(texts_of, p) for p in texts)])

    def _set_numbers(self, ports: Sequence[Port], program: Any) -> None:
        """Set numbers, in a round of FMUs that exchange values both ways only if they are others."""
        values = [self._network.value(port) for port in ports]
        if self._given.get(ports[0]) != values:
            self._given[ports[0]] = values
            self._network.binding.run(program)

    def _set_text(self, port: Port) -> None:
        value = self._network.texts.last.get(self._sources.get(port, port))
        if value is not None and self._given.get(port) != value:  # one that its clock has given
            self._network.slaves[port.component].set(port.variable, value)
            self._network.store(port, value)
            self._given[port] = value

    def _read_text(self, port: Port) -> None:
        self._network.store(port, self._network.slaves[port.component].get(port.variable), ticks=True)

    @property
    def next(self) -> float:
        """Time of the next tick [s]; infinite if there is none."""
        return self._schedule.next

    def begin(self, t: float, tolerance: float) -> list[Port]:
        """The clocks that are due at a time [s], see `Schedule.begin`, are to tick."""
        due: list[Port] = self._schedule.begin(t, tolerance)
        self.pending = {*due}
        return due

    def propagate(self) -> list[str]:
        """Let clocks tick until no other one does, with their variables; returns the names of the clocks."""
        ticked = list[Port]()
        for of_instant in (self._active, self._given, self._network.texts.of_ticks):
            of_instant.clear()
        for _ in range(MAX_EVENT_ITERATIONS):
            before = self._values() if self._circular else ()
            for k, stage in enumerate(self._stages):
                for port in sorted(self.pending & stage.inputs) if self.pending else ():
                    calls, clock = self._calls[port]
                    calls.tick(clock)
                    self._add(port, ticked)
                if self._active and stage.programs:
                    self._network.binding.run(self._program(k))
                for port in stage.outputs:
                    calls, clock = self._calls[port]
                    if port not in self._active and calls.ticks(clock):
                        self._add(port, ticked)
            if not self.pending and (not self._active or before == (self._values() if before else ())):
                return [*map(str, ticked)]
        raise Unsettled(
            f"{self._network.system.name}: the clocks do not settle: {', '.join(map(str, ticked[-3:]))}"
        )

    def _add(self, port: Port, ticked: list[Port]) -> None:
        """A clock has ticked: those that are connected to it are to tick."""
        ticked.append(port)
        self._active.add(port)
        self.pending = (self.pending | {c.target for c in self._wires.get(port, ())}) - self._active

    def _program(self, k: int) -> Any:
        """The program of a stage for the clocks that tick."""
        program = self._joined.get(key := (k, *sorted(self._active)))
        if program is None:
            parts = [program for clocks, program in self._stages[k].programs if clocks & self._active]
            program = self._joined[key] = self._network.binding.joined(parts)
        return program

    def _values(self) -> tuple[bytes, bytes, dict[Port, str]]:
        network = self._network
        return network.reals.values.tobytes(), network.integers.values.tobytes(), {**network.texts.last}
