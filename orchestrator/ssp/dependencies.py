"""Direct feed-through between components: the order in which outputs are read, and algebraic loops.

An output without feed-through can be read directly after a step. An output with feed-through can be read when
the inputs that it depends on are set. Outputs that depend on each other are a `DependencyCycle`. If the FMUs
declare these dependencies, the cycle is an algebraic loop, which is solved. If an FMU declares none, values
are first copied along the connections, and the loop is solved only if they do not settle
(`engine/algebraic_loop.py`).
"""

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import wraps
from itertools import pairwise
from typing import TYPE_CHECKING, Any, Concatenate, ParamSpec, TypeVar

from orchestrator.base.errors import Problem
from orchestrator.base.text import first_names
from orchestrator.ssp.system import Connection, Port, System

if TYPE_CHECKING:
    from orchestrator.ssp.coupling import Coupling

MAX_CONNECTIONS = 6  # in a message


@dataclass(frozen=True)
class DependencyCycle:
    """Outputs that depend on each other: an algebraic loop, or a potential one.

    connections   Real connections from outputs of the cycle to inputs that its outputs depend on
    declared      the FMUs declare these dependencies; else some FMU declares none, and there may be no loop
    rounds        how often its outputs are read, because some are not Real and cannot be solved for; else 1
    discrete      an output that is not Real in a cycle of declared dependencies
    passes        how often values are copied before a loop is assumed; 0 for a declared loop
    text          description of the loop, for the beginning of a note or a message
    """

    connections: tuple[Connection, ...]
    declared: bool
    rounds: int
    discrete: Port | None
    passes: int
    text: str


@dataclass(frozen=True)
class OutputOrder:
    """The order in which outputs are read at a communication point, in stages 0, 1, ...

    stages   output -> its stages
    notes    remarks for the user
    cycles   dependency cycles with their stages, in which their outputs are read and their inputs are set
    """

    stages: Mapping[Port, tuple[int, ...]]
    notes: tuple[str, ...] = ()
    cycles: tuple[tuple[DependencyCycle, tuple[int, ...]], ...] = ()

    @property
    def count(self) -> int:
        return max((s[-1] for s in self.stages.values()), default=-1) + 1


P = ParamSpec("P")
T = TypeVar("T")


def of_structure(function: Callable[Concatenate[System, P], T]) -> Callable[Concatenate[System, P], T]:
    """A function of a system that follows from FMUs and connections, not from values: its last result stays.

    Of many runs of a system the first one finds what it needs, those in one process as those in another.
    """
    last: list[tuple[Any, T]] = []

    @wraps(function)
    def kept(system: System, /, *arguments: P.args, **options: P.kwargs) -> T:
        interfaces = [(name, component.interface) for name, component in system.components.items()]
        made_of = interfaces, system.connections, arguments, options
        for before, result in last:
            same = len(before[0]) == len(interfaces) and all(
                a[0] == b[0] and a[1] is b[1] for a, b in zip(before[0], interfaces, strict=True)
            )
            if same and before[1:] == made_of[1:]:
                return result
        result = function(system, *arguments, **options)
        last[:] = [(made_of, result)]
        return result

    return kept


@of_structure
def influential_inputs(system: System) -> frozenset[Port]:
    """Inputs that influence a state, directly or through outputs that feed such inputs elsewhere.

    In an FMU with events each input may, as its dependencies are those between two events.
    """
    interfaces = {name: component.interface for name, component in system.components.items()}
    candidates = {
        Port(name, v.name)
        for name, interface in interfaces.items()
        for v in interface.of("input")
        if v.name not in interface.unused_inputs or interface.has_events
    }
    found = {
        p
        for p in candidates
        if interfaces[p.component].has_events or interfaces[p.component].may_affect_states(p.variable)
    }
    while True:
        sources = {c.source for c in system.connections if c.target in found}
        direct = ((y.component, interfaces[y.component].direct_inputs(y.variable)) for y in sources)
        new = {Port(name, u) for name, inputs in direct for u in inputs} & candidates - found
        if not new:
            return frozenset(found)
        found |= new


def uses_events(system: System, coupling: "Coupling") -> bool:
    """Do FMUs stop at their events, and go through them together?

    A single FMU does, and several whose steps may end at announced events. Otherwise events take place inside
    of the FMUs.
    """
    clocks = any(c.interface.has_clocks for c in system.components.values())
    own = bool(coupling.method.step)
    return clocks or (_would_use_events(system) and (own or divides_at_events(system) or not _fixed(system)))


