"""A valve with spool dynamics, two lines of lumps, two chambers: alike for cylinders and the swing motor."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

from fmus.components import hose, load_sensing, opening_curve, spool_valve
from fmus.components.circuit import Circuit, Node
from fmus.components.hose import HydraulicLine, LineStates
from fmus.components.load_sensing import Sensed
from fmus.components.opening_curve import OpeningCurves
from fmus.components.spool_valve import Edges, Spool, SpoolState
from fmus.contract import Quantity, Scalar

Pair = tuple[Scalar, Scalar]  # of both chambers


@dataclass(frozen=True)
class DetailedStates:
    """States of both lines and both chambers, names of those of the spool, and of the ports of the valve."""

    spool: SpoolState
    lines: tuple[LineStates, LineStates]
    pressures: Mapping[str, Quantity]
    ports: tuple[str, str]

    def all(self, valve: str) -> dict[str, Quantity]:
        """All states by name; valve: in descriptions."""
        (a, b), (head, rod) = self.lines, self.pressures.items()
        position = Quantity("1", f"Spool position of the {valve} valve, relative to its stroke")
        speed = Quantity("1/s", f"Spool speed of the {valve} valve", 10.0)
        spool = {self.spool.position: position, self.spool.speed: speed}
        return {**spool, **dict([head]), **a.all(), **dict([rod]), **b.all()}

    def start(self, position: Scalar, pressures: Pair) -> dict[str, Scalar]:
        """Initial values: oil at rest at two pressures [Pa], spool at rest."""
        state = {**dict.fromkeys(self.all(""), 0.0), self.spool.position: position}
        for name, line, pressure in zip(self.pressures, self.lines, pressures, strict=True):
            state |= dict.fromkeys((name, *line.pressures), pressure)
        return state

    def valve_and_lines(
        self, p: Any, u: Any, command: Scalar, line: HydraulicLine, x: Any
    ) -> tuple[Circuit, Sensed, dict[str, Scalar]]:
        """From ports to chambers; load pressure; rates of the spool. Parameters and state x of the drive."""
        edges, spool, curves = Edges.of(p, "valve"), Spool.of(p, "spool"), OpeningCurves.of(p, "valve")
        state = SpoolState(getattr(x, self.spool.position), getattr(x, self.spool.speed))
        flow_a, flow_b = (getattr(x, next(iter(states.flows))) for states in self.lines)
        ports = spool_valve.spool_ports(
            *(edges, spool, state.position, flow_a, flow_b),
            *(u.supply_pressure, u.tank_pressure, p.density, curves),
        )
        nodes = {name: Node(port.pressure) for name, port in zip(self.ports, ports, strict=True)}
        circuit = Circuit(nodes, spool_valve.branches(ports, *self.ports))
        for states, port, chamber in zip(self.lines, self.ports, self.pressures, strict=True):
            circuit |= hose.ladder(line, states, x, port, chamber)
        full = edges.full_command
        bands = opening_curve.meter_in_dead_bands(curves, spool.overlap_pa, spool.overlap_pb, full)
        sensed = partial(load_sensing.load_pressure, state.position, state.speed, bands, 1)
        rates = spool_valve.spool_rates(spool, state, spool_valve.commanded_position(command, full))
        return circuit, sensed, {self.spool.position: rates.position, self.spool.speed: rates.speed}
