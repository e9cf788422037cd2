"""Rules on modelDescription.xml: schema, FMI version, identifiers, default experiment."""

import math
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from orchestrator.base.text import MODELICA
from orchestrator.base.xml import local_name
from orchestrator.check.finding import Finding, error, warning
from orchestrator.check.rules.variables import CPP, C
from orchestrator.check.subject import DESCRIPTION, Subject
from orchestrator.fmi.description import parse_float

FOLDER = Path(__file__).parents[1] / "schemas"  # of the FMI standard, as they are published
SCHEMAS = {2: "fmi2/fmi2ModelDescription.xsd", 3: "fmi3/fmi3ModelDescription.xsd"}


def xml_syntax(subject: Subject) -> Iterator[Finding]:
    """modelDescription.xml is XML without a DOCTYPE."""
    yield from (f for f in subject.faults if f.rule == "xml.syntax")
    root = subject.root
    if root is not None and local_name(root) != "fmiModelDescription":
        text = f"expected fmiModelDescription, got {local_name(root)}"
        yield error(f"{DESCRIPTION} line {root.sourceline}: {text}")


def xml_encoding(subject: Subject) -> Iterator[str]:
    """modelDescription.xml is written in UTF-8."""
    if subject.root is None:
        return
    encoding_ = subject.root.getroottree().docinfo.encoding or "UTF-8"
    if encoding_.upper() not in ("UTF-8", "ASCII", "US-ASCII"):
        yield f"{DESCRIPTION}: encoding: expected UTF-8, got {encoding_}"


def version_known(subject: Subject) -> Iterator[Finding]:
    """The FMI version is 2.0 or 3.0."""
    if subject.root is None or local_name(subject.root) != "fmiModelDescription":
        return
    if subject.version.startswith("1."):
        text = f"FMI {subject.version}: only the archive was checked, this check is for FMI 2.0 and 3.0"
        yield warning(f"{text}; FMPy, PyFMI and libcosim read FMI 1.0, many tools do not")
    elif not subject.major:
        yield error(f"{DESCRIPTION}: fmiVersion: expected 2.0 or 3.0, got {subject.version!r}")


def version_new(_: Subject) -> Iterator[str]:
    """Tools that support FMI 2.0 only can use the FMU."""
    yield "FMI 3.0: some tools support FMI 2.0 only, or FMI 3.0 in part; ship an FMI 2.0 FMU as well"


def xml_schema(subject: Subject) -> Iterator[str]:
    """modelDescription.xml is valid against the schema of its version."""
    if local_name(subject.root) == "fmiModelDescription":
        for line, message in violations(subject.root, SCHEMAS[subject.major]):
            yield f"{DESCRIPTION} line {line}: {message}"


def violations(root: Any, name: str) -> Iterator[tuple[int, str]]:
    """Line and message of each violation of one of the schemas of FMI."""
    from lxml import etree

    xsd = etree.XMLSchema(file=str(FOLDER / name))
    xsd.validate(root)
    for entry in xsd.error_log:
        yield entry.line, re.sub(r"\{[^}]*\}", "", entry.message)


def kind_some(subject: Subject) -> Iterator[Finding]:
    """The FMU offers Model Exchange or Co-Simulation."""
    offered = subject.model.interfaces
    if subject.model.variables and not offered:
        yield error(f"{DESCRIPTION}: expected ModelExchange or CoSimulation, got neither")
    elif list(offered) == ["ScheduledExecution"]:
        yield warning("offers Scheduled Execution only, which few tools support")


def missing_kind(subject: Subject, kind: str, other: str, say: str) -> Iterator[str]:
    """The FMU offers an interface type but not another one."""
    if other in subject.model.interfaces and kind not in subject.model.interfaces:
        yield say


EXAMPLE_TOKENS = {  # tokens that were copied from examples into many FMUs
    "0{32}": "the nil GUID",
    "8c4e810f3df34a008276176fa3c9f[0-9a-f]{3}": "the GUID of an example of the FMU SDK",
    "1234?5?6?7?8?9?0?|guid|token|test|todo": "a placeholder",
}
C_IDENTIFIER = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")


