"""ModelStructure: the right unknowns in the right lists, honest dependencies; what the FMU can do."""

from __future__ import annotations

import tomllib
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from orchestrator.check.finding import MAKE, Finding, RuleTable, error, note, some, warning
from orchestrator.check.subject import DESCRIPTION, Subject
from orchestrator.fmi.raw_description import DeclaredVariable, ModelDescription, Unknown

STRUCTURE = RuleTable()
WHERE = "modelDescription.xml: ModelStructure"
UNKNOWN = ("calculated", "approx")  # values of `initial` of what initialisation computes
PLAIN = ("dependent", "constant")
KINDS = (*PLAIN, "fixed", "tunable", "discrete")
LISTS = {
    2: {"outputs": "Outputs", "initial": "InitialUnknowns"},
    3: {"outputs": "Output", "initial": "InitialUnknown"},
}


def _differences(
    model: ModelDescription, section: str, expected: list[DeclaredVariable], why: str
) -> Iterator[Finding]:
    """What is missing in a list, and what does not belong there."""
    listed = dict.fromkeys(u.variable for u in model.structure.get(section, ()) if u.variable)
    name = LISTS[model.major][section]
    missing = [v.name for v in expected if v not in listed]
    right = set(expected)
    extra = [v.name for v in listed if v not in right and v.initial]  # "": another rule tells that
    if missing:
        yield error(f"{WHERE}: {name} lacks {some(missing)}; expected {why}")
    if extra:
        yield error(f"{WHERE}: {name} has {some(extra)}; expected only {why}")


@STRUCTURE.rule(
    "structure.outputs",
    "Outputs lists every output and nothing else",
    "OMSimulator#838 FMUComplianceChecker#27",
)
def outputs(subject: Subject) -> Iterator[Finding]:
    model = subject.model
    if model.major:
        yield from _differences(model, "outputs", list(model.of("output")), "exactly the outputs")


@STRUCTURE.rule(
    "structure.initial",
    "InitialUnknowns lists exactly what initialisation computes",
    "PythonFMU#112 Simulix#28 OpenModelica#15692",
)
def initial(subject: Subject) -> Iterator[Finding]:
    model = subject.model
    if not model.major:
        return
    core = {*model.derivatives, *model.states}
    expected = [
        v
        for v in model.variables
        if v.causality == "calculatedParameter"
        or (v.initial in UNKNOWN and not v.clocked and (v.causality == "output" or v in core))
    ]
    clocked = (u.variable for u in model.structure["initial"] if u.variable and u.variable.clocked)
    chosen = list(clocked) if model.major == 3 else []
    why = "outputs, states and derivatives that are calculated or approx, and calculated parameters"
    yield from _differences(model, "initial", expected + chosen, why)


@STRUCTURE.rule(
    "structure.derivatives", "The listed derivatives are derivatives of states", "FMUComplianceChecker#27"
)
def derivatives(subject: Subject) -> Iterator[Finding]:
    model = subject.model
    for unknown in model.structure.get("derivatives", ()):
        variable = unknown.variable
        if variable is None:
            continue
        key, state = variable.attributes.get("derivative"), model.state_of(variable)
        if key is None:
            yield error(f"{unknown}: the variable has no attribute derivative")
        elif state is None:
            yield error(f"{variable}: derivative={key!r} is no variable")
        elif not (state.is_float and state.variability == "continuous"):
            yield error(f"{variable}: is the derivative of {state.name}, which is not continuous")
        elif state.causality not in ("local", "output"):
            yield error(f"{variable}: its state {state.name} is {state.causality}, expected local or output")


@STRUCTURE.rule("structure.rates", "Only derivatives of states have the attribute derivative in FMI 2.0")
def rates(subject: Subject) -> Iterator[Finding]:
    """The standard allows more; but who counts states by this attribute then counts too many."""
    model = subject.model
    if subject.major != 2 or "ModelExchange" not in model.interfaces:
        return
    listed = {u.variable for u in model.structure.get("derivatives", ())}
    said = [v for v in model.variables if v.get("derivative") and v not in listed]
    said = [v for v in said if v.is_float and v.variability == "continuous"]
    if said:
        yield warning(
            f"{said[0]}: the attribute derivative, but no entry in ModelStructure/Derivatives;"
            f" some tools count a state for each: {some([v.name for v in said])}"
        )


@STRUCTURE.rule(
    "structure.entries", "Entries of ModelStructure name variables, each once, in the order of the standard"
)
def entries(subject: Subject) -> Iterator[Finding]:
    for unknowns in subject.model.structure.values():
        for unknown in unknowns:
            if unknown.variable is None:
                yield error(f"{unknown}: expected a variable, found none with number {unknown.key}")
        for key, count in Counter(u.key for u in unknowns if u.variable).items():
            if count > 1:
                twice = next(u for u in unknowns if u.key == key)
                yield error(f"{twice}: is there {count} times, expected once")
    keys = [u.key for u in subject.model.structure.get("initial", ()) if u.key is not None]
    if subject.major == 2 and keys != sorted(keys) and len(set(keys)) == len(keys):
        yield warning(f"{WHERE}: InitialUnknowns is not ordered by index")


