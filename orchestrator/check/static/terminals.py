"""Terminals and icons: members that exist, names that match."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator

from orchestrator.check.finding import Finding, error, note
from orchestrator.check.registry import Table
from orchestrator.check.static.description import violations
from orchestrator.check.subject import Element, Subject, read_xml
from orchestrator.files.xml import children

RULES = Table()
FILE = "terminalsAndIcons/terminalsAndIcons.xml"
NAMES = {
    "TerminalMemberVariable": ("variableName",),
    "TerminalStreamMemberVariable": ("inStreamVariableName", "outStreamVariableName"),
}
CONNECTED = ("input", "output", "parameter", "calculatedParameter")


def _root(subject: Subject) -> Element | None:
    return read_xml(subject.folder, FILE)[0] if FILE in subject.files and subject.model.variables else None


@RULES.rule("terminal.schema", "terminalsAndIcons.xml keeps its schema")
def schema(subject: Subject) -> Iterator[Finding]:
    if FILE not in subject.files:
        return
    root, wrong = read_xml(subject.folder, FILE)
    if root is None:
        yield error(wrong)
        return
    for line, message in violations(root, "fmi3/fmi3TerminalsAndIcons.xsd"):
        yield error(f"{FILE} line {line}: {message}")
    if subject.major == 3 and root.get("fmiVersion") != subject.version:
        yield error(f"{FILE}: fmiVersion is {root.get('fmiVersion')}, expected {subject.version}")


@RULES.rule("terminal.members", "Members of terminals are variables of the FMU that can be connected")
def members(subject: Subject) -> Iterator[Finding]:
    root = _root(subject)
    known = {n: v for v in subject.model.variables for n in (v.name, *v.aliases)}
    for element in () if root is None else root.iter(*NAMES):
        for attribute in NAMES[element.tag]:
            name = element.get(attribute, "")
            where = f"{FILE} line {element.sourceline}: {element.getparent().get('name')}"
            if name not in known:
                yield error(f"{where}: member {name!r} is no variable of the FMU")
            elif known[name].causality not in CONNECTED and element.get("variableKind") in (
                "signal",
                "inflow",
                "outflow",
            ):
                yield error(f"{where}: member {name} is {known[name].causality}, expected an input or output")


@RULES.rule("terminal.names", "Terminals and their members have names of their own")
def names(subject: Subject) -> Iterator[Finding]:
    root = _root(subject)
    for level in () if root is None else root.iter("Terminals", "Terminal"):
        for name, count in Counter(t.get("name") for t in children(level, "Terminal")).items():
            if count > 1:
                yield error(f"{FILE}: {count} terminals {name} on one level, expected unique names")
        if level.tag == "Terminal":
            yield from _member_names(level)


def _member_names(terminal: Element) -> Iterator[Finding]:
    where = f"{FILE} line {terminal.sourceline}: {terminal.get('name')}"
    found = [m.get("memberName") for m in children(terminal, "TerminalMemberVariable")]
    if terminal.get("matchingRule") in ("plug", "bus") and None in found:
        yield error(
            f"{where}: a member has no memberName, which matching by {terminal.get('matchingRule')} needs"
        )
    for name, count in Counter(n for n in found if n is not None).items():
        if count > 1:
            yield error(f"{where}: {count} members {name}, expected unique names")


@RULES.rule("terminal.rule", "Matching rules are those of the standard, or have a domain name")
def rule(subject: Subject) -> Iterator[Finding]:
    root = _root(subject)
    for terminal in () if root is None else root.iter("Terminal"):
        said = terminal.get("matchingRule", "")
        if said not in ("plug", "bus", "sequence") and "." not in said:
            yield error(
                f"{FILE} line {terminal.sourceline}: {terminal.get('name')}: matchingRule {said!r},"
                " expected plug, bus, sequence or a reverse domain name"
            )


@RULES.rule("terminal.icons", "Icons that are named are there, as PNG too")
def icons(subject: Subject) -> Iterator[Finding]:
    root = _root(subject)
    for element in () if root is None else root.iter("TerminalGraphicalRepresentation"):
        base = element.get("iconBaseName", "")
        if base and f"terminalsAndIcons/{base}.png" not in subject.files:
            yield error(f"{FILE} line {element.sourceline}: terminalsAndIcons/{base}.png is missing")
    if "terminalsAndIcons/icon.svg" in subject.files and "terminalsAndIcons/icon.png" not in subject.files:
        yield error("terminalsAndIcons/icon.svg without icon.png, which the standard requires beside it")


@RULES.rule("terminal.there", "Ports that belong together form terminals (FMI 3)")
def there(subject: Subject) -> Iterator[Finding]:
    ports = len(subject.model.of("input", "output"))
    if subject.major == 3 and FILE not in subject.files and ports > 8:
        yield note(f"{FILE} is missing; {ports} inputs and outputs have to be connected one by one")
