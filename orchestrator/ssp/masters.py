"""Co-simulation masters: each is a record, `Master`, of what it can do and how it plans steps.

    Jacobi               all components step with inputs extrapolated from the start of the step
    Gauss-Seidel         components step one after the other, later ones with the new outputs of earlier ones
    Hermite              the step is repeated until every input is the cubic between both ends of its source
    Interface-Jacobian   linearised components, joined to one system, predict all inputs over the step

`MASTERS` lists them, and all that differs from master to master is in their records. docs/coupling.md has
equations and measurements. engine/native/communication_step.c carries out a step of any plan.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from orchestrator.base.errors import Problem

if TYPE_CHECKING:
    from orchestrator.ssp.coupling import Coupling
    from orchestrator.ssp.system import Connection, Port, System


@dataclass(frozen=True)
class Master:
    """A master: what it can do, and how it takes the components of a system over a communication step.

    name      as the option `master` has it
    plan      makes the plan of all steps of a system
    order     of the extrapolation of outputs over a step, where none is chosen
    repeats   it computes a step several times, from saved states: `passes` and `coupling_tolerance` apply
    guarded   where no guard is chosen, steps are divided whose inputs are off
    lanes     `batch` has it for many machines at once
    step      in place of a plan a function step(components, time, length) that takes the components over
              every step, see `engine.own_master`
    """

    name: str
    plan: Callable[[System, Coupling], Plan] | None = None
    order: int = 0
    repeats: bool = False
    guarded: bool = False
    lanes: bool = False
    step: Callable[[Any, float, float], None] | None = None

    def __post_init__(self) -> None:
        if (self.plan is None) == (self.step is None):
            given = "neither" if self.plan is None else "both"
            raise Problem(f"master {self.name}: expected a function `plan` or a function `step`, got {given}")

    @property
    def own(self) -> bool:
        """Does a user bring it?"""
        return MASTERS.get(self.name) is not self

    def planned(self, system: System, coupling: Coupling) -> Plan:
        """The plan of the steps of a system; that of a function `step` only exchanges values after them."""
        return (self.plan or jacobi_plan)(system, coupling)


@dataclass(frozen=True)
class Prediction:
    """The part of a plan for the linear prediction of inputs.

    leading_count   number of components that step first, because they depend on no other component
    linearised      names of the components that declare directional derivatives of states and outputs
    complete        all components are leading, linearised, or feed no other
    relevant        inputs that influence a state, directly or through other components
    """

    leading_count: int
    linearised: frozenset[str]
    complete: bool
    relevant: frozenset[Port]


@dataclass(frozen=True)
class Plan:
    """How all components take a communication step.

    coupling     extrapolation of a source that has not stepped yet
    order        indices of the components in the order in which they step
    varying      connections whose inputs vary inside the step; the others are held
    degree       degree of interpolation for a source that has stepped
    sequential   components step one after the other, with the new outputs of those before
    passes       how often the step is computed at most; more than once requires rollback
    estimates    the error of the run is estimated, which needs all slopes
    halves       components step in two halves, with which the errors of inputs are measured
    repeated     indices of the components that further passes compute again
    notes        remarks for the accuracy card
    prediction   inputs are predicted from linearisations
    parallel     of sequential components only those with events use the new outputs of those before
    """

    coupling: Coupling
    order: Sequence[int]
    varying: Sequence[Connection]
    degree: int
    sequential: bool = False
    passes: int = 1
    estimates: bool = False
    halves: bool = False
    repeated: frozenset[int] = frozenset()
    notes: tuple[str, ...] = ()
    prediction: Prediction | None = None
    parallel: bool = False

    def with_estimate(self, fast: bool) -> Plan:
        """The plan of a run that estimates its error; fast: without measurements for masters of order 4."""
        of_order_four = self.passes > 1 or self.prediction is not None
        return replace(self, estimates=True, halves=of_order_four and not fast)

    @property
    def tolerance(self) -> float:
        """Passes end when the last one changed no signal by more, relative to its magnitude."""
        return self.coupling.pass_tolerance

    @property
    def watches(self) -> bool:
        """Are held inputs watched too, to estimate the error of a step?"""
        return self.estimates or self.coupling.estimates_error

    @property
    def needs_slopes(self) -> bool:
        """Does the master use slopes of outputs?"""
        return self.coupling.extrapolation > 0 or self.degree > 1 or self.watches

    def needs_slopes_of(self, component: str) -> bool:
        """Does the master use slopes of the outputs of this component?"""
        prediction = self.prediction
        predicted = prediction is not None and prediction.complete and component in prediction.linearised
        return self.estimates or (self.needs_slopes and not predicted)


def gauss_seidel_indices(system: System) -> list[int]:
    """Indices of the components in the order in which Gauss-Seidel steps them."""
    from orchestrator.ssp.dependencies import gauss_seidel_order  # which needs systems, and they this file

    return [*map(list(system.components).index, gauss_seidel_order(system))]


def unsettled_components(system: System, order: Sequence[int]) -> frozenset[int]:
    """Indices of the components that a second pass can change if they step in this order.

    A component is one of them if it is fed by a component that does not step before it, or by one of them.
    """
    names, connections = list(system.components), system.connections
    position = {names[k]: i for i, k in enumerate(order)}
    ends = [(c.source.component, c.target.component) for c in connections]
    unsettled = {target for source, target in ends if position[source] >= position[target]}
    while fed := {target for source, target in ends if source in unsettled} - unsettled:
        unsettled |= fed
    return frozenset(map(names.index, unsettled))


def jacobi_plan(system: System, coupling: Coupling) -> Plan:
    """Sources are extrapolated over the step at degree `order`; the order of convergence is `order` + 1.

    At order 0 inputs are held, unless an FMU varies them itself by a rate input.
    """
    order = coupling.extrapolation
    varying = system.connections if order else ()
    return Plan(coupling, range(len(system.components)), varying, degree=order)


def gauss_seidel_plan(system: System, coupling: Coupling) -> Plan:
    """Sources that have stepped are interpolated at degree `order` + 1, others extrapolated at `order`.

    The order of convergence is `order` + 1. At order 0 inputs from components that step later are held,
    unless an FMU varies them itself by a rate input. Components step in the order that follows from their
    dependencies.
    """
    order, names = coupling.extrapolation, list(system.components)
    components = gauss_seidel_indices(system)
    position = {names[k]: i for i, k in enumerate(components)}
    varying = [
        c for c in system.connections if order or position[c.source.component] < position[c.target.component]
    ]
    return Plan(coupling, components, varying, degree=min(order + 1, 3), sequential=True)


def hermite_plan(system: System, coupling: Coupling) -> Plan:
    """At most `passes` passes; they end early if one changes all signals by less than the tolerance.

    Values and slopes at both ends of a step make a cubic. In the first pass the end is not available yet, and
    sources are extrapolated as by Gauss-Seidel. Each further pass starts again from the saved states, with
    cubics to the ends of the previous pass. If passes change nothing any more, the input of every component
    equals its source up to h^4, so the order of convergence is 4.

    The first pass is final for a component whose sources have all stepped before it. The step is repeated if
    all other components can go back to a saved state. Otherwise it is computed once.
    """
    order = gauss_seidel_indices(system)
    repeated, components = unsettled_components(system, order), list(system.components.values())
    cannot = [components[k].name for k in sorted(repeated) if not components[k].interface.rollback]
    note = f"hermite makes one pass per step, because {', '.join(cannot)} cannot restore a saved state"
    return Plan(
        coupling,
        order,
        system.connections,
        degree=3,
        sequential=True,
        passes=1 if cannot else coupling.max_passes,
        repeated=repeated,
        notes=(note,) if cannot and coupling.max_passes > 1 else (),
    )


def interface_jacobian_plan(system: System, coupling: Coupling) -> Plan:
    """All inputs are predicted; a source that has stepped replaces the end of the prediction by its value.

    There is one pass and no rollback. Components that do not depend on others step first, and the inputs that
    they feed are interpolated.
    """
    from orchestrator.ssp.dependencies import influential_inputs

    relevant = influential_inputs(system)
    leading = _leading_components(system, relevant)
    needed = _components_to_predict(system, leading, relevant)
    linearised = frozenset(name for name in needed if system.components[name].interface.linearisable)
    return Plan(
        coupling,
        sorted(gauss_seidel_indices(system), key=lambda k: k not in leading),
        system.connections,
        degree=3,
        sequential=True,
        prediction=Prediction(len(leading), linearised, linearised == needed, relevant),
    )


def plan_with_events(plan: Plan, system: System) -> Plan:
    """The plan for FMUs that go through events together: those with events step last.

    Their inputs are exact at the end of a step, where an event that follows from them is located. Inputs from
    components that step even later need a second pass. Signals that are not continuous travel between steps.
    """
    wires = [c for c in system.connections if system.is_continuous(c)]
    continuous, names = replace(system, connections=tuple(wires)), list(system.components)
    having = {name for name, c in system.components.items() if c.interface.declares_events}
    order = sorted(gauss_seidel_indices(continuous), key=lambda k: names[k] in having)
    if plan.prediction:
        leading = plan.order[: plan.prediction.leading_count]
        return replace(plan, order=[*leading, *(k for k in order if k not in leading)])
    place = {names[k]: i for i, k in enumerate(order)}
    fed = [c for c in wires if c.target.component in having]
    ahead = {c.target.component for c in fed if place[c.source.component] >= place[c.target.component]}
    repeats = plan.passes > 1
    return replace(
        plan,
        order=order,
        varying=(*plan.varying, *(c for c in fed if c not in plan.varying)),
        degree=max(plan.degree, 1),
        sequential=True,
        parallel=not plan.sequential,
        passes=max(plan.passes, 2 if ahead else 1),
        repeated=unsettled_components(continuous, order) if repeats else frozenset(map(names.index, ahead)),
    )


def _leading_components(system: System, relevant: frozenset[Port]) -> set[int]:
    """Indices of the components that depend on no other components than these, in an order without cycles."""
    names, leading = list(system.components), set[str]()
    feeding = [c for c in system.connections if c.target in relevant]
    sources = {n: {c.source.component for c in feeding if c.target.component == n} for n in names}
    while (ready := {name for name in names if sources[name] <= leading}) != leading:
        leading = ready
    return {names.index(name) for name in leading}


def _components_to_predict(system: System, leading: set[int], relevant: frozenset[Port]) -> frozenset[str]:
    """Names of the components that are not leading, and feed one that is not leading."""
    others = {name for k, name in enumerate(system.components) if k not in leading}
    connections = [c for c in system.connections if c.target in relevant and c.target.component in others]
    return frozenset({c.source.component for c in connections} & others)


MASTERS: Mapping[str, Master] = {
    master.name: master
    for master in (
        Master("jacobi", jacobi_plan, lanes=True),
        Master("gauss-seidel", gauss_seidel_plan, lanes=True),
        Master("hermite", hermite_plan, order=3, repeats=True, guarded=True, lanes=True),
        Master("interface-jacobian", interface_jacobian_plan, order=3, guarded=True),
    )
}