def divides_at_events(system: System) -> bool:
    """May steps end at announced events and ticks? Not beside an FMU with a fixed step."""
    return all(component.interface.variable_step for component in system.components.values())


def locates_events(system: System, coupling: "Coupling") -> bool:
    """Can steps be repeated until they end at an event? Otherwise instants are at the end of steps."""
    return not coupling.method.step and not _fixed(system)


def _would_use_events(system: System) -> bool:
    """Would FMUs stop at their events, if the steps of all could be repeated?"""
    declare = _declaring(system)
    if len(system.components) == 1:
        return bool(declare)
    wires = _influential_wires(system) if declare else ()
    into_event_mode = (c for c in wires if c.target.component in declare and not system.is_continuous(c))
    return any(c.source.component in declare for c in wires) or any(into_event_mode)


def _declaring(system: System) -> set[str]:
    return {name for name, component in system.components.items() if component.interface.declares_events}


def _influential_wires(system: System) -> list[Connection]:
    influential = influential_inputs(system)
    return [c for c in system.connections if c.target in influential]


def _fixed(system: System) -> dict[str, str]:
    """Components whose steps cannot be repeated with another length, and why; one alone needs not."""
    interfaces = {name: component.interface for name, component in system.components.items()}
    reasons = {n: "cannot restore a saved state" for n, i in interfaces.items() if not i.rollback}
    reasons |= {n: "has a fixed step" for n, i in interfaces.items() if not i.variable_step}
    return reasons if len(interfaces) > 1 else {}


def late_notes(system: System, coupling: "Coupling") -> tuple[str, ...]:
    """A note on effects that may come up to a step late, and why."""
    if not (late := late_effects(system, coupling)):
        return ()
    note = f"effects of {late} on other FMUs may come up to a step late"
    reasons = {} if coupling.method.step or not _would_use_events(system) else _fixed(system)
    more = f", as {len(reasons) - 1} more" if len(reasons) > 1 else ""
    return (note + "".join([f", because {name} {why}{more}" for name, why in reasons.items()][:1]),)


@of_structure
def untold_outputs(system: System) -> tuple[Port, ...]:
    """Continuous outputs that influence a state, and may do anything between two communication points.

    Those of components that feed a rate input do not: they are made to be followed inside a step.
    """
    rates = {*system.rate_ports.values()}
    told = {c.source.component for c in system.connections if c.target in rates}
    sources = dict.fromkeys(c.source for c in _influential_wires(system) if system.is_continuous(c))
    models = {name: component.interface.model for name, component in system.components.items()}
    return tuple(
        p for p in sources if p.component not in told and p.variable not in models[p.component].noisy_outputs
    )


def influential_events(system: System) -> str:
    """The events that may influence a state of another FMU; or nothing."""
    having = {name for name, component in system.components.items() if component.interface.has_events}
    sources = dict.fromkeys(c.source.component for c in _influential_wires(system))
    return first_names(f"events of {name}" for name in sources if name in having)


def estimates_errors(system: System) -> bool:
    """Do the FMUs declare what the estimate of errors during a run needs, and have no events?"""
    wired = {connection.target.component for connection in system.connections}
    fed = wired & {port.component for port in influential_inputs(system)}
    linear = all(system.components[name].interface.linearisable for name in fed)
    return bool(fed) and linear and not influential_events(system)


@of_structure
def late_effects(system: System, coupling: "Coupling") -> str:
    """The events, and signals that are not continuous, that may take effect up to a step late; or nothing.

    Only those that influence a state of another FMU: an FMU has its own events at their time.
    """
    wires = _influential_wires(system)
    having = {name for name, component in system.components.items() if component.interface.has_events}
    declare = _declaring(system) if uses_events(system, coupling) else set[str]()
    if locates_events(system, coupling):
        wires = [c for c in wires if c.source.component not in declare]
    announced = declare if divides_at_events(system) else set[str]()
    held = [c for c in wires if not system.is_continuous(c) and c.source.component not in announced]
    events = [c.source.component for c in wires if c not in held and c.source.component in having]
    late = [f"events of {name}" for name in events if name not in announced]
    if silent := [name for name in events if name in announced]:
        late.insert(0, f"events not announced by {first_names(silent)}")
    return first_names([*late, *(str(c.source) for c in held)])


