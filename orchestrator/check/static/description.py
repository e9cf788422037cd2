"""modelDescription.xml as a file: XML, version, schema, and what FMPy says of it."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from orchestrator.check.finding import Finding, error, note, warning
from orchestrator.check.registry import Table
from orchestrator.check.subject import Subject
from orchestrator.check.unpack import DESCRIPTION
from orchestrator.files.xml import local

RULES = Table()
SCHEMAS = {2: "fmi2/fmi2ModelDescription.xsd", 3: "fmi3/fmi3ModelDescription.xsd"}
FMPY = "fmpy.validate"
MANY = 2000  # variables; FMPy takes milliseconds for each name
STUMBLES = "cannot read the FMU"
# What FMPy says -> the rules that say it better. FMPy's message is told when none of them found anything.
COVERED = {
    r"ERROR \(line": ("xml.schema",),
    r"BuildDescription": ("source.description",),
    r"is not unique": ("variable.duplicate",),
    r"must have variability != |combination ": ("variable.combination", "variable.variability"),
    r"declaredType": ("variable.type",),
    r"start value": ("variable.start",),
    r"unit .* is not defined": ("unit.undefined", "unit.display"),
    r"legal variable name|contains an illegal": ("name.grammar",),
    r"dependenc": ("structure.kinds",),
    r"Outputs must have": ("structure.outputs", "variable.reference"),
    r"must have the attribute .derivative|The derivative attribute": ("structure.derivatives",),
    r"InitialUnknowns": ("structure.initial", "structure.derivatives", "variable.reference"),
    r"independent variable": ("variable.independent",),
    r"same value reference": ("variable.reference",),
}


@RULES.rule("xml.syntax", "modelDescription.xml is XML without document type")
def syntax(subject: Subject) -> Iterator[Finding]:
    yield from (f for f in subject.faults if f.rule == "xml.syntax")
    root = subject.root
    if root is not None and local(root) != "fmiModelDescription":
        yield error(f"{DESCRIPTION} line {root.sourceline}: expected fmiModelDescription, got {local(root)}")


@RULES.rule("xml.encoding", "modelDescription.xml is written in UTF-8")
def encoding(subject: Subject) -> Iterator[Finding]:
    if subject.root is None:
        return
    said = subject.root.getroottree().docinfo.encoding or "UTF-8"
    if said.upper() not in ("UTF-8", "ASCII", "US-ASCII"):
        yield error(f"{DESCRIPTION}: encoding is {said}, expected UTF-8")


@RULES.rule("version.known", "The FMI version is 2.0 or 3.0")
def version(subject: Subject) -> Iterator[Finding]:
    said = subject.version
    if subject.root is None or local(subject.root) != "fmiModelDescription":
        return
    if said.startswith("1."):
        yield error(
            f"FMI {said} is not supported by this check, expected 2.0 or 3.0; newer tools drop it too"
        )
    elif not subject.major:
        yield error(f"{DESCRIPTION}: fmiVersion is {said!r}, expected 2.0 or 3.0")


@RULES.rule("version.new", "Tools that take FMI 2.0 only can use the FMU")
def new(subject: Subject) -> Iterator[Finding]:
    if subject.major == 3:
        yield note("FMI 3.0: some tools take FMI 2.0 only or FMI 3.0 in part; ship an FMI 2.0 FMU beside it")


@RULES.rule("xml.schema", "modelDescription.xml keeps the schema of its version", "FMPy#774")
def schema(subject: Subject) -> Iterator[Finding]:
    if subject.root is None or not subject.major or local(subject.root) != "fmiModelDescription":
        return
    for line, message in violations(subject.root, SCHEMAS[subject.major]):
        yield error(f"{DESCRIPTION} line {line}: {message}")


def violations(root: Any, name: str) -> Iterator[tuple[int, str]]:
    """Line and message of each violation of one of FMPy's schemas."""
    import fmpy
    from lxml import etree

    judge = etree.XMLSchema(file=str(Path(fmpy.__file__).parent / "schema" / name))
    judge.validate(root)
    for entry in judge.error_log:
        yield entry.line, re.sub(r"\{[^}]*\}", "", entry.message)


@RULES.rule(FMPY, "FMPy's validation has no complaint that no other rule has")
def fmpy_validate(subject: Subject) -> Iterator[Finding]:
    if subject.root is None or not subject.major:
        return
    from fmpy import read_model_description
    from fmpy.model_description import ValidationError

    names = len(subject.model.variables) <= MANY
    options = {"validate": True, "validate_variable_names": names, "validate_model_structure": True}
    try:
        read_model_description(str(subject.folder), **options)
    except ValidationError as refusal:
        for problem in dict.fromkeys(refusal.problems):
            yield error(f"FMPy: {' '.join(str(problem).split())}", "fmpy")
    except Exception as problem:  # FMPy raises plain ones, some of them by stumbling
        yield error(f"FMPy {STUMBLES}: {type(problem).__name__}: {problem}", "fmpy")


def without_repeats(findings: Iterable[Finding]) -> tuple[Finding, ...]:
    """The findings without those of FMPy that another rule has told, or that follow from an error told."""
    everything = tuple(findings)
    own = [f for f in everything if f.rule != FMPY]
    ids, wrong = {f.rule for f in own}, any(f.severity == "error" for f in own)
    covered = [re.compile(pattern) for pattern, rules in COVERED.items() if ids.intersection(rules)]

    def told(f: Finding) -> bool:
        stumbles = wrong and f.text.startswith(f"FMPy {STUMBLES}")
        return f.rule == FMPY and (stumbles or any(p.search(f.text) for p in covered))

    return tuple(f for f in everything if not told(f))


@RULES.rule("kind.some", "The FMU offers Model Exchange or Co-Simulation")
def kinds(subject: Subject) -> Iterator[Finding]:
    offered = subject.model.interfaces
    if subject.model.variables and not offered:
        yield error(f"{DESCRIPTION}: expected ModelExchange or CoSimulation, found neither")
    elif list(offered) == ["ScheduledExecution"]:
        yield warning("offers Scheduled Execution only; few tools take it")


@RULES.rule("kind.simulation", "The FMU offers Co-Simulation")
def simulation(subject: Subject) -> Iterator[Finding]:
    if "ModelExchange" in subject.model.interfaces and "CoSimulation" not in subject.model.interfaces:
        yield note("no Co-Simulation: masters without a solver of their own cannot run it")


@RULES.rule("kind.exchange", "The FMU offers Model Exchange")
def exchange(subject: Subject) -> Iterator[Finding]:
    if "CoSimulation" in subject.model.interfaces and "ModelExchange" not in subject.model.interfaces:
        yield note("no Model Exchange: the equations cannot join the solver of the importing tool")
