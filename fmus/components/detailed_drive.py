"""A valve with spool dynamics, two lines of lumps, two chambers: alike for cylinders and the swing motor."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

from fmus.components import hose, load_sensing, opening_curve, spool_valve
from fmus.components.circuit import Circuit, Node
from fmus.components.hose import HydraulicLine, LineNames
from fmus.components.load_sensing import Sensed
from fmus.components.opening_curve import OpeningCurves
from fmus.components.spool_valve import Edges, Spool, SpoolState
from fmus.contract import Quantity, Scalar

Pair = tuple[Scalar, Scalar]  # of both chambers


@dataclass(frozen=True)
class DetailedNames:
    """Names of the states of spool, both lines and both chambers, and of the ports of the valve."""

    spool: SpoolState
    lines: tuple[LineNames, LineNames]
    pressures: tuple[str, str]
    ports: tuple[str, str]

    def declarations(
        self, valve: str, lines: Iterable[tuple[str, Quantity, Quantity]], declared: Mapping[str, Quantity]
    ) -> Iterator[tuple[str, Quantity]]:
        """(name, declaration) of the states with these names.

        lines      of each line its name in descriptions, and declarations of the flows at its ends
        declared   declarations of the pressures of the chambers
        """
        yield (
            self.spool.position,
            Quantity("1", f"Spool position of the {valve} valve, relative to its stroke"),
        )
        yield self.spool.speed, Quantity("1/s", f"Spool speed of the {valve} valve", 10.0)
        for names, pressure, line in zip(self.lines, self.pressures, lines, strict=True):
            yield pressure, declared[pressure]
            yield from hose.state_quantities(names, *line)

    def start(self, position: Scalar, pressures: Pair) -> dict[str, Scalar]:
        """Initial values of the states: oil at rest at two pressures [Pa], spool at rest."""
        state = {self.spool.position: position, self.spool.speed: 0.0}
        for name, line, pressure in zip(self.pressures, self.lines, pressures, strict=True):
            state |= dict.fromkeys((name, *line.pressures), pressure)
            state |= dict.fromkeys((*line.flows, *(q for layers in line.layers for q in layers)), 0.0)
        return state

    def valve_and_lines(
        self, p: Any, u: Any, command: Scalar, line: HydraulicLine, x: Any
    ) -> tuple[Circuit, Sensed, dict[str, Scalar]]:
        """From ports to chambers; load pressure; rates of the spool. Parameters and state x of the drive."""
        edges, spool, curves = Edges.of(p, "valve"), Spool.of(p, "spool"), OpeningCurves.of(p, "valve")
        state = SpoolState(getattr(x, self.spool.position), getattr(x, self.spool.speed))
        flow_a, flow_b = (getattr(x, names.flows[0]) for names in self.lines)
        ports = spool_valve.spool_ports(
            *(edges, spool, state.position, flow_a, flow_b),
            *(u.supply_pressure, u.tank_pressure, p.density, curves),
        )
        nodes = {name: Node(port.pressure) for name, port in zip(self.ports, ports, strict=True)}
        circuit = Circuit(nodes, spool_valve.branches(ports, *self.ports))
        for names, port, chamber in zip(self.lines, self.ports, self.pressures, strict=True):
            circuit |= hose.ladder(line, names, x, port, chamber, getattr(x, chamber))
        full = edges.full_command
        bands = opening_curve.meter_in_dead_bands(curves, spool.overlap_pa, spool.overlap_pb, full)
        sensed = partial(load_sensing.load_pressure, state.position, state.speed, bands, 1)
        rates = spool_valve.spool_rates(spool, state, spool_valve.commanded_position(command, full))
        return circuit, sensed, {self.spool.position: rates.position, self.spool.speed: rates.speed}
