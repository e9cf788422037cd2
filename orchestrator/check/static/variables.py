"""Variables: unique, of a legal kind, with a start value where one is needed."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator

from orchestrator.check.finding import Finding, error, note, warning
from orchestrator.check.model import Variable, listed
from orchestrator.check.registry import Table
from orchestrator.check.subject import Subject

RULES = Table()
CALCULATED, FREE = ("calculated", "approx"), ("calculated", "exact", "approx")
LEGAL = {  # (causality, variability) -> what `initial` may be, in FMI 2; () means: must not be given
    ("parameter", "fixed"): ("exact",),
    ("parameter", "tunable"): ("exact",),
    ("calculatedParameter", "fixed"): CALCULATED,
    ("calculatedParameter", "tunable"): CALCULATED,
    ("input", "discrete"): (),
    ("input", "continuous"): (),
    ("output", "constant"): ("exact",),
    ("output", "discrete"): FREE,
    ("output", "continuous"): FREE,
    ("local", "constant"): ("exact",),
    ("local", "fixed"): CALCULATED,
    ("local", "tunable"): CALCULATED,
    ("local", "discrete"): FREE,
    ("local", "continuous"): FREE,
    ("independent", "continuous"): (),
}
LEGAL_3 = LEGAL | {
    ("input", "discrete"): ("exact",),
    ("input", "continuous"): ("exact",),
    ("structuralParameter", "fixed"): ("exact",),
    ("structuralParameter", "tunable"): ("exact",),
}


@RULES.rule("variable.duplicate", "Each variable has a name, and no other has the same", "Simulix#28")
def duplicate(subject: Subject) -> Iterator[Finding]:
    seen: dict[str, int] = {}
    for v in subject.model.variables:
        for name in (v.name, *v.aliases):
            if not name:
                yield error(f"{v}: the name is empty")
            elif name in seen:
                yield error(f"{v}: the name {name} is also in line {seen[name]}, expected unique names")
            else:
                seen[name] = v.line


@RULES.rule(
    "variable.combination",
    "Causality, variability and initial fit together by the table of the standard",
    "FMPy#189 FMPy#108 FMPy#579",
)
def combination(subject: Subject) -> Iterator[Finding]:
    legal = LEGAL_3 if subject.major == 3 else LEGAL
    for v in subject.model.variables:
        allowed = legal.get((v.causality, v.variability))
        if allowed is None:
            yield error(f"{v}: causality {v.causality} with variability {v.variability} is not allowed")
        elif v.said.get("initial") and v.initial not in allowed:
            expected = f"expected {' or '.join(allowed)}" if allowed else "expected none"
            yield error(f"{v}: initial {v.initial} of a {v.variability} {v.causality}, {expected}")
        elif v.variability == "continuous" and not v.is_float:
            yield error(f"{v}: a {v.type} cannot be continuous, expected discrete")


@RULES.rule("variable.variability", "Variables that are not Real say their variability")
def variability(subject: Subject) -> Iterator[Finding]:
    if subject.major != 2:
        return
    for v in subject.model.variables:
        if not v.is_float and not v.declared_variability:
            yield warning(
                f"{v}: a {v.type} without variability is continuous by default, which no {v.type} may be"
            )


@RULES.rule("variable.start", "Start values are there where needed, and only there", "FMIKit#151")
def start(subject: Subject) -> Iterator[Finding]:
    for v in subject.model.variables:
        if v.type == "Clock":
            continue
        needed = v.initial in ("exact", "approx") or v.causality in (
            "input",
            "parameter",
            "structuralParameter",
        )
        if needed and v.starts is None:
            why = v.causality if v.causality in ("input", "parameter") else f"initial {v.initial}"
            yield error(f"{v}: has no start value, expected one ({why})")
        elif v.starts is not None and (v.initial == "calculated" or v.causality == "independent"):
            why = "initial calculated" if v.initial == "calculated" else "the independent variable"
            yield error(f"{v}: has the start value {' '.join(v.starts)[:40]}, expected none ({why})")


@RULES.rule("variable.reference", "Value references are whole numbers; in FMI 3 each is there once")
def reference(subject: Subject) -> Iterator[Finding]:
    seen: dict[int, Variable] = {}
    for v in subject.model.variables:
        if v.reference is None or not 0 <= v.reference < 2**32:
            yield error(
                f"{v}: valueReference {v.said.get('valueReference')!r}, expected a whole number below 2^32"
            )
        elif subject.major == 3 and v.reference in seen:
            yield error(f"{v}: valueReference {v.reference} is also that of {seen[v.reference].name}")
        else:
            seen[v.reference] = v


@RULES.rule("variable.alias", "Variables that share a value reference agree (FMI 2)")
def alias(subject: Subject) -> Iterator[Finding]:
    if subject.major != 2:
        return
    sets: dict[tuple[str, int], list[Variable]] = defaultdict(list)
    for v in subject.model.variables:
        if v.reference is not None:
            sets[_base(v.type), v.reference].append(v)
    for same in (s for s in sets.values() if len(s) > 1):
        yield from _alias(same)


def _base(type_: str) -> str:
    return "Integer" if type_ == "Enumeration" else type_


def _alias(same: list[Variable]) -> Iterator[Finding]:
    first, names = same[0], ", ".join(v.name for v in same[:4])
    settable = [v for v in same if v.causality in ("input", "parameter")]
    if len(settable) > 1:
        yield error(
            f"{settable[1]}: shares valueReference {first.reference} with {settable[0].name}; both can be set"
        )
        return
    if len([v for v in same if v.starts is not None and v.variability != "constant"]) > 1:
        yield error(f"{first}: {names} share a valueReference, and more than one has a start value")
    if len({v.unit for v in same}) > 1:
        yield error(f"{first}: {names} share a valueReference, but not the unit")
    if len({v.variability == "constant" for v in same}) > 1:
        yield error(f"{first}: {names} share a valueReference, but only some are constant")


@RULES.rule(
    "variable.independent",
    "There is one independent variable: at most in FMI 2, exactly in FMI 3",
    "casadi#4030",
)
def independent(subject: Subject) -> Iterator[Finding]:
    model = subject.model
    found = model.of("independent")
    if len(found) > 1:
        yield error(f"{found[1]}: is a second independent variable beside {found[0].name}, expected one")
    if model.major == 3 and model.variables and not found:
        yield error("modelDescription.xml: no independent variable, expected one such as time")
    for v in found:
        if not v.is_float:
            yield error(f"{v}: the independent variable is {v.type}, expected a real number")


@RULES.rule("variable.type", "Declared types exist and have the type of the variable")
def type_(subject: Subject) -> Iterator[Finding]:
    model = subject.model
    for v in model.variables:
        name = v.said.get("declaredType")
        if name is not None and name not in model.types:
            yield error(f"{v}: declaredType {name!r} is not defined")
        elif name is not None:
            tag = str(model.types[name].tag).rpartition("}")[2].removesuffix("Type")
            if tag != v.type:
                yield error(f"{v}: declaredType {name} is for {tag}, the variable is {v.type}")
        elif v.type == "Enumeration":
            yield error(f"{v}: an enumeration without declaredType has no items")


@RULES.rule("variable.string", "Inputs and outputs are numbers", "FMPy#696")
def string(subject: Subject) -> Iterator[Finding]:
    odd = [v for v in subject.model.of("input", "output") if v.type in ("String", "Binary", "Clock")]
    if odd:
        yield note(f"{listed(odd)}: {odd[0].type}; many tools cannot connect them")


@RULES.rule("variable.array", "Variables are scalars")
def array(subject: Subject) -> Iterator[Finding]:
    root = subject.root
    if subject.major == 3 and root is not None:
        arrays = [e.getparent() for e in root.iter("Dimension")]
        if arrays:
            yield note(
                f"modelDescription.xml line {arrays[0].sourceline}: {arrays[0].get('name')} is an array;"
                " tools that grew up with FMI 2 may not take arrays"
            )


@RULES.rule("variable.text", "Inputs, outputs and parameters have a description")
def text(subject: Subject) -> Iterator[Finding]:
    silent = [
        v
        for v in subject.model.of("input", "output", "parameter")
        if not v.said.get("description", "").strip()
    ]
    if silent:
        yield note(f"{listed(silent)}: no description")
