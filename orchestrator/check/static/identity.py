"""What identifies the FMU: GUID or instantiation token, and model identifiers."""

from __future__ import annotations

import re
from collections.abc import Iterator

from orchestrator.check.finding import Finding, error, note, warning
from orchestrator.check.registry import Table
from orchestrator.check.static.names import CPP, MODELICA, C
from orchestrator.check.subject import Subject
from orchestrator.check.unpack import DESCRIPTION

RULES = Table()
SAMPLES = {  # tokens that were copied from examples into many FMUs
    "0{32}": "the nil GUID",
    "8c4e810f3df34a008276176fa3c9f[0-9a-f]{3}": "that of an example of the FMU SDK",
    "1234?5?6?7?8?9?0?|guid|token|test|todo": "a placeholder",
}
BINARY_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")


@RULES.rule(
    "identity.token",
    "GUID or instantiation token is there and its own",
    "FMPy#167 FMIKit#80 OpenModelica#3809",
)
def token(subject: Subject) -> Iterator[Finding]:
    if subject.root is None or not subject.major:
        return
    name = "guid" if subject.major == 2 else "instantiationToken"
    said = subject.root.get(name)
    where = f"{DESCRIPTION} line {subject.root.sourceline}: {name}"
    if said is not None and not said.strip():
        yield error(f"{where} is empty, expected one that is new for each change of the interface")
    elif said is not None:
        bare = re.sub(r"[^0-9a-z]", "", said.lower())
        sample = next((what for pattern, what in SAMPLES.items() if re.fullmatch(pattern, bare)), None)
        if sample:
            yield warning(f"{where} is {said}, {sample}; a changed interface goes unnoticed")
        elif said.count("{") != said.count("}"):
            yield warning(f"{where} is {said}, a brace is missing")


@RULES.rule("identity.identifier", "The model identifier is a C identifier")
def identifier(subject: Subject) -> Iterator[Finding]:
    for kind, element in subject.model.interfaces.items():
        name = element.get("modelIdentifier", "")
        where = f"{DESCRIPTION} line {element.sourceline}: {kind}"
        if not BINARY_NAME.fullmatch(name) or name in C:
            yield error(
                f"{where}: modelIdentifier {name!r} is no C identifier; it names binaries and C functions"
            )


@RULES.rule("identity.keyword", "The model identifier is no keyword of Modelica or C++", "OpenModelica#5706")
def keyword(subject: Subject) -> Iterator[Finding]:
    for name in subject.model.identifiers:
        languages = [n for n, words in (("Modelica", MODELICA), ("C++", CPP)) if name in words]
        if languages:
            yield note(f"{DESCRIPTION}: modelIdentifier {name} is a keyword of {' and '.join(languages)}")


@RULES.rule("identity.same", "Co-Simulation and Model Exchange have one binary")
def same(subject: Subject) -> Iterator[Finding]:
    names = subject.model.identifiers
    if len(names) > 1:
        yield note(f"{DESCRIPTION}: model identifiers {', '.join(names)} differ; each needs its own binary")
