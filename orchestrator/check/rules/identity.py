"""modelDescription.xml as a file: version, schema, what FMPy says of it; identity; default experiment."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from orchestrator.base.xml import local_name
from orchestrator.check.finding import Finding, RuleTable, error, note, warning
from orchestrator.check.rules.variables import CPP, MODELICA, C
from orchestrator.check.subject import DESCRIPTION, Subject
from orchestrator.fmi.raw_description import Entry

DESCRIPTION_FILE = RuleTable()
SCHEMAS = {2: "fmi2/fmi2ModelDescription.xsd", 3: "fmi3/fmi3ModelDescription.xsd"}
FMPY = "fmpy.validate"
MANY = 2000  # variables; FMPy takes milliseconds for each name
STUMBLES = "cannot read the FMU"
# FMPy's message -> the rules that say it better; it is reported when none of them found anything.
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


@DESCRIPTION_FILE.rule("xml.syntax", "modelDescription.xml is XML without document type")
def syntax(subject: Subject) -> Iterator[Finding]:
    yield from (f for f in subject.faults if f.rule == "xml.syntax")
    root = subject.root
    if root is not None and local_name(root) != "fmiModelDescription":
        yield error(
            f"{DESCRIPTION} line {root.sourceline}: expected fmiModelDescription, got {local_name(root)}"
        )


@DESCRIPTION_FILE.rule("xml.encoding", "modelDescription.xml is written in UTF-8")
def encoding(subject: Subject) -> Iterator[Finding]:
    if subject.root is None:
        return
    said = subject.root.getroottree().docinfo.encoding or "UTF-8"
    if said.upper() not in ("UTF-8", "ASCII", "US-ASCII"):
        yield error(f"{DESCRIPTION}: encoding is {said}, expected UTF-8")


@DESCRIPTION_FILE.rule("version.known", "The FMI version is 2.0 or 3.0")
def version(subject: Subject) -> Iterator[Finding]:
    said = subject.version
    if subject.root is None or local_name(subject.root) != "fmiModelDescription":
        return
    if said.startswith("1."):
        yield error(
            f"FMI {said} is not supported by this check, expected 2.0 or 3.0; newer tools drop it too"
        )
    elif not subject.major:
        yield error(f"{DESCRIPTION}: fmiVersion is {said!r}, expected 2.0 or 3.0")


@DESCRIPTION_FILE.rule("version.new", "Tools that take FMI 2.0 only can use the FMU")
def new(subject: Subject) -> Iterator[Finding]:
    if subject.major == 3:
        yield note("FMI 3.0: some tools take FMI 2.0 only or FMI 3.0 in part; ship an FMI 2.0 FMU as well")


@DESCRIPTION_FILE.rule("xml.schema", "modelDescription.xml keeps the schema of its version", "FMPy#774")
def schema(subject: Subject) -> Iterator[Finding]:
    if subject.root is None or not subject.major or local_name(subject.root) != "fmiModelDescription":
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


@DESCRIPTION_FILE.rule(FMPY, "FMPy's validation has no complaint that no other rule has")
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
    """The findings without those of FMPy that another rule reports, or that follow from a reported error."""
    everything = tuple(findings)
    own = [f for f in everything if f.rule != FMPY]
    ids, wrong = {f.rule for f in own}, any(f.severity == "error" for f in own)
    covered = [re.compile(pattern) for pattern, rules in COVERED.items() if ids.intersection(rules)]

    def repeated(f: Finding) -> bool:
        stumbles = wrong and f.text.startswith(f"FMPy {STUMBLES}")
        return f.rule == FMPY and (stumbles or any(p.search(f.text) for p in covered))

    return tuple(f for f in everything if not repeated(f))


@DESCRIPTION_FILE.rule("kind.some", "The FMU offers Model Exchange or Co-Simulation")
def kinds(subject: Subject) -> Iterator[Finding]:
    offered = subject.model.interfaces
    if subject.model.variables and not offered:
        yield error(f"{DESCRIPTION}: expected ModelExchange or CoSimulation, found neither")
    elif list(offered) == ["ScheduledExecution"]:
        yield warning("offers Scheduled Execution only; few tools take it")


@DESCRIPTION_FILE.rule("kind.simulation", "The FMU offers Co-Simulation")
def simulation(subject: Subject) -> Iterator[Finding]:
    if "ModelExchange" in subject.model.interfaces and "CoSimulation" not in subject.model.interfaces:
        yield note("no Co-Simulation: masters without a solver of their own cannot run it")


@DESCRIPTION_FILE.rule("kind.exchange", "The FMU offers Model Exchange")
def exchange(subject: Subject) -> Iterator[Finding]:
    if "CoSimulation" in subject.model.interfaces and "ModelExchange" not in subject.model.interfaces:
        yield note("no Model Exchange: the equations cannot join the solver of the importing tool")


IDENTITY = RuleTable()
SAMPLES = {  # tokens that were copied from examples into many FMUs
    "0{32}": "the nil GUID",
    "8c4e810f3df34a008276176fa3c9f[0-9a-f]{3}": "that of an example of the FMU SDK",
    "1234?5?6?7?8?9?0?|guid|token|test|todo": "a placeholder",
}
BINARY_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")


@IDENTITY.rule(
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


@IDENTITY.rule("identity.identifier", "The model identifier is a C identifier")
def identifier(subject: Subject) -> Iterator[Finding]:
    for kind, element in subject.model.interfaces.items():
        name = element.get("modelIdentifier")
        where = f"{DESCRIPTION} line {element.line}: {kind}"
        if not BINARY_NAME.fullmatch(name) or name in C:
            yield error(
                f"{where}: modelIdentifier {name!r} is no C identifier; it names binaries and C functions"
            )


@IDENTITY.rule(
    "identity.keyword", "The model identifier is no keyword of Modelica or C++", "OpenModelica#5706"
)
def keyword(subject: Subject) -> Iterator[Finding]:
    for name in subject.model.identifiers:
        languages = [n for n, words in (("Modelica", MODELICA), ("C++", CPP)) if name in words]
        if languages:
            yield note(f"{DESCRIPTION}: modelIdentifier {name} is a keyword of {' and '.join(languages)}")


@IDENTITY.rule("identity.same", "Co-Simulation and Model Exchange have one binary")
def same(subject: Subject) -> Iterator[Finding]:
    names = subject.model.identifiers
    if len(names) > 1:
        yield note(f"{DESCRIPTION}: model identifiers {', '.join(names)} differ; each needs its own binary")


DEFAULT_EXPERIMENT = RuleTable()


def _number(element: Entry, name: str) -> float | None:
    try:
        return float(element.get(name))
    except ValueError:
        return None


@DEFAULT_EXPERIMENT.rule("experiment.there", "There is a default experiment with stop time and step size")
def there(subject: Subject) -> Iterator[Finding]:
    if not subject.model.variables:
        return
    element = subject.model.experiment
    if element is None:
        yield note(f"{DESCRIPTION}: no DefaultExperiment; tools guess stop time and step size")
        return
    lacking = [n for n in ("stopTime", "stepSize") if n not in element.attributes]
    if lacking:
        yield note(f"{DESCRIPTION} line {element.line}: DefaultExperiment has no {' and no '.join(lacking)}")


@DEFAULT_EXPERIMENT.rule("experiment.values", "The default experiment can be run")
def values(subject: Subject) -> Iterator[Finding]:
    element = subject.model.experiment
    if element is None:
        return
    where = f"{DESCRIPTION} line {element.line}: DefaultExperiment"
    start, stop = _number(element, "startTime") or 0.0, _number(element, "stopTime")
    for name in ("stepSize", "tolerance"):
        value = _number(element, name)
        if value is not None and not (math.isfinite(value) and value > 0):
            yield error(f"{where}: {name} is {value:g}, expected a positive number")
    if stop is not None and not start < stop < math.inf:
        yield error(f"{where}: stopTime {stop:g} is not a time after startTime {start:g}")
    step = _number(element, "stepSize")
    if stop is not None and step is not None and stop > start and step > stop - start:
        yield warning(f"{where}: stepSize {step:g} is longer than the experiment of {stop - start:g} s")


@DEFAULT_EXPERIMENT.rule("experiment.step", "The step size divides the experiment", "FMIKit#133 FMPy#887")
def step(subject: Subject) -> Iterator[Finding]:
    element = subject.model.experiment
    if element is None:
        return
    start, stop = _number(element, "startTime") or 0.0, _number(element, "stopTime")
    size = _number(element, "stepSize")
    if stop is None or size is None or not 0 < size <= stop - start < math.inf:
        return
    count = (stop - start) / size
    # a decimal step is rounded in its last bit, so the count is whole to 1e-9 for up to a million steps
    if not math.isclose(count, round(count), rel_tol=1e-9):
        yield note(
            f"{DESCRIPTION} line {element.line}: {stop - start:g} s are {count:.6g} steps of {size:g} s"
            "; the last step is shorter, or missing"
        )


@DEFAULT_EXPERIMENT.rule(
    "experiment.start", "The default experiment starts at 0", "PyFMI#261 FMPy#638 OpenModelica#11855"
)
def start(subject: Subject) -> Iterator[Finding]:
    element = subject.model.experiment
    begin = None if element is None else _number(element, "startTime")
    if element is not None and begin:
        yield note(f"{DESCRIPTION} line {element.line}: startTime is {begin:g}; some tools start at 0 anyway")
