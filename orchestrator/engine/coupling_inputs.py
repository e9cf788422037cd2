"""`CouplingInputs`: inputs that a plan varies inside a communication step, or watches to estimate its error.

native/coupling_input.c makes the polynomials of coupling inputs at every step.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from orchestrator.base.text import first_names, grouped
from orchestrator.engine.c_library import Binding, engine_h
from orchestrator.engine.network import Network
from orchestrator.ssp.masters import Plan
from orchestrator.ssp.power_bonds import find_bonds
from orchestrator.ssp.system import Connection, Port


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
        self.h = engine_h()
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
        return binding.array(self.h.CouplingInput, self.inputs)

    @property
    def power(self) -> int:
        """The power of the step to which the estimated error is proportional."""
        if self._plan.passes > 1:
            return self._plan.degree + 1
        order = max((s.order for s in self.inputs), default=0)
        return order + 1

    @property
    def notes(self) -> tuple[str, ...]:
        """Remarks on abilities that the master would use but the FMUs lack."""
        if not self._plan.needs_slopes:
            return ()
        names, h = {i: str(p) for p, i in self._network.reals.index.items()}, self.h
        connected = [s for s in self.inputs if s.source_component != h.DRIVEN and s.requested_degree]
        needed = [self._plan.needs_slopes_of(name) for name in self._network.slaves]
        differences = [s.source for s in connected if not s.source_slope and needed[s.source_component]]
        reason = "because the FMUs provide no output derivatives"
        notes = {
            f"input derivatives from differences of values, {reason}": differences,
            "inputs held at their mean over a step, because the FMUs accept no input derivatives": [
                s.target for s in connected if s.fmu_degree == 0 and not s.at_end
            ],
            "inputs held at their value at the end of a step, because the FMUs have events": [
                s.target for s in connected if s.fmu_degree == 0 and s.at_end
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
            if network.system.is_continuous(c)
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
            members = {"source_component": self.h.DRIVEN, "fmu_degree": degree, "requested_degree": 1}
        return self.h.CouplingInput(**{"target": target, "scale": abs(nominal), "source": -1, **members})

    def _from_output(self, port: Port, connection: Connection) -> dict[str, Any]:
        network, plan, varied = self._network, self._plan, port in self._varied
        slave, source = network.slaves[port.component], connection.source
        interface = network.system.components[source.component].interface
        coupling = plan.coupling
        degree = max(coupling.extrapolation, plan.degree) if varied else 0
        return {
            "source": network.reals.index[source],
            "factor": connection.map.factor,
            "offset": connection.map.offset,
            "source_component": list(network.slaves).index(source.component),
            **self._slope(port, connection),
            "fmu_degree": slave.input_degree(port.variable, degree),
            "requested_degree": degree,
            "order": coupling.extrapolation if varied else self._rate_wire_count(port),
            "autonomous": not interface.of("input"),
            "noisy": source.variable in interface.model.noisy_outputs,
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
            component.make_input_writes(first, names, inputs, jumps=self._plan.halves)
            first += len(names)
            outputs = {p.variable: i for p, i in self.slope_outputs.items() if p.component == name}
            if outputs:
                indices = [*outputs.values()]
                slopes = self.slopes[indices[0] : indices[-1] + 1]
                component.slope_reads = [component.slave.output_derivative_reader(list(outputs), slopes)]

    def held(self, order: Sequence[int]) -> list[list[Connection]]:
        """For each component the connections to held inputs from components that step before it.

        Without signals that are not continuous: their values at the end of a step have no effect in it.
        """
        names, varying = list(self._network.slaves), self.varying | self.rate_driven
        held: list[list[Connection]] = [[] for _ in names]
        for i, k in enumerate(order):
            before = {names[j] for j in order[:i]}
            incoming = [c for c in self._network.connections if c.target.component == names[k]]
            incoming = [
                c for c in incoming if self._network.system.is_continuous(c) and c.target not in varying
            ]
            held[k] = [c for c in incoming if c.source.component in before]
        return held
