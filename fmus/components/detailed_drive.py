"""A valve with spool dynamics, two lines of lumps, two chambers: alike for cylinders and the swing motor."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from fmus.components import hose, load_sensing, opening_curve, spool_valve
from fmus.components.hose import HydraulicLine, LineState
from fmus.components.load_sensing import LoadPressure
from fmus.components.opening_curve import OpeningCurves
from fmus.components.spool_valve import EdgeFlows, Edges, Spool, SpoolState
from fmus.contract import Quantity, Scalar

Pair = tuple[Scalar, Scalar]  # of both chambers


@dataclass(frozen=True)
class DetailedState:
    """State of spool, both lines and both chambers (pressures [Pa]); also for their rates and names."""

    spool: SpoolState
    lines: tuple[LineState, LineState]
    pressures: tuple[Any, Any]

    def apply(self, function: Callable[[Any], Any]) -> DetailedState:
        """The function applied to every entry."""
        spool = SpoolState(function(self.spool.position), function(self.spool.speed))
        (a, b), (p_a, p_b) = (line.apply(function) for line in self.lines), map(function, self.pressures)
        return DetailedState(spool, (a, b), (p_a, p_b))

    def all(self) -> tuple[Any, ...]:
        """All entries in order."""
        a, b = self.lines
        return (self.spool.position, self.spool.speed, *self.pressures, *a.all(), *b.all())

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
        """Initial values of the states with these names: oil at rest at two pressures [Pa], spool at rest."""
        state = {**dict.fromkeys(self.all(), 0.0), self.spool.position: position}
        for name, line, pressure in zip(self.pressures, self.lines, pressures, strict=True):
            state |= dict.fromkeys((name, *line.pressures), pressure)
        return state


@dataclass(frozen=True)
class ValveAndLines:
    """The valve and its lines at one instant; line: parameters of each line."""

    line: HydraulicLine
    edges: Edges
    spool: Spool
    curves: OpeningCurves
    x: DetailedState
    ports: tuple[EdgeFlows, EdgeFlows]

    @classmethod
    def of(cls, p: Any, u: Any, line: HydraulicLine, x: DetailedState) -> ValveAndLines:
        """From parameters and inputs of a drive, and its state."""
        edges, spool, curves = Edges.of(p, "valve"), Spool.of(p, "spool"), OpeningCurves.of(p, "valve")
        ports = spool_valve.spool_ports(
            *(edges, spool, x.spool.position, x.lines[0].flows[0], x.lines[1].flows[0]),
            *(u.supply_pressure, u.tank_pressure, p.density, curves),
        )
        return cls(line, edges, spool, curves, x, ports)

    def rates(self, command: Scalar, pressure_rates: Pair) -> DetailedState:
        """Time derivative of the state at a command [V]; pressure_rates: of the chambers [Pa/s]."""
        commanded = spool_valve.commanded_position(command, self.edges.full_command)
        a, b = (
            hose.rates(self.line, state, port.pressure, pressure)
            for state, port, pressure in zip(self.x.lines, self.ports, self.x.pressures, strict=True)
        )
        spool = spool_valve.spool_rates(self.spool, self.x.spool, commanded)
        return DetailedState(spool, (a, b), pressure_rates)

    def load_pressure(self, pressure_rates: Pair, u: Any) -> LoadPressure:
        """Load pressure of the section."""
        spool, full = self.x.spool, self.edges.full_command
        bands = opening_curve.meter_in_dead_bands(
            self.curves, self.spool.overlap_pa, self.spool.overlap_pb, full
        )
        return load_sensing.load_pressure(
            spool.position, spool.speed, bands, 1, self.x.pressures, pressure_rates, u
        )
