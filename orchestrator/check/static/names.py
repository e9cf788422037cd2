"""Names of variables that every tool can show, find and use."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Iterator

from orchestrator.check.finding import Finding, error, note, warning
from orchestrator.check.model import Variable, listed
from orchestrator.check.registry import Table
from orchestrator.check.subject import Subject

RULES = Table()
LONGEST = 63  # namelengthmax of MATLAB
IDENTIFIER = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")
QUOTED = r"'(?:[A-Za-z0-9_!#$%&()*+,\-./:;<>=?@\[\]^{}|~ ]|\\['\"?\\abfnrtv])+'"
PART = rf"(?:[A-Za-z_][A-Za-z0-9_]*|{QUOTED})(?:\[[0-9]+(?:,[0-9]+)*\])?"
PATH = rf"{PART}(?:\.{PART})*"
STRUCTURED = re.compile(rf"{PATH}|der\({PATH}(?:,[0-9]+)?\)")


def _words(text: str) -> frozenset[str]:
    return frozenset(text.split())


MODELICA = _words(
    """algorithm and annotation assert block break class connect connector constant constrainedby der
    discrete each else elseif elsewhen encapsulated end enumeration equation expandable extends external false
    final flow for function if import impure in initial inner input loop model not operator or outer output
    package parameter partial protected public pure record redeclare replaceable return stream then time true
    type when while within"""
)
C = _words(
    """auto break case char const continue default do double else enum extern float for goto if inline int
    long register restrict return short signed sizeof static struct switch typedef union unsigned void
    volatile while"""
)
CPP = _words(
    """and asm bool catch class delete explicit export false friend mutable namespace new not operator or
    private protected public template this throw true try typename using virtual xor"""
)


def _named(subject: Subject) -> Iterator[tuple[Variable, str]]:
    for v in subject.model.variables:
        for name in (v.name, *v.aliases):
            yield v, name


def _structured(subject: Subject) -> bool:
    return subject.root is not None and subject.root.get("variableNamingConvention") == "structured"


@RULES.rule(
    "name.grammar",
    "Names keep the naming convention that the FMU claims",
    "casadi#4030 fmi-cross-check#74 OpenModelica#11265",
)
def grammar(subject: Subject) -> Iterator[Finding]:
    for v, name in _named(subject):
        if re.search(r"[\r\n\t]", name):
            yield error(f"{v}: the name {name!r} has a line break or tab")
        elif _structured(subject) and name and not STRUCTURED.fullmatch(name):
            yield error(f"{v}: the name {name!r} breaks the grammar of variableNamingConvention structured")


@RULES.rule("name.structured", "Inputs and outputs have flat names", "Hopsan#2266 Hopsan#2280 OSMP#70")
def structured(subject: Subject) -> Iterator[Finding]:
    ports = [v for v in subject.model.of("input", "output") if re.search(r"[.\[]", v.name)]
    if _structured(subject) and ports:
        yield note(f"{listed(ports)}: structured names of inputs or outputs, expected flat names")


@RULES.rule("name.characters", "Names are identifiers: letters, digits and underscores")
def characters(subject: Subject) -> Iterator[Finding]:
    if _structured(subject):
        return  # the rule on the grammar speaks of these
    odd = [v for v in subject.model.variables if v.name and not IDENTIFIER.fullmatch(v.name)]
    if odd:
        yield note(f"{listed(odd)}: no identifiers; tools rename or quote them")


@RULES.rule(
    "name.mangled", "Names stay different when a tool replaces what is no letter or digit", "Modelica-FMI#22"
)
def mangled(subject: Subject) -> Iterator[Finding]:
    groups: dict[str, list[Variable]] = defaultdict(list)
    for v in subject.model.variables:
        groups[re.sub(r"\W", "_", v.name)].append(v)
    for name, same in groups.items():
        if len({v.name for v in same}) > 1:
            yield note(f"{same[1]}: becomes {name} where {same[0].name} does too")


@RULES.rule("name.case", "Names differ by more than case")
def case(subject: Subject) -> Iterator[Finding]:
    seen: dict[str, Variable] = {}
    for v in subject.model.variables:
        other = seen.setdefault(v.name.casefold(), v)
        if other.name != v.name:
            yield note(f"{v}: differs from {other.name} only by case")


@RULES.rule("name.keyword", "No name is a keyword of Modelica or C", "OpenModelica#3596 OpenModelica#5706")
def keyword(subject: Subject) -> Iterator[Finding]:
    for v in subject.model.variables:
        if v.causality == "independent":
            continue
        languages = [n for n, words in (("Modelica", MODELICA), ("C", C)) if v.name in words]
        if languages:
            yield warning(f"{v}: is a keyword of {' and '.join(languages)}")


@RULES.rule("name.length", f"Names have at most {LONGEST} characters", "FMIKit#341")
def length(subject: Subject) -> Iterator[Finding]:
    long = [v for v in subject.model.of("input", "output", "parameter") if len(v.name) > LONGEST]
    if long:
        yield note(f"{listed(long)}: {len(long[0].name)} characters, expected at most {LONGEST}")
