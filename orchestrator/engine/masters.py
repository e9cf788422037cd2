"""Co-simulation masters: each is a function that makes a `Plan` for a system. The inputs that a plan varies.

    Jacobi               all components step with inputs extrapolated from the start of the step
    Gauss-Seidel         components step one after the other, later ones with the new outputs of earlier ones
    Hermite              the step is repeated until every input is the cubic between both ends of its source
    Interface-Jacobian   linearised components, joined to one system, predict all inputs over the step

native/communication_step.c carries out a step of any plan; docs/coupling.md has equations and measurements.
A coupling input varies inside a communication step, or is watched to estimate the error of the step;
native/coupling_input.c makes the polynomials of coupling inputs at every step.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from orchestrator.base.text import first_names, grouped
from orchestrator.engine.c_library import Binding, engine_h
from orchestrator.engine.network import Network
from orchestrator.ssp.coupling import Coupling
from orchestrator.ssp.dependencies import influential_inputs
from orchestrator.ssp.power_bonds import find_bonds
from orchestrator.ssp.system import Connection, Port, System


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

    coupling     extrapolation of a source that has not stepped yet, and its correction
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
        return self.coupling.extrapolation > 0 or self.degree > 1 or self.coupling.correct or self.watches

    def needs_slopes_of(self, component: str) -> bool:
        """Does the master use slopes of the outputs of this component?"""
        prediction = self.prediction
        predicted = prediction is not None and prediction.complete and component in prediction.linearised
        return self.estimates or (self.needs_slopes and not predicted)


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
        Port(c.name, u)
        for c in system.components.values()
        for y in c.interface.of("output")
        for u in c.interface.direct_inputs(y.name)
    }
    remaining, order = list(system.components), list[str]()

    def waiting_inputs(name: str) -> tuple[int, int, int, bool]:
        targets = [
            c.target
            for c in system.connections
            if c.target.component == name and c.source.component in remaining and c.source.component != name
        ]
        interpolates = bool(system.components[name].interface.ramp_inputs)
        direct = with_feedthrough.intersection(targets)
        return len(direct - with_rate), len(direct), len(targets), interpolates

    while remaining:
        order.append(min(remaining, key=waiting_inputs))
        remaining.remove(order[-1])
    return order


def _gauss_seidel_indices(system: System) -> list[int]:
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
    varying = system.connections if order or coupling.correct else ()
    return Plan(coupling, range(len(system.components)), varying, degree=order)


def gauss_seidel_plan(system: System, coupling: Coupling) -> Plan:
    """Sources that have stepped are interpolated at degree `order` + 1, others extrapolated at `order`.

    The order of convergence is `order` + 1. At order 0 inputs from components that step later are held,
    unless an FMU varies them itself by a rate input. Components step in the order that follows from their
    dependencies.
    """
    order, names = coupling.extrapolation, list(system.components)
    components = _gauss_seidel_indices(system)
    position = {names[k]: i for i, k in enumerate(components)}
    varying = [
        c
        for c in system.connections
        if order or coupling.correct or position[c.source.component] < position[c.target.component]
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
    order = _gauss_seidel_indices(system)
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
    relevant = influential_inputs(system)
    leading = _leading_components(system, relevant)
    needed = _components_to_predict(system, leading, relevant)
    linearised = frozenset(name for name in needed if system.components[name].interface.linearisable)
    return Plan(
        coupling,
        sorted(_gauss_seidel_indices(system), key=lambda k: k not in leading),
        system.connections,
        degree=3,
        sequential=True,
        prediction=Prediction(len(leading), linearised, linearised == needed, relevant),
    )


def _leading_components(system: System, relevant: frozenset[Port]) -> set[int]:
    """Indices of the components that depend on no other components than these, in an order without cycles."""
    names, leading = list(system.components), set[str]()
    feeding = grouped((c for c in system.connections if c.target in relevant), lambda c: c.target.component)
    sources = {name: {c.source.component for c in feeding.get(name, ())} for name in names}
    while (ready := {name for name in names if sources[name] <= leading}) != leading:
        leading = ready
    return {names.index(name) for name in leading}


def _components_to_predict(system: System, leading: set[int], relevant: frozenset[Port]) -> frozenset[str]:
    """Names of the components that are not leading, and feed one that is not leading."""
    others = {name for k, name in enumerate(system.components) if k not in leading}
    connections = [c for c in system.connections if c.target in relevant and c.target.component in others]
    return frozenset({c.source.component for c in connections} & others)


MASTERS: Mapping[str, Callable[[System, Coupling], Plan]] = {
    "jacobi": jacobi_plan,
    "gauss-seidel": gauss_seidel_plan,
    "hermite": hermite_plan,
    "interface-jacobian": interface_jacobian_plan,
}


class CouplingInputs:
    """The inputs of a network that the plan varies inside a step, or watches to estimate the error.

    ports           of the inputs, ordered by component
    inputs          `CouplingInput` of engine.h for each port
    varying         ports that the master varies, without those that are only watched
    rate_driven     ports that an FMU varies itself from its rate input, and rate inputs themselves
    rate_wires      input -> connection of its rate input; its source is the slope of the source of the input
    slope_outputs   other outputs whose slopes the FMUs give, ordered by component -> index of the slope
    slopes          those slopes, shape (n,)
    """

    def __init__(self, network: Network, plan: Plan) -> None:
        self._network, self._plan = network, plan
        self._h = engine_h()
        self.driven = network.driven.continuous if network.driven else []
        self._varied = {c.target for c in plan.varying}
        connections = self._candidates()
        self.rate_driven = self._find_rate_driven({c.target for c in connections})
        self._connections = {c.target: c for c in connections if c.target not in self.rate_driven}
        self.varying = {*self._connections} & self._varied | {*self.driven}
        self.rate_wires = self._find_rate_wires()
        self.slope_outputs = {p: i for i, p in enumerate(self._find_slope_outputs())}
        self.slopes = np.zeros(len(self.slope_outputs))
        by_component = grouped((*self._connections, *self.driven), lambda port: port.component)
        self.ports = [port for name in network.slaves for port in by_component.get(name, ())]
        self.inputs = [self._input(p) for p in self.ports]
        self._connect_components()

    def array(self, binding: Binding) -> Any:
        """The inputs as an array of structures."""
        return binding.array(self._h.CouplingInput, self.inputs)

    @property
    def bonds(self) -> list[tuple[int, int]]:
        """For each power bond of two coupling inputs the indices of its effort and its flow."""
        index, bonds = {p: i for i, p in enumerate(self.ports)}, find_bonds(self._network.system)
        return [(index[b.effort], index[b.flow]) for b in bonds if b.effort in index and b.flow in index]

    @property
    def power(self) -> int:
        """The power of the step to which the estimated error is proportional."""
        if self._plan.passes > 1:
            return self._plan.degree + 1
        order = max((s.order for s in self.inputs), default=0)
        return order + (2 if self._plan.coupling.correct else 1)

    @property
    def notes(self) -> tuple[str, ...]:
        """Remarks on abilities that the master would use but the FMUs lack."""
        if not self._plan.needs_slopes:
            return ()
        names, h = {i: str(p) for p, i in self._network.reals.index.items()}, self._h
        connected = [s for s in self.inputs if s.source_component != h.DRIVEN and s.requested_degree]
        needed = [self._plan.needs_slopes_of(name) for name in self._network.slaves]
        differences = [s.source for s in connected if not s.source_slope and needed[s.source_component]]
        reason = "because the FMUs provide no output derivatives"
        notes = {
            f"input derivatives from differences of values, {reason}": differences,
            "inputs held at their mean over a step, because the FMUs accept no input derivatives": [
                s.target for s in connected if s.fmu_degree == 0
            ],
            "inputs linear over a step, because the FMUs accept first derivatives only": [
                s.target for s in connected if 0 < s.fmu_degree < s.requested_degree
            ],
        }
        named = {note: first_names(names[i] for i in found) for note, found in notes.items()}
        return tuple(f"{note}: {inputs}" for note, inputs in named.items() if inputs)

    # ---- selection

    def _candidates(self) -> list[Connection]:
        """The connections between continuous variables whose inputs the plan varies or watches."""
        plan, network = self._plan, self._network
        variable = network.system.variable
        return [
            c
            for c in (network.system.connections if plan.watches else plan.varying)
            if variable(c.target).is_continuous and variable(c.source).is_continuous
            if variable(c.target).causality == "input" and network.is_influential(c.target)
        ]

    def _find_rate_driven(self, candidates: set[Port]) -> set[Port]:
        """Inputs that an FMU varies from a connected rate input, and rate inputs of candidates."""
        network = self._network
        connected = {c.target for c in network.connections}
        power = {p for bond in find_bonds(network.system) for p in (bond.effort, bond.flow)}
        rate_driven = set[Port]()
        for port, rate in network.system.rate_ports.items():
            ramps = network.slaves[port.component].interface.ramp_inputs
            if port.variable not in ramps and rate in connected:
                rate_driven.add(port)
            if port in candidates and port not in rate_driven and rate not in power:
                rate_driven.add(rate)
        return rate_driven

    # ---- slopes of their sources

    def _find_rate_wires(self) -> dict[Port, Connection]:
        """Connections of rate inputs that come from the FMU that feeds the input itself."""
        incoming, wires = {c.target: c for c in self._network.connections}, {}
        rates = self._network.system.rate_ports
        for port, connection in self._connections.items():
            wire = incoming.get(rates[port]) if port in rates else None
            if wire and wire.source.component == connection.source.component and not wire.map.offset:
                wires[port] = wire
        return wires

    def _find_slope_outputs(self) -> Iterable[Port]:
        """The outputs whose slopes the plan needs and the FMUs give, ordered by component."""
        sources = dict.fromkeys(
            c.source
            for port, c in self._connections.items()
            if port not in self.rate_wires and self._plan.needs_slopes_of(c.source.component)
        )
        slaves = self._network.slaves
        inputs = (*self._connections, *self.driven)
        moving = self._varied.union(self.driven, self.rate_wires)
        held = {p for p in inputs if p not in moving or not slaves[p.component].input_degree(p.variable, 1)}
        held -= {p for p in held if p.variable in slaves[p.component].interface.model.held_inputs}
        for name, slave in slaves.items():
            ports = [p for p in sources if p.component == name and not self._depends_on_held(p, held)]
            given = set(slave.outputs_with_derivatives([p.variable for p in ports]) if ports else ())
            yield from (p for p in ports if p.variable in given)

    def _depends_on_held(self, output: Port, held: set[Port]) -> bool:
        """Does an output depend on a held input? Its slope would lack the contribution of that input."""
        depends = self._network.slaves[output.component].interface.direct_inputs(output.variable)
        return any(Port(output.component, u) in held for u in depends)

    # ---- their structures

    def _input(self, port: Port) -> Any:
        connection = self._connections.get(port)
        nominal = self._network.system.variable(port).nominal or 1.0  # 1 if not declared, by the standard
        target = self._network.reals.index[port]
        if connection:
            members = self._from_output(port, connection)
        else:  # from the scenario
            degree = self._network.slaves[port.component].input_degree(port.variable, 1)
            members = {"source_component": self._h.DRIVEN, "fmu_degree": degree, "requested_degree": 1}
        return self._h.CouplingInput(**{"target": target, "scale": abs(nominal), "source": -1, **members})

    def _from_output(self, port: Port, connection: Connection) -> dict[str, Any]:
        network, plan, varied = self._network, self._plan, port in self._varied
        slave, source = network.slaves[port.component], connection.source
        coupling = plan.coupling
        degree = max(coupling.extrapolation, plan.degree, int(coupling.correct)) if varied else 0
        return {
            "source": network.reals.index[source],
            "factor": connection.map.factor,
            "offset": connection.map.offset,
            "source_component": list(network.slaves).index(source.component),
            **self._slope(port, connection),
            "fmu_degree": slave.input_degree(port.variable, degree),
            "requested_degree": degree,
            "order": coupling.extrapolation if varied else self._rate_wire_count(port),
            "autonomous": not network.system.components[source.component].interface.of("input"),
        }

    def _rate_wire_count(self, port: Port) -> int:
        """The degree at which an FMU varies a held input by its rate input, the rate input of that ..."""
        rates, connected = self._network.system.rate_ports, {c.target for c in self._network.connections}
        rate, count = rates.get(port), 0
        while rate in connected and count < 3:
            rate, count = rates.get(rate), count + 1
        return count

    def _slope(self, port: Port, connection: Connection) -> dict[str, Any]:
        """Where the slope of the source is; empty if it is computed from values."""
        if wire := self.rate_wires.get(port):
            reals = self._network.reals
            values, index, factor = reals.values, reals.index[wire.source], wire.map.factor
        elif connection.source in self.slope_outputs:
            values, index, factor = self.slopes, self.slope_outputs[connection.source], connection.map.factor
        else:
            return {}
        return {"source_slope": self._network.binding.at(values[index:]), "slope_factor": factor}

    # ---- the components

    def _connect_components(self) -> None:
        """Make the calls by which components set their coupling inputs and read slopes of outputs."""
        first = 0
        for name, component in self._network.components.items():
            names = [p.variable for p in self.ports if p.component == name]
            inputs = self.inputs[first : first + len(names)]
            jumps = self._plan.coupling.correct or self._plan.halves
            component.make_input_writes(first, names, inputs, jumps)
            first += len(names)
            outputs = {p.variable: i for p, i in self.slope_outputs.items() if p.component == name}
            if outputs:
                indices = [*outputs.values()]
                slopes = self.slopes[indices[0] : indices[-1] + 1]
                component.slope_reads = [component.slave.output_derivative_reader(list(outputs), slopes)]

    def held(self, order: Sequence[int]) -> list[list[Connection]]:
        """For each component the connections to held inputs from components that step before it."""
        names, varying = list(self._network.slaves), self.varying | self.rate_driven
        held: list[list[Connection]] = [[] for _ in names]
        for i, k in enumerate(order):
            before = {names[j] for j in order[:i]}
            incoming = [c for c in self._network.connections if c.target.component == names[k]]
            held[k] = [c for c in incoming if c.source.component in before and c.target not in varying]
        return held
