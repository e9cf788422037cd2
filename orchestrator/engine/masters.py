"""Masters: how the components take a communication step together. Each makes a `Plan` of a system.

    Jacobi               all components take the step with what is known at its start
    Gauss-Seidel         components step one after the other, later ones with the new outputs of earlier ones
    Hermite              the step is repeated until every input is the cubic between the ends of its source
    Interface-Jacobian   linearisations of the components, joined, predict all inputs over the step

native/communication_step.c takes the step as the plan says; docs/coupling.md has equations and measurements.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

from orchestrator.base.coupling import Coupling
from orchestrator.fmi.description import FmuInterface
from orchestrator.ssp.dependencies import gauss_seidel_order
from orchestrator.ssp.system import Connection, Port, System


@dataclass(frozen=True)
class Prediction:
    """What a linear prediction works with.

    leads        so many components step first: their future depends on no other component
    linearised   components that declare directional derivatives of states and outputs
    complete     there are no others, but for those that lead
    relevant     inputs that a state depends on, or an output that feeds another component
    lag          steps for which a linearisation is kept
    """

    leads: int
    linearised: frozenset[str]
    complete: bool
    relevant: frozenset[Port]
    lag: int


@dataclass(frozen=True)
class Plan:
    """One way to take all components over a step.

    order        the components, by number, in the order in which they step
    moved        the connections whose inputs move inside the step; the others are held
    extrapolation   degree at which a source is extrapolated that has not stepped yet
    degree       degree at which both ends of a source are connected that has
    sequential   the inputs of a component know what the sources before it in the order have done
    passes       how often the step is computed at most; more than once needs rollback
    tolerance    a further pass is made while the last one changed a signal by more, as a share of its
                 magnitude
    corrected    extrapolated inputs get back what they lost, see input_correct in native/coupling_input.c
    watches      the inputs that do not move are watched too, for the estimate of the error
    repeated     the components, by number, that further passes compute again
    notes        for the card of the run
    prediction   inputs are predicted from linearisations
    """

    order: Sequence[int]
    moved: Sequence[Connection]
    extrapolation: int
    degree: int
    sequential: bool = False
    passes: int = 1
    tolerance: float = 0.0
    corrected: bool = False
    watches: bool = False
    repeated: frozenset[int] = frozenset()
    notes: tuple[str, ...] = ()
    prediction: Prediction | None = None

    @property
    def sloped(self) -> bool:
        """Are the slopes of sources wanted?"""
        return self.extrapolation > 0 or self.degree > 1 or self.corrected or self.watches

    def asks(self, component: str) -> bool:
        """Are the slopes of the outputs of this component wanted?"""
        prediction = self.prediction
        predicted = prediction is not None and prediction.complete and component in prediction.linearised
        return self.sloped and not predicted


def order_of_components(system: System) -> list[int]:
    """The order, by number, in which components step one after the other."""
    places = {name: i for i, name in enumerate(system.components)}
    return [places[name] for name in gauss_seidel_order(system)]


def unsettled(system: System, order: Sequence[int]) -> frozenset[int]:
    """The components, by number, that a second pass can change when they step in this order.

    These are fed by one that does not step before them, or by one that a second pass changes.
    """
    names, wires = list(system.components), system.connections
    turn = {names[k]: i for i, k in enumerate(order)}
    found = {c.target.component for c in wires if turn[c.source.component] >= turn[c.target.component]}
    while more := {c.target.component for c in wires if c.source.component in found} - found:
        found |= more
    return frozenset(map(names.index, found))


def jacobi_plan(system: System, coupling: Coupling) -> Plan:
    """Sources are extrapolated over the step at degree `order`; order of convergence: one more.

    At order 0 inputs are held, unless an FMU moves them itself by a rate input.
    """
    order = coupling.extrapolation
    moved = system.connections if order or coupling.correct else ()
    watches = coupling.estimates_error
    everybody = range(len(system.components))
    return Plan(everybody, moved, order, degree=order, corrected=coupling.correct, watches=watches)


def gauss_seidel_plan(system: System, coupling: Coupling) -> Plan:
    """Sources that have stepped are interpolated at degree `order` + 1, others extrapolated at `order`.

    Order of convergence: `order` + 1. At order 0 inputs from components that step later are held, unless an
    FMU moves them itself by a rate input. The order of the components follows from the dependencies.
    """
    order, names = coupling.extrapolation, list(system.components)
    turn = {names[k]: i for i, k in enumerate(order_of_components(system))}
    early = [c for c in system.connections if turn[c.source.component] < turn[c.target.component]]
    return Plan(
        order_of_components(system),
        system.connections if order or coupling.correct else early,
        order,
        degree=min(order + 1, 3),
        sequential=True,
        corrected=coupling.correct,
        watches=coupling.estimates_error,
    )


def hermite_plan(system: System, coupling: Coupling) -> Plan:
    """At most `passes` passes, fewer when one changes all signals by less than the tolerance.

    Values and slopes at both ends of a step make a cubic. In the first pass the far end is not known yet, and
    sources are extrapolated as Gauss-Seidel does it; each further pass starts again from the saved states,
    with the cubics to where the pass before it ended. When passes change nothing any more the input of every
    component is its source up to h^4, so the order of convergence is 4.

    A component whose sources have all stepped before it is right in the first pass already. When all others
    can go back to a saved state the step is repeated, else it is computed once.
    """
    order = order_of_components(system)
    repeated, components = unsettled(system, order), list(system.components.values())
    stuck = [components[k].name for k in sorted(repeated) if not components[k].interface.rollback]
    note = f"hermite computes every step once: {', '.join(stuck)} cannot go back to a saved state"
    return Plan(
        order,
        system.connections,
        coupling.extrapolation,
        degree=3,
        sequential=True,
        passes=1 if stuck else coupling.max_passes,
        tolerance=coupling.pass_tolerance,
        corrected=coupling.correct,
        watches=coupling.estimates_error,
        repeated=repeated,
        notes=(note,) if stuck and coupling.max_passes > 1 else (),
    )


def interface_jacobian_plan(system: System, coupling: Coupling) -> Plan:
    """All inputs are predicted; those from components that have stepped are bent to where they arrived.

    One pass, no rollback. Components whose future does not depend on others step first, and are followed as
    they went.
    """
    relevant = _relevant(system)
    leads = _leads(system, relevant)
    needed = _needed(system, leads, relevant)
    linearised = frozenset(name for name in needed if _linearisable(system.components[name].interface))
    return Plan(
        sorted(order_of_components(system), key=lambda k: k not in leads),
        system.connections,
        coupling.extrapolation,
        degree=3,
        sequential=True,
        watches=coupling.estimates_error,
        prediction=Prediction(len(leads), linearised, linearised == needed, relevant, coupling.lag),
    )


def _relevant(system: System) -> frozenset[Port]:
    """Inputs that a state depends on, or an output that feeds another component."""
    sources: dict[str, set[str]] = {name: set() for name in system.components}
    for c in system.connections:
        if c.target.variable not in system.components[c.target.component].interface.unused_inputs:
            sources[c.source.component].add(c.source.variable)
    return frozenset(
        Port(name, v.name)
        for name, component in system.components.items()
        for v in component.interface.of("input")
        if _changes_something(component.interface, v.name, sources[name])
    )


def _changes_something(face: FmuInterface, variable: str, outputs: Iterable[str]) -> bool:
    if variable in face.unused_inputs:
        return False
    if not (face.states or face.stateless):
        return True
    declared = [face.dependencies.get(rate) for rate in face.states.values()]
    moves = any(known is None or variable in known for known in declared)
    return moves or any(variable in face.direct_inputs(y) for y in outputs)


def _leads(system: System, relevant: frozenset[Port]) -> set[int]:
    """Components that depend on nobody but each other: sources, and what merely follows sources."""
    names, found = list(system.components), set[int]()
    wires = [(c.source.component, c.target.component) for c in system.connections if c.target in relevant]
    while True:
        done = {names[k] for k in found}
        waiting = {target for source, target in wires if source == target or source not in done}
        more = {k for k, name in enumerate(names) if name not in waiting}
        if more == found:
            return found
        found = more


def _needed(system: System, leads: set[int], relevant: frozenset[Port]) -> frozenset[str]:
    """Components whose future is to be predicted: they do not lead, and feed one that does not."""
    others = {name for k, name in enumerate(system.components) if k not in leads}
    wires = [c for c in system.connections if c.target in relevant and c.target.component in others]
    return frozenset({c.source.component for c in wires} & others)


def _linearisable(face: FmuInterface) -> bool:
    """Does a component declare directional derivatives, of all its states and outputs?"""
    return face.directional_derivatives and bool(face.states or face.stateless)


MASTERS: Mapping[str, Callable[[System, Coupling], Plan]] = {
    "jacobi": jacobi_plan,
    "gauss-seidel": gauss_seidel_plan,
    "hermite": hermite_plan,
    "interface-jacobian": interface_jacobian_plan,
}


def plan(system: System, coupling: Coupling) -> Plan:
    """The plan of the chosen master."""
    return MASTERS[coupling.master](system, coupling)
