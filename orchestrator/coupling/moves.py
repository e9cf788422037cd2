"""Which inputs move inside a step, and what each of them follows."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from orchestrator.coupling.masters.plan import Plan
from orchestrator.coupling.signal import DRIVEN, NO_SLOPE, Signal
from orchestrator.coupling.wiring import Wiring
from orchestrator.system.bonds import find_bonds
from orchestrator.system.system import Connection, Port


class Moves:
    """What a plan moves in a wiring.

    carried   inputs that the FMUs move by themselves, from a rate input or as one
    moving    inputs that the master moves
    told      outputs whose slopes the FMUs tell, and their places; those of one component side by side
    """

    def __init__(self, wiring: Wiring, driven: Sequence[Port], plan: Plan) -> None:
        """driven: the inputs that move because a scenario does."""
        self._wiring, self._driven, self._plan = wiring, driven, plan
        self._moved = {c.target for c in plan.moved}
        found = self._found()
        self.carried = self._carried({c.target for c in found})
        self._wired = {c.target: c for c in found if c.target not in self.carried}
        self.moving = {*self._wired} & self._moved | {*driven}
        self.told = {p: i for i, p in enumerate(self._told())}

    def ports(self, component: str) -> list[Port]:
        """The inputs of a component that move or are watched."""
        return [p for p in (*self._wired, *self._driven) if p.component == component]

    def signal(self, port: Port) -> Signal:
        """One of these inputs."""
        wire = self._wired.get(port)
        return self._follows(port, wire) if wire else self._is_driven(port)

    # ---- which

    def _found(self) -> list[Connection]:
        """The connections that may move their inputs, or whose inputs are watched."""
        plan, variable = self._plan, self._wiring.system.variable
        known = self._wiring.system.connections if plan.watches else plan.moved
        found = [c for c in known if variable(c.target).is_continuous and variable(c.source).is_continuous]
        return [
            c for c in found if variable(c.target).causality == "input" and self._wiring.matters(c.target)
        ]

    def _carried(self, moved: set[Port]) -> set[Port]:
        """Inputs that move by themselves, with a rate input, or that merely are the rate of a moved one."""
        wiring = self._wiring
        fed = {c.target for c in wiring.connections}
        power = {p for bond in find_bonds(wiring.system) for p in (bond.effort, bond.flow)}
        carried = set[Port]()
        for name, slave in wiring.slaves.items():
            for u, rate in slave.interface.rates.items():
                port, speed = Port(name, u), Port(name, rate)
                if u not in slave.interface.sloped and speed in fed:
                    carried.add(port)
                if port in moved and port not in carried and speed not in power:
                    carried.add(speed)
        return carried

    # ---- slopes of their sources

    def _told(self) -> Iterable[Port]:
        """The outputs whose slopes are wanted and told, component by component."""
        sources = dict.fromkeys(c.source for c in self._wired.values() if self._plan.asks(c.source.component))
        slaves = self._wiring.slaves
        inputs = (*self._wired, *self._driven)
        held = {p for p in inputs if not slaves[p.component].follows(p.variable, 1)}
        for name, slave in slaves.items():
            mine = [p for p in sources if p.component == name and not self._blind(p, held)]
            told = set(slave.tells([p.variable for p in mine]) if mine else ())
            yield from (p for p in mine if p.variable in told)

    def _blind(self, output: Port, held: set[Port]) -> bool:
        """Would its FMU tell a slope without that of an input, because it takes none?"""
        depends = self._wiring.slaves[output.component].interface.depends(output.variable)
        return any(Port(output.component, u) in held for u in depends)

    # ---- what they follow

    def _is_driven(self, port: Port) -> Signal:
        return Signal(
            target=self._wiring.real.index[port],
            source=-1,
            factor=1.0,
            offset=0.0,
            maker=DRIVEN,
            slope=NO_SLOPE,
            degree=self._wiring.slaves[port.component].follows(port.variable, 1),
            wanted=1,
            scale=self._scale(port),
        )

    def _follows(self, port: Port, wire: Connection) -> Signal:
        wiring, plan, moved = self._wiring, self._plan, port in self._moved
        slave = wiring.slaves[port.component]
        rate = Port(port.component, slave.interface.rates.get(port.variable, ""))
        rated = any(c.target == rate for c in wiring.connections)  # then it moves by itself, at a line
        wanted = max(plan.order, plan.degree, int(plan.corrected)) if moved else 0
        return Signal(
            target=wiring.real.index[port],
            source=wiring.real.index[wire.source],
            factor=wire.map.factor,
            offset=wire.map.offset,
            maker=list(wiring.slaves).index(wire.source.component),
            slope=self.told.get(wire.source, NO_SLOPE),
            degree=slave.follows(port.variable, wanted),
            wanted=wanted,
            order=plan.order if moved else min(1, plan.order + rated),
            free=not wiring.system.components[wire.source.component].interface.of("input"),
            scale=self._scale(port),
        )

    def _scale(self, port: Port) -> float:
        return abs(self._wiring.system.variable(port).nominal or 1.0)  # 1 if not declared, by the standard
