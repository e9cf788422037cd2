"""Terminals of FMUs: groups of variables that are connected together, such as the shaft of a drive.

An FMU describes them in terminalsAndIcons/terminalsAndIcons.xml (FMI 3.0, 2.4.9, which FMI 2.0.4 adopted).
Two terminals fit if their kinds and matching rules are equal. The rule says which members belong together:
`plug`, all of them by name; `bus`, those that both have; `sequence`, by their order.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property

from orchestrator.base.errors import Problem, suggest
from orchestrator.base.xml import XmlElement, read_xml
from orchestrator.ssp.system import SOURCES, Component, Port, System

FILE, ROOT = "terminalsAndIcons/terminalsAndIcons.xml", "fmiTerminalsAndIcons"
MEMBER, BUS, SEQUENCE = "TerminalMemberVariable", "bus", "sequence"


@dataclass(frozen=True)
class Terminal:
    """kind: terminal kind and matching rule; members: name, or number in a sequence -> variable."""

    kind: tuple[str, str]
    members: Mapping[str, Port]


@dataclass(frozen=True)
class Terminals:
    """The terminals of the components of a system, by component.terminal; read when one is named."""

    system: System

    @cached_property
    def _known(self) -> Mapping[str, Terminal]:
        return {name: t for c in self.system.components.values() for name, t in _terminals(c)}

    def pairs(self, source: str, target: str) -> Iterator[tuple[Port, Port]]:
        """Output and input of each member of two terminals, or the ports that the names are."""
        if arrays := self.system.pairs(source, target):
            yield from arrays
            return
        ends = self.system.find(source), self.system.find(target)
        if all(ends) or not (named := {source, target} & self._known.keys()):
            yield self.system.port(source), self.system.port(target)
            return
        if other := sorted({source, target} - named):
            told = f"expected two terminals, got {named.pop()} and {other[0]}"
            raise Problem(f"{source} -> {target}: {told}{suggest(other[0], self._known)}")
        a, b = self._known[source], self._known[target]
        where = f"{source} -> {target}"
        if a.kind != b.kind:
            told = " and ".join(f"{kind} ({rule})" for kind, rule in (a.kind, b.kind))
            raise Problem(f"{where}: expected terminals of one kind, got {told}")
        if a.kind[1] != BUS and (alone := sorted(a.members.keys() ^ b.members.keys())):
            raise Problem(f"{where}: expected the same members in both, got {alone[0]} in one of them")
        for member in (m for m in a.members if m in b.members):
            yield self._directed(a.members[member], b.members[member], f"{where}: member {member}")

    def _directed(self, one: Port, other: Port, where: str) -> tuple[Port, Port]:
        """The output and the input."""
        for port in (one, other):
            self.system.port(str(port))  # raises if the FMU has no such variable
        causality = {port: self.system.variable(port).causality for port in (one, other)}
        for source, target in ((one, other), (other, one)):
            if causality[source] in SOURCES and causality[target] == "input":
                return source, target
        got = f"{causality[one]} {one} and {causality[other]} {other}"
        raise Problem(f"{where}: expected an output and an input, got {got}")


def _terminals(component: Component) -> Iterator[tuple[str, Terminal]]:
    """The terminals in an FMU, those inside of others, too: component.outer.inner."""
    file = component.source and component.source.member(FILE)
    if file and file.exists and (inside := read_xml(file, ROOT).child("Terminals")):
        for terminal in inside.children("Terminal"):
            yield from _with_inner(terminal, component.name)


def _with_inner(terminal: XmlElement, outer: str) -> Iterator[tuple[str, Terminal]]:
    name, rule = f"{outer}.{terminal.required('name')}", terminal.required("matchingRule")
    component = outer.partition(".")[0]
    members = {
        str(k) if rule == SEQUENCE else m.required("memberName"): Port(component, m.required("variableName"))
        for k, m in enumerate(terminal.children(MEMBER), 1)
    }
    yield name, Terminal((terminal.get("terminalKind") or "without kind", rule), members)
    for inner in terminal.children("Terminal"):
        yield from _with_inner(inner, name)
