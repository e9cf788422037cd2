"""Rules on variables: attributes that the standard allows, portable names, valid start values and ranges."""

import math
import re
from collections.abc import Iterator, Sequence

from orchestrator.base.text import MODELICA, grouped, words
from orchestrator.check.finding import Finding, error, join_variables, warning
from orchestrator.check.subject import DESCRIPTION, Subject
from orchestrator.fmi.description import INITIAL, INITIAL_3, SIGNED, UNSIGNED, parse_float, parse_int
from orchestrator.fmi.description import FmuVariable as Variable


def variable_duplicate(subject: Subject) -> Iterator[str]:
    """Each variable has a unique name."""
    lines: dict[str, int] = {}
    for v in subject.model.variables:
        for name in v.names:
            if not name:
                yield f"{v}: the name is empty"
            elif name in lines:
                yield f"{v}: expected unique names, {name} is also in line {lines[name]}"
            else:
                lines[name] = v.line


def variable_combination(subject: Subject) -> Iterator[str]:
    """Causality, variability and initial are an allowed combination."""
    legal = INITIAL_3 if subject.major == 3 else INITIAL
    for v in subject.model.variables:
        allowed = legal.get((v.causality, v.variability))
        if allowed is None or (v.causality == "structuralParameter" and subject.major == 2):
            yield f"{v}: causality {v.causality} with variability {v.variability} is not allowed"
        elif "initial" in v.attributes and v.initial not in allowed:
            expected = f"expected {' or '.join(allowed) or 'none'} for a {v.variability} {v.causality}"
            yield f"{v}: initial: {expected}, got {v.initial}"
        elif v.variability == "continuous" and not v.is_real:
            yield f"{v}: variability: expected discrete for a {v.type}, got continuous"


def variable_variability(subject: Subject) -> Iterator[str]:
    """Variables that are not Real declare their variability."""
    for v in subject.model.variables:
        if not v.is_real and "variability" not in v.attributes:
            yield f"{v}: a {v.type} without variability is continuous by default, which no {v.type} may be"


def variable_start(subject: Subject) -> Iterator[str]:
    """Start values exist if and only if they are required."""
    for v in subject.model.variables:
        if v.type == "Clock":
            continue
        settable = v.causality in ("input", "parameter", "structuralParameter")
        if (settable or v.initial in ("exact", "approx")) and v.starts is None:
            reason = v.causality if v.causality in ("input", "parameter") else f"initial {v.initial}"
            yield f"{v}: expected a start value ({reason}), got none"
        elif v.starts is not None and (v.initial == "calculated" or v.causality == "independent"):
            reason = "initial calculated" if v.initial == "calculated" else "the independent variable"
            yield f"{v}: expected no start value ({reason}), got {' '.join(v.starts)[:40]}"


def variable_reference(subject: Subject) -> Iterator[str]:
    """Value references are integers, and unique in FMI 3."""
    variables: dict[int, Variable] = {}
    for v in subject.model.variables:
        if not 0 <= v.reference < 2**32:
            got = v.attributes.get("valueReference")
            yield f"{v}: valueReference: expected an integer from 0 to 2^32 - 1, got {got!r}"
        elif subject.major == 3 and v.reference in variables:
            yield f"{v}: valueReference {v.reference} is also that of {variables[v.reference].name}"
        else:
            variables[v.reference] = v


def variable_alias(subject: Subject) -> Iterator[Finding]:
    """Variables with the same value reference are consistent (FMI 2)."""
    referenced = (v for v in subject.model.variables if v.reference >= 0)
    for aliases in grouped(referenced, _storage).values():
        if len(aliases) > 1:
            yield from _alias(aliases)


def _storage(v: Variable) -> tuple[str, int]:
    """Type and reference of a value; an enumeration is an integer."""
    return "Integer" if v.type == "Enumeration" else v.type, v.reference