@of_structure
def output_order(system: System, driven: Collection[Port] = ()) -> OutputOrder:
    """The stages of all outputs of the system during the run.

    driven   inputs and tunable parameters that are set after stage 0; any output may depend on a parameter
    """
    feedthrough = Feedthrough(system)
    graph = feedthrough.graph
    stages: dict[Port, tuple[int, ...]] = {}
    notes: list[str] = []
    cycles: list[tuple[DependencyCycle, tuple[int, ...]]] = []
    for group in strongly_connected(graph):
        first = 1 + max((stages[p][-1] for y in group for p in graph[y] if p not in group), default=-1)
        tuned = {p.component for p in driven if system.variable(p).causality != "input"}
        if any(y.component in tuned or feedthrough.depends(y).intersection(driven) for y in group):
            first = max(first, 1)
        cycle = feedthrough.cycle(group)
        cycle_stages = tuple(range(first, first + (cycle.rounds if cycle else 1)))
        stages |= dict.fromkeys(group, cycle_stages)
        if cycle is None:
            continue
        if cycle.discrete:
            kind = system.variable(cycle.discrete).kind
            expected = "expected Real signals, to be solved for"
            raise Problem(f"{cycle.text}: {expected}, got {kind} {cycle.discrete}")
        if cycle.rounds > 1:
            often = f"read {cycle.rounds} times per step"
            notes.append(f"{cycle.text}; its signals that are not Real are {often}")
        cycles += [(cycle, cycle_stages)] if cycle.connections else []
    return OutputOrder(stages, tuple(notes), tuple(cycles))


@of_structure
def initial_groups(system: System) -> Sequence[tuple[list[Port], DependencyCycle | None]]:
    """Outputs that are read together in initialisation mode, and their cycle if they depend on each other."""
    feedthrough = Feedthrough(system, initially=True)
    return [(group, feedthrough.cycle(group)) for group in strongly_connected(feedthrough.graph)]


@of_structure
def gauss_seidel_order(system: System) -> list[str]:
    """Names of the components in the order in which Gauss-Seidel steps them.

    The next component is the one with the fewest inputs that have feed-through to its outputs and whose
    source has not stepped yet; those that it has to hold, for want of a connected rate port, count before all
    of them. Among equal ones it is the one with the fewest inputs whose source has not stepped yet, then one
    that holds its inputs before one that interpolates them (which gains from a later position), then the
    first in the system.
    """
    connected = {c.target for c in system.connections}
    with_rate = {port for port, rate in system.rate_ports.items() if rate in connected}
    with_feedthrough = {
        (c.name, u)
        for c in system.components.values()
        for y in c.interface.of("output")
        for u in c.interface.direct_inputs(y.name)
    }
    remaining, order = list(system.components), list[str]()
    incoming: dict[str, list[Connection]] = {name: [] for name in remaining}
    for c in system.connections:
        if c.source.component != c.target.component:
            incoming[c.target.component].append(c)

    def waiting_inputs(name: str) -> tuple[int, int, int, bool]:
        targets = [c.target for c in incoming[name] if c.source.component in waiting]
        interpolates = bool(system.components[name].interface.ramp_inputs)
        direct = with_feedthrough.intersection(targets)
        return len(direct - with_rate), len(direct), len(targets), interpolates

    while remaining:
        waiting = {*remaining}
        order.append(min(remaining, key=waiting_inputs))
        remaining.remove(order[-1])
    return order


