"""Which outputs depend on which others through connections, and where they do so in a circle."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

from orchestrator.system.graph import circle, circular, components
from orchestrator.system.system import Connection, Port, System

SHOWN = 6  # connections in a text


@dataclass(frozen=True)
class Knot:
    """Outputs that depend on each other in a circle: an algebraic loop, or perhaps one.

    connections   of Real values from outputs of the knot to inputs that outputs of the knot depend on
    declared      the FMUs declare these dependencies; else some do not say, and there may be no loop at all
    rounds        how often its outputs are read where signals in it are not Real, which nobody can solve for;
                  else 1
    discrete      an output in a circle of declared dependencies that is not Real
    sweeps        how often values are carried round before a loop is supposed; 0 where one is declared
    text          what it is, to begin a note or a message
    """

    connections: tuple[Connection, ...]
    declared: bool
    rounds: int
    discrete: Port | None
    sweeps: int
    text: str


class Feedthrough:
    """Direct dependencies of a system.

    graph   output -> outputs that it depends on through connections
    """

    def __init__(self, system: System, initially: bool = False) -> None:
        """initially: those of initialisation mode, else those of the run."""
        self._system, self._initially = system, initially
        source = {c.target: c.source for c in system.connections}
        self.graph: dict[Port, list[Port]] = {}
        for component in system.components.values():
            for v in component.interface.variables.values():
                if v.causality in ("output", "calculatedParameter"):
                    output = Port(component.name, v.name)
                    self.graph[output] = [source[u] for u in sorted(self.depends(output)) if u in source]

    def depends(self, output: Port) -> set[Port]:
        """The variables of its own component that an output depends on; all where the FMU does not say."""
        face = self._system.components[output.component].interface
        known = face.depends_initially if self._initially else face.depends
        return {Port(output.component, name) for name in known(output.variable)}

    def declares(self, output: Port) -> bool:
        """Does the FMU tell what an output depends on?"""
        face = self._system.components[output.component].interface
        return (face.initially if self._initially else face.feedthrough).get(output.variable) is not None

    def knot(self, group: list[Port]) -> Knot | None:
        """What there is to untie in one of the `components` of the graph."""
        if not circular(self.graph, group):
            return None
        declared = {y: self._inside(y, group) if self.declares(y) else [] for y in group}
        circles = [g for g in components(declared) if circular(declared, g)]
        involved = sorted({y.component for y in group})
        discrete = [y for y in group if not self._real(y)]
        needed = set().union(*map(self.depends, group))
        inside = [c for c in self._system.connections if c.source in group and c.target in needed]
        return Knot(
            connections=tuple(c for c in inside if self._real(c.source)),
            declared=bool(circles),
            rounds=len(involved) + 1 if discrete else 1,
            discrete=next((y for g in circles for y in g if y in discrete), None),
            sweeps=0 if circles else len(involved) + 1,
            text=self._loop(circles[0], inside) if circles else self._silence(group, involved),
        )

    def _inside(self, output: Port, group: list[Port]) -> list[Port]:
        return [p for p in self.graph[output] if p in group]

    def _real(self, port: Port) -> bool:
        return self._system.variable(port).is_real

    def _loop(self, group: list[Port], inside: list[Connection]) -> str:
        """The connections of a loop, beginning with one way round."""
        first = [self._wire(*pair) for pair in pairwise(circle(self.graph, group))]
        names = [str(c) for c in dict.fromkeys([*first, *inside])]
        more = f", and {len(names) - SHOWN} more" if len(names) > SHOWN else ""
        return f"algebraic loop {', '.join(names[:SHOWN])}{more}"

    def _silence(self, group: list[Port], involved: list[str]) -> str:
        silent = ", ".join(sorted(str(y) for y in group if not self.declares(y)))
        whole = " and ".join(involved)
        told = f"{silent}: direct dependencies are not declared"
        return f"{told}, which would make an algebraic loop of {whole}"

    def _wire(self, source: Port, output: Port) -> Connection:
        """The connection by which `source` reaches `output`."""
        known = self.depends(output)
        return next(c for c in self._system.connections if c.source == source and c.target in known)