def _alias(aliases: list[Variable]) -> Iterator[Finding]:
    first, names = aliases[0], ", ".join(v.name for v in aliases[:4])
    settable = [v for v in aliases if v.causality in ("input", "parameter")]
    if len(settable) > 1:
        text = f"shares valueReference {first.reference} with {settable[0].name}; both can be set"
        yield error(f"{settable[1]}: {text}")
        return
    if len([v for v in aliases if v.starts is not None and v.variability != "constant"]) > 1:
        yield error(f"{first}: {names} share a valueReference, and more than one has a start value")
    if len(units := {v.unit_name for v in aliases}) > 1:
        make = warning if None in units else error  # no conversion goes wrong without a unit
        yield make(f"{first}: {names} share a valueReference, but have different units")
    if len({v.variability == "constant" for v in aliases}) > 1:
        yield error(f"{first}: {names} share a valueReference, but only some are constant")


def variable_independent(subject: Subject) -> Iterator[str]:
    """There is at most one independent variable in FMI 2, exactly one in FMI 3."""
    model = subject.model
    variables = model.of("independent")
    if len(variables) > 1:
        yield f"{variables[1]}: expected one independent variable, got a second one after {variables[0].name}"
    if model.major == 3 and model.variables and not variables:
        yield f"{DESCRIPTION}: expected an independent variable such as time, got no independent variable"
    for v in variables:
        if not v.is_real:
            yield f"{v}: expected a real independent variable, got {v.type}"


def variable_type(subject: Subject) -> Iterator[str]:
    """Declared types exist and have the type of the variable."""
    model = subject.model
    for v in model.variables:
        name = v.attributes.get("declaredType")
        if name is not None and name not in model.types:
            yield f"{v}: declaredType {name!r} is not defined"
        elif name is not None:
            expected = model.types[name].type
            if expected != v.type:
                yield f"{v}: declaredType {name} has the type {expected}, the variable {v.type}"
        elif v.type == "Enumeration":
            yield f"{v}: expected a declaredType, without which an enumeration has no items"


def variable_array(subject: Subject) -> Iterator[str]:
    """Variables are scalars."""
    if arrays := [v for v in subject.model.variables if v.shape]:
        yield f"{arrays[0]} is an array; tools that were made for FMI 2 may not support arrays"


QUOTED = r"'(?:[A-Za-z0-9_!#$%&()*+,\-./:;<>=?@\[\]^{}|~ ]|\\['\"?\\abfnrtv])+'"
PART = rf"(?:[A-Za-z_][A-Za-z0-9_]*|{QUOTED})(?:\[[0-9]+(?:,[0-9]+)*\])?"
PATH = rf"{PART}(?:\.{PART})*"
STRUCTURED = re.compile(rf"{PATH}|der\({PATH}(?:,[0-9]+)?\)")


C = words(
    """auto break case char const continue default do double else enum extern float for goto if inline int
    long register restrict return short signed sizeof static struct switch typedef union unsigned void
    volatile while"""
)
CPP = words(
    """and asm bool catch class delete explicit export false friend mutable namespace new not operator or
    private protected public template this throw true try typename using virtual xor"""
)


def _structured(subject: Subject) -> bool:
    return subject.model.get("variableNamingConvention") == "structured"


def listed(
    subject: Subject,
    say: str,
    of: Sequence[str] = (),
    types: Sequence[str] = (),
    lacks: str = "",
    name: str = "",
    structured: bool | None = None,
) -> Iterator[str]:
    """One finding on all variables of some causalities and types without an attribute, or with such names.

    structured   only if the FMU declares structured names; false: only if it declares flat ones
    """
    chosen = subject.model.of(*of) if of else subject.model.variables
    found = [v for v in chosen if v.name and (not types or v.type in types) and re.search(name, v.name)]
    found = [v for v in found if not (lacks and v.get(lacks).strip())]
    if found and structured in (None, _structured(subject)):
        yield f"{join_variables(found)}: {say.format(type=found[0].type, length=len(found[0].name))}"