def identity_token(subject: Subject) -> Iterator[str]:
    """The GUID or instantiation token exists and is unique."""
    name = "guid" if subject.major == 2 else "instantiationToken"
    value = subject.root.get(name)
    where = f"{DESCRIPTION} line {subject.root.sourceline}: {name}"
    if value is not None and not value.strip():
        yield f"{where} is empty, expected a new value for each change of the interface"
    elif value is not None:
        digits = re.sub(r"[^0-9a-z]", "", value.lower())
        origin = next((o for pattern, o in EXAMPLE_TOKENS.items() if re.fullmatch(pattern, digits)), None)
        if origin:
            yield f"{where} is {value}, {origin}; tools cannot detect a changed interface"
        elif value.count("{") != value.count("}"):
            yield f"{where} is {value}, a brace is missing"


def identity_identifier(subject: Subject) -> Iterator[str]:
    """The model identifier is a C identifier."""
    for kind, element in subject.model.interfaces.items():
        name = element.get("modelIdentifier")
        where = f"{DESCRIPTION} line {element.line}: {kind}"
        if not C_IDENTIFIER.fullmatch(name) or name in C:
            text = "expected a C identifier, because binaries and C functions have this name"
            yield f"{where}: modelIdentifier: {text}, got {name!r}"


def identity_keyword(subject: Subject) -> Iterator[str]:
    """The model identifier is not a keyword of Modelica or C++."""
    for name in subject.model.identifiers:
        if languages := [n for n, words in (("Modelica", MODELICA), ("C++", CPP)) if name in words]:
            yield f"{DESCRIPTION}: modelIdentifier {name} is a keyword of {' and '.join(languages)}"


def identity_same(subject: Subject) -> Iterator[str]:
    """Co-Simulation and Model Exchange share a binary."""
    names = subject.model.identifiers
    if len(names) > 1:
        yield f"{DESCRIPTION}: model identifiers {', '.join(names)} differ; each needs its own binary"


def _experiment(subject: Subject) -> tuple[str, Mapping[str, float]]:
    """Where the default experiment is declared, and its attributes that are numbers; none without one."""
    element = subject.model.experiment
    numbers = {name: parse_float(text) for name, text in element.attributes.items()}
    return f"{DESCRIPTION} line {element.line}", {n: x for n, x in numbers.items() if x is not None}


def experiment_exists(subject: Subject) -> Iterator[str]:
    """The FMU has a default experiment with stop time and step size."""
    element = subject.model.experiment
    missing = [n for n in ("stopTime", "stepSize") if n not in element.attributes]
    if not element.line and subject.model.variables:
        yield f"{DESCRIPTION}: no DefaultExperiment; tools guess stop time and step size"
    elif missing and subject.model.variables:
        yield f"{DESCRIPTION} line {element.line}: DefaultExperiment has no {' and no '.join(missing)}"


def experiment_values(subject: Subject) -> Iterator[str]:
    """The default experiment can be run."""
    line, numbers = _experiment(subject)
    where = f"{line}: DefaultExperiment"
    for name in ("stepSize", "tolerance"):
        if name in numbers and not 0 < numbers[name] < math.inf:
            yield f"{where}: {name}: expected a positive number, got {numbers[name]:g}"
    start, stop, step = numbers.get("startTime", 0.0), numbers.get("stopTime"), numbers.get("stepSize")
    if stop is not None and not start < stop < math.inf:
        yield f"{where}: stopTime: expected a time after startTime {start:g}, got {stop:g}"
    if stop is not None and step is not None and stop > start and step > stop - start:
        yield f"{where}: stepSize {step:g} is longer than the experiment of {stop - start:g} s"


def experiment_step(subject: Subject) -> Iterator[str]:
    """The default experiment is a whole number of steps."""
    line, numbers = _experiment(subject)
    duration = numbers.get("stopTime", math.inf) - numbers.get("startTime", 0.0)
    size = numbers.get("stepSize", math.inf)
    if not 0 < size <= duration < math.inf:
        return
    count = duration / size
    # the step size is rounded in its last bit: the count is an integer to 1e-9 for up to a million steps
    if not math.isclose(count, round(count), rel_tol=1e-9):
        text = f"{duration:g} s are {count:.6g} steps of {size:g} s; the last step is shorter or missing"
        yield f"{line}: {text}"


def experiment_start(subject: Subject) -> Iterator[str]:
    """The default experiment starts at 0."""
    line, numbers = _experiment(subject)
    if start := numbers.get("startTime"):
        yield f"{line}: startTime is {start:g}; some tools start at 0 nevertheless"
