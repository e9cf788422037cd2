"""State of a drive with spool dynamics and two lines of lumps, alike for cylinders and the swing motor."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from fmus.components import hose
from fmus.components.hose import LineState
from fmus.components.spool_valve import SpoolState
from fmus.contract import Quantity, Scalar


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

    def start(self, position: Scalar, pressures: tuple[Scalar, Scalar]) -> dict[str, Scalar]:
        """Initial values of the states with these names: oil at rest at two pressures [Pa], spool at rest."""
        state = {**dict.fromkeys(self.all(), 0.0), self.spool.position: position}
        for name, line, pressure in zip(self.pressures, self.lines, pressures, strict=True):
            state |= dict.fromkeys((name, *line.pressures), pressure)
        return state