def name_grammar(subject: Subject) -> Iterator[str]:
    """Names follow the variableNamingConvention that the FMU declares."""
    named = [(v, name) for v in subject.model.variables for name in v.names]
    for v, name in named:
        if re.search(r"[\r\n\t]", name):
            yield f"{v}: the name {name!r} has a line break or tab"
        elif _structured(subject) and name and not STRUCTURED.fullmatch(name):
            yield f"{v}: the name {name!r} breaks the grammar of variableNamingConvention structured"


def name_mangled(subject: Subject) -> Iterator[str]:
    """Names remain different if a tool replaces all characters except letters and digits."""
    for name, same in grouped(subject.model.variables, lambda v: re.sub(r"\W", "_", v.name)).items():
        if len({v.name for v in same}) > 1:
            yield f"{same[1]}: becomes {name} in some tools, as {same[0].name} does"


def name_keyword(subject: Subject) -> Iterator[str]:
    """No name is a keyword of Modelica or C."""
    for v in subject.model.variables:
        if v.causality == "independent":
            continue
        if languages := [n for n, words in (("Modelica", MODELICA), ("C", C)) if v.name in words]:
            yield f"{v}: is a keyword of {' and '.join(languages)}"


def number(v: Variable, text: str | None) -> float | None:
    """An attribute of a numeric variable; None if it is missing or not a number of the variable's type."""
    if v.is_real:
        return parse_float(text)
    return parse_int(text) if v.type in (*SIGNED, *UNSIGNED, "Enumeration") else None


def _fits(v: Variable, text: str) -> bool:
    """True if a start value is a value of the type."""
    value = number(v, text)
    if v.is_real:
        return value is not None
    if v.type in SIGNED:
        return value is not None and -(2 ** (SIGNED[v.type] - 1)) <= value < 2 ** (SIGNED[v.type] - 1)
    if v.type in UNSIGNED:
        return value is not None and 0 <= value < 2 ** UNSIGNED[v.type]
    if v.type == "Boolean":
        return text in ("true", "false", "1", "0")
    return True


def value_start(subject: Subject) -> Iterator[Finding]:
    """Start values are finite values of their type."""
    for v in subject.model.variables:
        for text in v.starts or ():
            if not _fits(v, text):
                yield error(f"{v}: start value: expected a {v.type}, got {text!r}")
            elif v.is_real and not math.isfinite(parse_float(text) or 0.0):
                yield warning(f"{v}: start value: expected a finite number, got {text}")


def value_range(subject: Subject) -> Iterator[str]:
    """Start values are between min and max, and min is below max."""
    for v in subject.model.variables:
        low, high = number(v, v.attributes.get("min")), number(v, v.attributes.get("max"))
        low, high = -math.inf if low is None else low, math.inf if high is None else high
        if low > high:
            yield f"{v}: min {low:g} is above max {high:g}"
            continue
        for value in (number(v, s) for s in v.starts or ()):
            if value is not None and not low <= value <= high:
                yield f"{v}: start value {value:g} is outside of {low:g} ... {high:g}"


def value_nominal(subject: Subject) -> Iterator[str]:
    """Nominal values are positive, because solvers scale tolerances with them."""
    for v in subject.model.variables:
        value = number(v, v.attributes.get("nominal"))
        if value is not None and not (math.isfinite(value) and value > 0):
            yield f"{v}: nominal: expected a positive number, got {value:g}"


def value_enumeration(subject: Subject) -> Iterator[str]:
    """Items of an enumeration are distinct, and start values are among them."""
    model = subject.model
    items = {name: [value for _, value in declared.items] for name, declared in model.types.items()}
    allowed = {name: set(values) for name, values in items.items()}
    for name, declared in model.types.items():
        if len(allowed[name]) < len(items[name]):
            yield f"modelDescription.xml line {declared.line}: type {name} has two items with the same value"
    for v in model.variables:
        name = v.get("declaredType")
        if v.type != "Enumeration" or name not in model.types:
            continue
        if wrong := [s for s in v.starts or () if s not in allowed[name]]:
            yield f"{v}: start value: expected one of {', '.join(items[name][:8])}, got {wrong[0]}"
