"""Rules on ModelStructure (lists of unknowns and their dependencies), and on capability flags."""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from orchestrator.check.finding import MAKE, Finding, error, join_names, note, warning
from orchestrator.check.subject import DESCRIPTION, Subject
from orchestrator.fmi.description import FmuVariable, ModelDescription, Unknown

WHERE = "modelDescription.xml: ModelStructure"
CALCULATED = ("calculated", "approx")  # values of `initial` of variables that initialisation computes
INITIAL_KINDS = ("dependent", "constant")  # dependenciesKind in InitialUnknowns
KINDS = (*INITIAL_KINDS, "fixed", "tunable", "discrete")
ELEMENTS = {
    2: {"outputs": "Outputs", "initial": "InitialUnknowns"},
    3: {"outputs": "Output", "initial": "InitialUnknown"},
}


def _differences(
    model: ModelDescription, section: str, expected: list[FmuVariable], why: str
) -> Iterator[Finding]:
    """Variables that are missing in a list, and variables that do not belong there."""
    listed = dict.fromkeys(u.variable for u in model.structure.get(section, ()) if u.variable)
    name = ELEMENTS[model.major][section]
    ignored = {*model.derivatives, *model.states} if _ignores_derivatives(model) else set()
    missing = [v.name for v in expected if v not in listed and (v not in ignored or v.causality == "output")]
    optional = [v.name for v in expected if v not in listed and v.name not in missing]
    allowed = set(expected)
    extra = [v.name for v in listed if v not in allowed and v.initial]  # initial "": variable.combination
    if missing:
        yield error(f"{WHERE}: {name} lacks {join_names(missing)}; expected {why}")
    if optional:
        text = "importers ignore derivatives in co-simulation without directional derivatives"
        yield note(f"{WHERE}: {name} lacks {join_names(optional)}; {text}")
    if extra:
        yield error(f"{WHERE}: {name} has {join_names(extra)}; expected only {why}")


def _ignores_derivatives(model: ModelDescription) -> bool:
    """Only Co-Simulation of FMI 2.0 without directional derivatives (section 2.2.8, Derivatives)."""
    flags = (e.declares("providesDirectionalDerivative") for e in model.interfaces.values())
    return model.major == 2 and list(model.interfaces) == ["CoSimulation"] and not any(flags)


def structure_outputs(subject: Subject) -> Iterator[Finding]:
    """Outputs lists exactly the outputs."""
    outputs = list(subject.model.of("output"))
    yield from _differences(subject.model, "outputs", outputs, "exactly the outputs")


def structure_initial(subject: Subject) -> Iterator[Finding]:
    """InitialUnknowns lists exactly the variables that initialisation computes."""
    model = subject.model
    continuous = {*model.derivatives, *model.states}
    expected = [
        v
        for v in model.variables
        if v.causality == "calculatedParameter"
        or (v.initial in CALCULATED and not v.clocked and (v.causality == "output" or v in continuous))
    ]
    clocked = (u.variable for u in model.structure.get("initial", ()) if u.variable and u.variable.clocked)
    optional = list(clocked) if model.major == 3 else []
    why = "outputs, states and derivatives that are calculated or approx, and calculated parameters"
    yield from _differences(model, "initial", expected + optional, why)


def structure_derivatives(subject: Subject) -> Iterator[Finding]:
    """The listed derivatives are derivatives of states, others of variables that exist."""
    model = subject.model
    finding = note if _ignores_derivatives(model) else error
    for v in model.variables:
        if (key := v.attributes.get("derivative")) is not None and model.state_of(v) is None:
            yield finding(f"{v}: derivative={key!r} is not a variable")
    for unknown in model.structure.get("derivatives", ()):
        variable = unknown.variable
        if variable is None:
            continue
        key, state = variable.attributes.get("derivative"), model.state_of(variable)
        if key is None:
            yield finding(f"{unknown}: the variable has no attribute derivative")
        elif state and not state.is_continuous:
            yield finding(f"{variable}: is the derivative of {state.name}, which is not continuous")
        elif state and state.causality not in ("local", "output"):
            text = f"its state {state.name} is {state.causality}, expected local or output"
            yield finding(f"{variable}: {text}")


def structure_rates(subject: Subject) -> Iterator[str]:
    """Only derivatives of states have the attribute derivative in FMI 2.0.

    The standard allows others, but tools that count states by this attribute then count too many.
    """
    model = subject.model
    if "ModelExchange" not in model.interfaces:
        return
    listed = {u.variable for u in model.structure.get("derivatives", ())}
    unlisted = [v for v in model.variables if v.get("derivative") and v not in listed]
    if unlisted := [v for v in unlisted if v.is_continuous]:
        yield (
            f"{unlisted[0]}: has the attribute derivative, but no entry in ModelStructure/Derivatives;"
            f" some tools count a state for each: {join_names([v.name for v in unlisted])}"
        )


