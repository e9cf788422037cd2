"""What the FMU says it can and cannot do."""

from __future__ import annotations

from collections.abc import Iterator

from orchestrator.check.finding import Finding, error, note, warning
from orchestrator.check.model import whole
from orchestrator.check.registry import Table
from orchestrator.check.subject import Element, Subject
from orchestrator.check.unpack import DESCRIPTION
from orchestrator.files.xml import flag

RULES = Table()
SPELLINGS = {
    2: ("canGetAndSetFMUstate", "canSerializeFMUstate"),
    3: ("canGetAndSetFMUState", "canSerializeFMUState"),
}
DERIVATIVES = {2: "providesDirectionalDerivative", 3: "providesDirectionalDerivatives"}


def _kinds(subject: Subject) -> Iterator[tuple[str, Element]]:
    """Where a kind stands, and its element."""
    for kind, element in subject.model.interfaces.items():
        yield f"{DESCRIPTION} line {element.sourceline}: {kind}", element


@RULES.rule(
    "ability.once",
    "Many instances can live in one process",
    "casadi#3937 casadi#4212 FMIKit#328 FMIKit#397 into-cps#17",
)
def once(subject: Subject) -> Iterator[Finding]:
    for where, element in _kinds(subject):
        if flag(element, "canBeInstantiatedOnlyOncePerProcess"):
            yield warning(f"{where}: canBeInstantiatedOnlyOncePerProcess; no simulation can have two of it")


@RULES.rule("ability.tool", "The FMU runs without the tool that made it", "FMIKit#373")
def tool(subject: Subject) -> Iterator[Finding]:
    for where, element in _kinds(subject):
        if flag(element, "needsExecutionTool"):
            yield warning(f"{where}: needsExecutionTool; the target machine needs that tool and its licence")


@RULES.rule(
    "ability.state",
    "The state can be saved and restored",
    "OMSimulator#1542 UniFMU#83 OpenModelica#7939 FMIKit#136",
)
def state(subject: Subject) -> Iterator[Finding]:
    for where, element in _kinds(subject):
        can, bytes_ = (flag(element, name) for name in SPELLINGS[subject.major])
        if bytes_ and not can:
            yield error(f"{where}: {SPELLINGS[subject.major][1]} without {SPELLINGS[subject.major][0]}")
        elif not can:
            yield note(f"{where}: the state cannot be saved; no rollback, no iterated or adaptive steps")


@RULES.rule("ability.serialize", "The state can be written to a file", "FMPy#811")
def serialize(subject: Subject) -> Iterator[Finding]:
    for where, element in _kinds(subject):
        can, bytes_ = (flag(element, name) for name in SPELLINGS[subject.major])
        if can and not bytes_:
            yield note(f"{where}: the state cannot be serialised; no warm start in another process")


@RULES.rule("ability.derivatives", "The FMU gives directional derivatives", "OpenModelica#7371 PyFMI#83")
def derivatives(subject: Subject) -> Iterator[Finding]:
    for where, element in _kinds(subject):
        if not flag(element, DERIVATIVES[subject.major]):
            yield note(
                f"{where}: no directional derivatives; tools take differences, which cost and err more"
            )


@RULES.rule("ability.step", "The communication step can vary")
def step(subject: Subject) -> Iterator[Finding]:
    for where, element in _kinds(subject):
        if "CoSimulation" in where and not flag(element, "canHandleVariableCommunicationStepSize"):
            yield note(
                f"{where}: the communication step must not vary; masters with step control cannot use it"
            )


@RULES.rule("ability.slopes", "Outputs give derivatives, and inputs take them")
def slopes(subject: Subject) -> Iterator[Finding]:
    for where, element in _kinds(subject):
        if "CoSimulation" not in where:
            continue
        if not whole(element.get("maxOutputDerivativeOrder", "0")):
            yield note(f"{where}: no output derivatives; masters can only hold or difference the outputs")
        if subject.major == 2 and not flag(element, "canInterpolateInputs"):
            yield note(f"{where}: inputs are held over the step (canInterpolateInputs is false)")


@RULES.rule("ability.asynchronous", "Steps end when doStep returns")
def asynchronous(subject: Subject) -> Iterator[Finding]:
    for where, element in _kinds(subject):
        if flag(element, "canRunAsynchronuously"):
            yield note(f"{where}: canRunAsynchronuously; hardly any master waits for a step that is pending")