class Feedthrough:
    """Direct dependencies of outputs in a system.

    graph   output -> outputs that it depends on through connections
    """

    def __init__(self, system: System, initially: bool = False) -> None:
        """initially: dependencies in initialisation mode; default: those of the run."""
        self._system, self._initially = system, initially
        source = {c.target: c.source for c in system.connections if not self._is_sampled(c)}
        self.graph: dict[Port, list[Port]] = {}
        for component in system.components.values():
            for v in component.interface.variables.values():
                if v.causality in ("output", "calculatedParameter"):
                    output = Port(component.name, v.name)
                    self.graph[output] = [source[u] for u in sorted(self.depends(output)) if u in source]

    def _is_sampled(self, connection: Connection) -> bool:
        """Does it carry values at the ticks of a clock only? Clocks themselves tick together in a run."""
        ends = [self._system.variable(port) for port in (connection.source, connection.target)]
        if ends[0].kind == "Clock":
            return self._initially or ends[0].causality == "input"
        return any(v.clocked for v in ends)

    def depends(self, output: Port) -> set[Port]:
        """The variables of its component that an output depends on; all if the FMU declares none."""
        interface = self._system.components[output.component].interface
        names = interface.initial_knowns if self._initially else interface.direct_inputs
        return {Port(output.component, name) for name in names(output.variable)}

    def declares(self, output: Port) -> bool:
        """Does the FMU declare what an output depends on?"""
        interface = self._system.components[output.component].interface
        declared = interface.initial_dependencies if self._initially else interface.dependencies
        return declared.get(output.variable) is not None

    def cycle(self, group: list[Port]) -> DependencyCycle | None:
        """The cycle of a strongly connected group of outputs; None for one output without self-dependency."""
        if not _circular(self.graph, group):
            return None
        declared = {y: [p for p in self.graph[y] if p in group and self.declares(y)] for y in group}
        loops = [g for g in strongly_connected(declared) if _circular(declared, g)]
        involved = sorted({y.component for y in group})
        discrete = [y for y in group if not self._real(y)]
        needed = set().union(*map(self.depends, group))
        inside = [c for c in self._system.connections if c.source in group and c.target in needed]
        return DependencyCycle(
            connections=tuple(c for c in inside if self._real(c.source)),
            declared=bool(loops),
            rounds=len(involved) + 1 if discrete else 1,
            discrete=next((y for g in loops for y in g if y in discrete), None),
            passes=0 if loops else len(involved) + 1,
            text=self._loop_text(loops[0], inside) if loops else self._undeclared_text(group, involved),
        )

    def _real(self, port: Port) -> bool:
        return self._system.variable(port).is_real

    def _loop_text(self, group: list[Port], inside: list[Connection]) -> str:
        """The connections of a loop; the first ones form a closed path."""
        first = [self._connection(*pair) for pair in pairwise(_closed_path(self.graph, group))]
        names = [str(c) for c in dict.fromkeys([*first, *inside])]
        more = f", and {len(names) - MAX_CONNECTIONS} more" if len(names) > MAX_CONNECTIONS else ""
        return f"algebraic loop {', '.join(names[:MAX_CONNECTIONS])}{more}"

    def _undeclared_text(self, group: list[Port], involved: list[str]) -> str:
        undeclared = ", ".join(sorted(str(y) for y in group if not self.declares(y)))
        message = f"{undeclared}: direct dependencies are not declared"
        return f"{message}, which would make an algebraic loop of {' and '.join(involved)}"

    def _connection(self, source: Port, output: Port) -> Connection:
        """The connection by which `source` reaches `output`."""
        inputs = self.depends(output)
        return next(c for c in self._system.connections if c.source == source and c.target in inputs)


# ---- graphs; the import of NetworkX would take longer than a short run -------------------------------------

Graph = Mapping[Port, Iterable[Port]]  # node -> nodes that it depends on


def strongly_connected(graph: Graph) -> list[list[Port]]:
    """Strongly connected groups, each after the groups it depends on (Tarjan 1972, doi 10.1137/0201010)."""
    index: dict[Port, int] = {}
    low: dict[Port, int] = {}
    stack: list[Port] = []  # visited nodes that are in no group yet
    grouped: set[Port] = set()
    groups: list[list[Port]] = []

    def visit(node: Port) -> tuple[Port, Iterator[Port]]:
        index[node] = low[node] = len(index)
        stack.append(node)
        return node, iter(graph[node])

    for root in graph:
        path = [] if root in index else [visit(root)]
        while path:
            node, dependencies = path[-1]
            for before in dependencies:
                if before not in index:
                    path.append(visit(before))
                    break
                if before not in grouped:
                    low[node] = min(low[node], index[before])
            else:
                path.pop()
                if path:
                    parent = path[-1][0]
                    low[parent] = min(low[parent], low[node])
                if low[node] == index[node]:
                    start = stack.index(node)
                    groups.append(stack[start:])
                    grouped.update(stack[start:])
                    del stack[start:]
    return groups


def _circular(graph: Graph, group: list[Port]) -> bool:
    """Do the nodes of a strongly connected group depend on themselves?"""
    return len(group) > 1 or group[0] in graph[group[0]]


def _closed_path(graph: Graph, group: list[Port]) -> list[Port]:
    """A closed path in a circular group; each node depends on the one before it."""
    path, inside = [group[0]], set(group)
    while True:
        before = next(p for p in graph[path[-1]] if p in inside)
        if before in path:
            return [*path[path.index(before) :], before][::-1]
        path.append(before)