@STRUCTURE.rule(
    "structure.dependencies",
    "Outputs and derivatives say what they depend on; else every input feeds through",
    "FMIKit#21 PyFMI#232",
)
def dependencies(subject: Subject) -> Iterator[Finding]:
    model = subject.model
    inputs = model.of("input")
    for section in ("outputs", "derivatives") if inputs else ():
        silent = [u for u in model.structure.get(section, ()) if u.dependencies is None and u.variable]
        silent = [u for u in silent if u.variable and u.variable.variability != "constant"]
        if silent:
            names = some([u.variable.name for u in silent if u.variable])
            yield warning(
                f"{silent[0]}: no dependencies for {len(silent)} of {len(model.structure[section])} {section}"
                f" ({names}); tools assume direct feed-through from every input"
            )


@STRUCTURE.rule("structure.knowns", "Dependencies name inputs, states and what is known by then")
def knowns(subject: Subject) -> Iterator[Finding]:
    model = subject.model
    states = set(model.states)
    whole_list = len(states) == len(model.structure.get("derivatives", ()))  # else some states are not known
    for section, unknowns in model.structure.items():
        for unknown in unknowns if section in ("outputs", "derivatives", "initial") else ():
            for key in unknown.dependencies or ():
                known = model.by_key.get(-1 if key is None else key)
                if known is None:
                    yield error(f"{unknown}: dependency {key} is no variable")
                elif whole_list and not _known(known, section, states, model.major):
                    say = note if known.causality == "parameter" else warning  # Reference-FMUs list them, too
                    yield say(
                        f"{unknown}: dependency {known.name} is {known.causality}, {known.variability};"
                        " expected an input, a state or what is known by then"
                    )
                if known is None:
                    break


def _known(v: DeclaredVariable, section: str, states: set[DeclaredVariable], major: int) -> bool:
    """True for what the standard calls a known of this list."""
    if v.causality in ("input", "independent"):
        return True
    if section == "initial":
        return v.initial in ("exact", "")
    parameter = v.causality in ("parameter", "structuralParameter")
    return (
        v in states or (parameter and major == 3) or v.clocked or (major == 3 and v.variability == "discrete")
    )


@STRUCTURE.rule("structure.kinds", "dependenciesKind has one allowed word for each dependency")
def kinds(subject: Subject) -> Iterator[Finding]:
    for section, unknowns in subject.model.structure.items():
        for unknown in unknowns:
            yield from _kinds(unknown, section)


def _kinds(unknown: Unknown, section: str) -> Iterator[Finding]:
    if unknown.dependency_kinds is None:
        return
    if unknown.dependencies is None:
        yield error(f"{unknown}: dependenciesKind without dependencies")
        return
    if len(unknown.dependency_kinds) != len(unknown.dependencies):
        yield error(
            f"{unknown}: {len(unknown.dependency_kinds)} dependenciesKind"
            f" for {len(unknown.dependencies)} dependencies"
        )
    allowed = PLAIN if section == "initial" else KINDS
    wrong = [k for k in unknown.dependency_kinds if k in KINDS and k not in allowed]
    if wrong:
        yield error(
            f"{unknown}: dependenciesKind {wrong[0]} is not allowed here, expected {' or '.join(allowed)}"
        )
    special = [k for k in unknown.dependency_kinds if k != "dependent"]
    if special and unknown.variable and not unknown.variable.is_float:
        yield note(  # Reference-FMUs have it, too
            f"{unknown}: dependenciesKind {special[0]} of a {unknown.variable.type}, expected dependent"
        )


CAPABILITIES = RuleTable()


def _abilities(findings: Sequence[Mapping[str, Any]], subject: Subject) -> Iterator[Finding]:
    """What abilities.toml has to say about each interface."""
    for kind, entry in subject.model.interfaces.items():
        for f in findings:
            concerned = f.get("kind", kind) == kind and f.get("fmi", subject.major) == subject.major
            has, lacks = f.get("has", ()), f.get("lacks", ())
            if concerned and (not has or entry.declares(*has)) and not entry.declares(*lacks):
                yield MAKE[f["severity"]](f"{DESCRIPTION} line {entry.line}: {kind}: {f['text']}")


for _id, _entry in tomllib.loads(Path(__file__).with_name("abilities.toml").read_text("utf-8")).items():
    _threads = _entry.get("threads", "").split()
    CAPABILITIES.rule(_id, _entry["holds"], *_threads)(partial(_abilities, _entry["findings"]))
