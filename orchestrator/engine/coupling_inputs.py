"""Which inputs move inside a communication step, and what each of them follows.

native/coupling_input.c makes their polynomials at every step.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from orchestrator.engine.c_library import Binding, engine_h
from orchestrator.engine.masters import Plan
from orchestrator.engine.network import Network
from orchestrator.ssp.power_bonds import find_bonds
from orchestrator.ssp.system import Connection, Port


class CouplingInputs:
    """The inputs of a network that move as a plan says, or are watched.

    ports         of the inputs, those of one component side by side
    inputs        what each of them follows: `CouplingInput` of engine.h
    moving        ports that the master moves, without those that are watched only
    self_moving   ports that FMUs move by themselves, from a rate input or as one
    sloped        outputs whose slopes the FMUs give, and their places; those of one component side by side
    slopes        those slopes, shape (n,)
    """

    def __init__(self, network: Network, plan: Plan) -> None:
        self._network, self._plan = network, plan
        self._h = engine_h()
        self.driven = network.scenario.moving if network.scenario else []
        self._moved = {c.target for c in plan.moved}
        found = self._found()
        self.self_moving = self._find_self_moving({c.target for c in found})
        self._wired = {c.target: c for c in found if c.target not in self.self_moving}
        self.moving = {*self._wired} & self._moved | {*self.driven}
        self.sloped = {p: i for i, p in enumerate(self._find_sloped())}
        self.slopes = np.zeros(len(self.sloped))
        self.ports = [
            p for name in network.slaves for p in (*self._wired, *self.driven) if p.component == name
        ]
        self.inputs = [self._input(p) for p in self.ports]
        self._connect_components()

    def array(self, binding: Binding) -> Any:
        """The inputs side by side, for C."""
        return binding.array(self._h.CouplingInput, self.inputs)

    @property
    def bonds(self) -> list[tuple[int, int]]:
        """Of each power bond the numbers of its effort and its flow, where both move."""
        place, bonds = {p: i for i, p in enumerate(self.ports)}, find_bonds(self._network.system)
        return [(place[b.effort], place[b.flow]) for b in bonds if b.effort in place and b.flow in place]

    @property
    def power(self) -> int:
        """The power of the step that the estimate of the error goes with."""
        if self._plan.passes > 1:
            return self._plan.degree + 1
        order = max((s.order for s in self.inputs), default=0)
        return order + (2 if self._plan.corrected else 1)

    @property
    def notes(self) -> tuple[str, ...]:
        """What the master has to do without."""
        if not self._plan.sloped:
            return ()
        names, h = {i: str(p) for p, i in self._network.real.index.items()}, self._h
        wired = [s for s in self.inputs if s.source_component != h.DRIVEN and s.wanted]
        asked = [self._plan.asks(name) for name in self._network.slaves]
        differences = [s.source for s in wired if s.slope_index == h.NO_SLOPE and asked[s.source_component]]
        notes = {
            "slopes from differences of values, because the FMUs give none": differences,
            "inputs held at their mean over a step, because the FMUs take no slopes": [
                s.target for s in wired if s.degree == 0
            ],
            "inputs moved at straight lines, because the FMUs take no curves": [
                s.target for s in wired if 0 < s.degree < s.wanted
            ],
        }
        return tuple(f"{what}: {listed([names[i] for i in which])}" for what, which in notes.items() if which)

    # ---- which

    def _found(self) -> list[Connection]:
        """The connections that may move their inputs, or whose inputs are watched."""
        plan, network = self._plan, self._network
        variable = network.system.variable
        known = network.system.connections if plan.watches else plan.moved
        found = [c for c in known if variable(c.target).is_continuous and variable(c.source).is_continuous]
        return [c for c in found if variable(c.target).causality == "input" and network.matters(c.target)]

    def _find_self_moving(self, moved: set[Port]) -> set[Port]:
        """Inputs that move by themselves, with a rate input, or that merely are the rate of a moved one."""
        network = self._network
        fed = {c.target for c in network.connections}
        power = {p for bond in find_bonds(network.system) for p in (bond.effort, bond.flow)}
        found = set[Port]()
        for name, slave in network.slaves.items():
            for u, rate in slave.interface.rate_inputs.items():
                port, speed = Port(name, u), Port(name, rate)
                if u not in slave.interface.ramp_inputs and speed in fed:
                    found.add(port)
                if port in moved and port not in found and speed not in power:
                    found.add(speed)
        return found

    # ---- slopes of their sources

    def _find_sloped(self) -> Iterable[Port]:
        """The outputs whose slopes are wanted and given, component by component."""
        sources = dict.fromkeys(c.source for c in self._wired.values() if self._plan.asks(c.source.component))
        slaves = self._network.slaves
        inputs = (*self._wired, *self.driven)
        held = {p for p in inputs if not slaves[p.component].input_degree(p.variable, 1)}
        for name, slave in slaves.items():
            mine = [p for p in sources if p.component == name and not self._blind(p, held)]
            given = set(slave.outputs_with_derivatives([p.variable for p in mine]) if mine else ())
            yield from (p for p in mine if p.variable in given)

    def _blind(self, output: Port, held: set[Port]) -> bool:
        """Would its FMU give a slope without that of an input, because it takes none?"""
        depends = self._network.slaves[output.component].interface.direct_inputs(output.variable)
        return any(Port(output.component, u) in held for u in depends)

    # ---- what they follow

    def _input(self, port: Port) -> Any:
        wire = self._wired.get(port)
        nominal = self._network.system.variable(port).nominal or 1.0  # 1 if not declared, by the standard
        target = self._network.real.index[port]
        return self._h.CouplingInput(
            target=target,
            scale=abs(nominal),
            **(self._follow(port, wire) if wire else self._follow_scenario(port)),
        )

    def _follow_scenario(self, port: Port) -> dict[str, Any]:
        degree = self._network.slaves[port.component].input_degree(port.variable, 1)
        driven, none = self._h.DRIVEN, self._h.NO_SLOPE
        return {"source": -1, "source_component": driven, "slope_index": none, "degree": degree, "wanted": 1}

    def _follow(self, port: Port, wire: Connection) -> dict[str, Any]:
        network, plan, moved = self._network, self._plan, port in self._moved
        slave, source = network.slaves[port.component], wire.source
        rate = Port(port.component, slave.interface.rate_inputs.get(port.variable, ""))
        rated = any(c.target == rate for c in network.connections)  # then it moves by itself, at a line
        wanted = max(plan.extrapolation, plan.degree, int(plan.corrected)) if moved else 0
        return {
            "source": network.real.index[source],
            "factor": wire.map.factor,
            "offset": wire.map.offset,
            "source_component": list(network.slaves).index(source.component),
            "slope_index": self.sloped.get(source, self._h.NO_SLOPE),
            "degree": slave.input_degree(port.variable, wanted),
            "wanted": wanted,
            "order": plan.extrapolation if moved else min(1, plan.extrapolation + rated),
            "autonomous": not network.system.components[source.component].interface.of("input"),
        }

    # ---- the components

    def _connect_components(self) -> None:
        """Let the components set their inputs, and read the slopes of their outputs."""
        first = 0
        for name, component in self._network.components.items():
            mine = [p.variable for p in self.ports if p.component == name]
            inputs = self.inputs[first : first + len(mine)]
            component.follow(first, mine, inputs, self._plan.corrected)
            first += len(mine)
            outputs = {p.variable: i for p, i in self.sloped.items() if p.component == name}
            if outputs:
                rows = [*outputs.values()]
                into = self.slopes[rows[0] : rows[-1] + 1]
                component.slope_reads = [component.slave.output_derivative_reader(list(outputs), into)]

    def held(self, order: Sequence[int]) -> list[list[Connection]]:
        """Of each component the connections from earlier ones whose inputs do not move."""
        names, moving = list(self._network.slaves), self.moving | self.self_moving
        found: list[list[Connection]] = [[] for _ in names]
        for i, k in enumerate(order):
            early = {names[j] for j in order[:i]}
            fed = [c for c in self._network.connections if c.target.component == names[k]]
            found[k] = [c for c in fed if c.source.component in early and c.target not in moving]
        return found


SHOWN = 4  # names in a list


def listed(names: Iterable[str]) -> str:
    """The first names, each once, and how many more there are."""
    found = list(dict.fromkeys(names))
    more = f" and {len(found) - SHOWN} more" if len(found) > SHOWN else ""
    return f"{', '.join(found[:SHOWN])}{more}"
