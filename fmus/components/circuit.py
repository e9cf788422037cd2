"""A hydraulic circuit as a linear graph: nodes with a pressure, branches with a flow (paper, Figs. 2 and 3).

    (C + C_c(P)) dP/dt = sum of the flows into the node        of each node with oil, eq. (9a)
               I dQ/dt = P_start - P_end - drop                of each branch with an oil column, eq. (9a)
                     Q = flow(P_start - P_end)                 of every other branch

C_c is that of the cavity in `chamber`. Nodes and branches have the names of the variables that they are, and
the paper's symbols. Flows of lines, stored energy, heat, cavities and convected energy follow from the table.

Signs: a flow is positive from start to end.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from functools import cached_property
from typing import Any, Protocol

from fmus.components import chamber
from fmus.contract import Quantity, Scalar

SUPPLY, TANK, GROUND = "supply", "tank", "ground"  # lines of a drive, and the atmosphere


class Kind(StrEnum):
    """What a branch is, in the words of a legend."""

    EDGE = "metering edge"
    COMPENSATOR = "pressure compensator"
    COLUMN = "oil column with friction"
    RESISTANCE = "resistance"
    LEAKAGE = "leakage"
    DRAIN = "leakage to the case drain"
    RELIEF = "relief valve"
    ANTI_CAVITATION = "anti-cavitation valve"
    CHECK = "check valve"
    RETURN = "return line"
    THROTTLE = "throttle"
    COUNTERBALANCE = "counterbalance valve"
    PISTON = "piston"
    MOTOR = "motor"
    PUMP = "pump"
    CONSUMER = "drives"
    SOURCE = "pressure source"
    CAPACITANCE = "capacitance"  # of a node, in drawings
    GIVEN = "given pressure"


# output of heat: what is heated, and by branches of which kinds; an edge at the supply line is meter-in
_HEATED: dict[str, tuple[str, tuple[Kind, ...]]] = {
    "engine_friction_heat": ("friction of the engine", ()),
    "pump_friction_heat": ("friction of the pumps", ()),
    "compensator_heat": ("pressure compensator of the {} with its check valve", (Kind.COMPENSATOR,)),
    "meter_in_heat": ("meter-in edges of the {}", ()),
    "check_valve_heat": ("check valves of the {}", (Kind.CHECK,)),
    "hose_heat": ("hoses and lines of the {}", (Kind.COLUMN, Kind.RESISTANCE)),
    "counterbalance_heat": ("counterbalance valves of the {}", (Kind.COUNTERBALANCE,)),
    "meter_out_heat": ("meter-out edges of the {}", (Kind.EDGE,)),
    "throttle_heat": ("throttles of the {}", (Kind.THROTTLE,)),
    "leakage_heat": ("leakage of the {}, with the case drain", (Kind.LEAKAGE, Kind.DRAIN)),
    "relief_heat": ("relief valves of the {}", (Kind.RELIEF,)),
    "make_up_heat": ("anti-cavitation valves of the {}", (Kind.ANTI_CAVITATION,)),
    "return_line_heat": ("return line", (Kind.RETURN,)),
    "brake_heat": ("{} brake", ()),
}
HEATS = {name: Quantity("W", f"Heat of the {text}", 1e3) for name, (text, _) in _HEATED.items()}
CAUSES = {kind: name for name, (_, kinds) in _HEATED.items() for kind in kinds}
# branches whose power is work: the two-ports of the graph, and its ends
WORK = frozenset({Kind.PISTON, Kind.MOTOR, Kind.PUMP, Kind.CONSUMER, Kind.SOURCE})


class Elastic(Protocol):
    """What fills a volume, such as oil: its compliance [1/Pa] and energy [J/m3] at a gauge pressure."""

    def compliance(self, pressure: Scalar, /) -> Scalar:
        """C/V."""

    def energy_density(self, pressure: Scalar, /) -> Scalar:
        """The integral of P C/V from 0."""


@dataclass(frozen=True)
class Node:
    """A pressure [Pa]; that of oil is a state, any other one is given.

    capacitance   C [m3/Pa] without that of `oil`; None: no oil
    volume, oil   volume [m3] with the compliance of this oil, in addition
    cavity        part of the cavity's law that belongs to the node
    """

    pressure: Scalar
    symbol: str = ""
    capacitance: Scalar = None
    volume: Scalar = 0
    oil: Elastic | None = None
    cavity: float = 1.0

    @property
    def energy_density(self) -> Scalar:
        """Energy [J/m3] of the oil."""
        return self.oil.energy_density(self.pressure) if self.oil else 0

    @property
    def energy(self) -> Scalar:
        """Stored energy [J]."""
        if self.capacitance is None:
            return 0
        elastic = self.capacitance * self.pressure**2 / 2 + self.volume * self.energy_density
        return elastic + self.cavity * chamber.stored_energy(self.pressure, 0)

    def rate(self, inflow: Scalar) -> Scalar:
        """dP/dt [Pa/s]."""
        oil = self.volume * self.oil.compliance(self.pressure) if self.oil else 0
        return chamber.pressure_rate(self.pressure, inflow, self.capacitance + oil, self.cavity)


@dataclass(frozen=True)
class Branch:
    """A flow [m3/s] between two nodes.

    flow        state or expression; or a law, the flow over the pressure difference [Pa]
    inertance   I [kg/m4] of an oil column, whose flow is a state
    drop        pressure [Pa] that friction takes; default: all between the nodes
    mechanics   of a two-port: symbols of the speed at its mechanical side, and of the damping there
    series      parts of other kinds in series within the branch: pressure [Pa] that each takes, or a law, the
                pressure over the flow
    """

    start: str
    end: str
    kind: Kind
    flow: Scalar | Callable[[Scalar], Scalar]
    symbol: str = ""
    inertance: Scalar = None
    drop: Scalar = None
    mechanics: tuple[str, ...] = ()
    series: Mapping[Kind, Scalar | Callable[[Scalar], Scalar]] = field(default_factory=dict)


@dataclass(frozen=True)
class Circuit:
    """Nodes and branches by name; a state has the name of its node or branch."""

    nodes: Mapping[str, Node]
    branches: Mapping[str, Branch]

    def __or__(self, other: Circuit) -> Circuit:
        return Circuit({**self.nodes, **other.nodes}, {**self.branches, **other.branches})

    def difference(self, branch: Branch) -> Scalar:
        """Pressure difference [Pa] between the nodes of a branch."""
        return self.nodes[branch.start].pressure - self.nodes[branch.end].pressure

    @cached_property
    def flows(self) -> dict[str, Scalar]:
        """Through variables [m3/s]."""
        items = self.branches.items()
        return {name: b.flow(self.difference(b)) if callable(b.flow) else b.flow for name, b in items}

    @property
    def pressures(self) -> dict[str, Scalar]:
        """Across variables [Pa]."""
        return {name: node.pressure for name, node in self.nodes.items()}

    def through(self, kind: Kind) -> Scalar:
        """Sum of the flows [m3/s] of all branches of a kind."""
        return sum(self.flows[name] for name, b in self.branches.items() if b.kind is kind)

    def into(self, node: str) -> Scalar:
        """Sum of the flows [m3/s] into a node."""
        ends = [self.flows[name] for name, b in self.branches.items() if b.end == node]
        return sum(ends) - sum(self.flows[name] for name, b in self.branches.items() if b.start == node)

    @cached_property
    def rates(self) -> dict[str, Scalar]:
        """Time derivatives of the states: pressures of oil and flows of oil columns."""
        pressures = {n: v.rate(self.into(n)) for n, v in self.nodes.items() if v.capacitance is not None}
        columns = {n: b for n, b in self.branches.items() if b.inertance is not None}
        return pressures | {n: (self.difference(b) - b.drop) / b.inertance for n, b in columns.items()}

    def heat(self) -> dict[str, Scalar]:
        """Power [W] that each branch dissipates."""
        lossy = {name: b for name, b in self.branches.items() if b.kind not in WORK}
        return {
            name: self.flows[name] * (self.difference(b) if b.drop is None else b.drop)
            for name, b in lossy.items()
        }

    @property
    def heats(self) -> dict[str, Scalar]:
        """Power [W] that is dissipated, by the names of `HEATS`."""
        found: dict[str, Scalar] = {}
        for name, heat in self.heat().items():
            b, flow = self.branches[name], self.flows[name]
            drops = {kind: drop(flow) if callable(drop) else drop for kind, drop in b.series.items()}
            parts = [(CAUSES[kind], flow * drop) for kind, drop in drops.items()]
            meter_in = b.kind is Kind.EDGE and SUPPLY in (b.start, b.end)
            own = "meter_in_heat" if meter_in else CAUSES[b.kind]
            for cause, power in (*parts, (own, heat - sum(power for _, power in parts))):
                found[cause] = found.get(cause, 0) + power
        return found

    def work(self, kind: Kind) -> Scalar:
        """Power [W] that all branches of a kind take from the circuit."""
        chosen = {name: b for name, b in self.branches.items() if b.kind is kind}
        return sum(self.flows[name] * self.difference(b) for name, b in chosen.items())

    @property
    def stored_energy(self) -> Scalar:
        """Energy [J] of oil, walls, cavities and oil columns."""
        columns = {n: b for n, b in self.branches.items() if b.inertance is not None}
        kinetic = sum(b.inertance * self.flows[name] ** 2 / 2 for name, b in columns.items())
        return sum(node.energy for node in self.nodes.values()) + kinetic

    @property
    def convected_power(self) -> Scalar:
        """Energy [W] that oil takes along into growing chambers, minus that out of shrinking ones.

        Required for the energy balance (docs/equations.md, section 7).
        """
        pistons = {name: b for name, b in self.branches.items() if b.kind is Kind.PISTON}
        densities = {name: node.energy_density for name, node in self.nodes.items()}
        return sum(self.flows[name] * (densities[b.start] - densities[b.end]) for name, b in pistons.items())

    @property
    def void_volume(self) -> Scalar:
        """Volume [m3] of the cavities."""
        oil = (node for node in self.nodes.values() if node.capacitance is not None)
        return sum(node.cavity * chamber.cavity_volume(node.pressure) for node in oil)

    def outputs(self) -> dict[str, Scalar]:
        """Pressures, flows, balances and heats by name."""
        supplied, returned = -self.into(SUPPLY), self.into(TANK)
        power = self.nodes[SUPPLY].pressure * supplied - self.nodes[TANK].pressure * returned
        heats = self.heats
        return {
            **self.pressures,
            **self.flows,
            **heats,
            "supply_flow": supplied,
            "return_flow": returned,
            "hydraulic_power": power,
            "stored_energy": self.stored_energy,
            "dissipated_power": sum(heats.values()),
            "convected_power": self.convected_power,
            "void_volume": self.void_volume,
            "relief_flow": self.through(Kind.RELIEF),
            "anti_cavitation_flow": self.through(Kind.ANTI_CAVITATION),
            "drain_flow": self.through(Kind.DRAIN),
        }


def lines(u: Any) -> dict[str, Node]:
    """Nodes of the supply and return lines of a drive, and of the atmosphere."""
    return {SUPPLY: Node(u.supply_pressure, "P_s"), TANK: Node(u.tank_pressure, "P_t"), GROUND: Node(0)}