def structure_entries(subject: Subject) -> Iterator[Finding]:
    """Entries of ModelStructure refer to variables, each once, in the order of the standard."""
    for unknowns in subject.model.structure.values():
        for unknown in unknowns:
            if unknown.variable is None:
                yield error(f"{unknown}: expected a variable, got none with index or reference {unknown.key}")
        for key, count in Counter(u.key for u in unknowns if u.variable).items():
            if count > 1:
                first = next(u for u in unknowns if u.key == key)
                yield error(f"{first}: expected one entry, got {count}")
    keys = [u.key for u in subject.model.structure.get("initial", ()) if u.key is not None]
    if subject.major == 2 and keys != sorted(keys) and len(set(keys)) == len(keys):
        yield warning(f"{WHERE}: InitialUnknowns is not ordered by index")


def structure_dependencies(subject: Subject) -> Iterator[str]:
    """Outputs and derivatives declare their dependencies; without them every input feeds through."""
    model = subject.model
    inputs = model.of("input")
    for section in ("outputs", "derivatives") if inputs else ():
        undeclared = [u for u in model.structure.get(section, ()) if u.dependencies is None and u.variable]
        if undeclared := [u for u in undeclared if u.variable and u.variable.variability != "constant"]:
            names = join_names([u.variable.name for u in undeclared if u.variable])
            count = f"{len(undeclared)} of {len(model.structure.get(section, ()))} {section}"
            yield (
                f"{undeclared[0]}: no dependencies for {count} ({names});"
                " tools assume direct feed-through from every input"
            )


def structure_knowns(subject: Subject) -> Iterator[Finding]:
    """Dependencies are knowns of their list, such as inputs and states."""
    model = subject.model
    states = set(model.states)
    complete = len(states) == len(model.structure.get("derivatives", ()))  # else some states are missing
    for section, unknowns in model.structure.items():
        for unknown in unknowns if section in ("outputs", "derivatives", "initial") else ():
            for key in unknown.dependencies or ():
                known = model.by_key.get(-1 if key is None else key)
                if known is None:
                    yield error(f"{unknown}: dependency {key} is not a variable")
                    break
                if complete and not _is_known(known, section, states, model.major):
                    # a note for parameters, because the Reference-FMUs list them, too
                    make = note if known.causality == "parameter" else warning
                    yield make(
                        f"{unknown}: dependency {known.name} is {known.causality}, {known.variability};"
                        " expected an input, a state or another known"
                    )


def _is_known(v: FmuVariable, section: str, states: set[FmuVariable], major: int) -> bool:
    """True for a known of this list as defined by the standard."""
    if v.causality in ("input", "independent"):
        return True
    if section == "initial":
        return v.initial in ("exact", "")
    parameter = v.causality in ("parameter", "structuralParameter")
    return (
        v in states or (parameter and major == 3) or v.clocked or (major == 3 and v.variability == "discrete")
    )


def structure_kinds(subject: Subject) -> Iterator[Finding]:
    """dependenciesKind has one allowed value for each dependency."""
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
            f"{unknown}: expected {len(unknown.dependencies)} dependenciesKind as there are dependencies,"
            f" got {len(unknown.dependency_kinds)}"
        )
    allowed = INITIAL_KINDS if section == "initial" else KINDS
    if wrong := [k for k in unknown.dependency_kinds if k in KINDS and k not in allowed]:
        yield error(f"{unknown}: dependenciesKind: expected {' or '.join(allowed)}, got {wrong[0]}")
    special = [k for k in unknown.dependency_kinds if k != "dependent"]
    if special and unknown.variable and not unknown.variable.is_real:
        # a note, because the Reference-FMUs have it, too
        text = f"expected dependent for a {unknown.variable.type}, got {special[0]}"
        yield note(f"{unknown}: dependenciesKind: {text}")


def ability(subject: Subject, findings: Sequence[Mapping[str, Any]]) -> Iterator[Finding]:
    """Those of the findings that apply to an interface and its capability flags, see rules.toml."""
    for kind, entry in subject.model.interfaces.items():
        for f in findings:
            applies = f.get("kind", kind) == kind and f.get("fmi", subject.major) == subject.major
            has, lacks = f.get("has", ()), f.get("lacks", ())
            if applies and (not has or entry.declares(*has)) and not entry.declares(*lacks):
                yield MAKE[f["severity"]](f"{DESCRIPTION} line {entry.line}: {kind}: {f['text']}")
