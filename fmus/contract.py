"""Declaration of a subsystem, from which its FMU, documentation and identification are derived.

A subsystem is data and two pure functions,

    dx/dt = dynamics(x, u, p)        y = observe(x, u, p)

of four groups of scalars (`Group`): states x, inputs u, parameters p and outputs y.
Each field of a group is a scalar with a `Quantity` (unit, description, nominal value).
A name that is both in the states and in the outputs is one variable.
"""

from __future__ import annotations

import math
import os
import traceback
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, fields, is_dataclass, replace
from numbers import Real
from pathlib import Path
from types import FunctionType, MappingProxyType
from typing import TYPE_CHECKING, Any, Literal, TypeAlias, TypeVar, dataclass_transform, get_type_hints

import casadi as ca

from orchestrator.base.errors import Problem
from orchestrator.base.units import normalised, parse_unit

Scalar: TypeAlias = Any  # float | ca.SX; the operators in CasADi's annotations do not accept symbols
G = TypeVar("G")


ModelError = Problem  # old name, kept for compatibility


@dataclass(frozen=True)
class Quantity:
    """Declaration of one scalar.

    unit, text   SI unit and description in one line
    nominal      typical magnitude in that unit, for scaling and error control
    absolute     states only: absolute tolerance divided by relative tolerance; default: nominal
    minimum, maximum   bounds that an importer and the FMU check
    tunable      parameters only: may be changed while the simulation runs
    rate         inputs only: name of the input with the exact time derivative of this input
    optional     inputs only: what it means for a system if nothing feeds this input, which then keeps its
                 start value; other FMUs in a system may lack the signal
    warn_above   inputs and outputs: |value| above which the FMU logs a warning, once per excursion
    warn_below   inputs and outputs: value below which it logs a warning likewise
    meaning      inputs and outputs: what a value beyond its limit means, as the begin of the warning, such as
                 "cavitation in the {}"; after ": " may follow what it leads to, as its end
    below        inputs and outputs: the same of a value below `warn_below`; default: meaning
    group        parameters only: heading in documentation; default: heading of the previous parameter
    held         inputs only: constant within a communication step. What depends on held inputs and parameters
                 alone is computed when one of them changes
    noisy        outputs only: jumps by noise or a resolution, which no shorter communication step resolves
    warmed       parameters only: exponents of the ratios of viscosity, density and bulk modulus in the factor
                 by which a temperature of the oil changes the value (`components.oil`)
    value        parameter or start value, for a subsystem without parameters.toml
    listed       parameters only, with a name such as point_3: description of the list points in
                 parameters.toml, of which this is an entry
    """

    unit: str
    text: str
    nominal: float = 1.0
    minimum: float | None = None
    maximum: float | None = None
    tunable: bool = False
    rate: str | None = None
    warn_above: float | None = None
    warn_below: float | None = None
    group: str = ""
    absolute: float | None = None
    value: float | None = None
    listed: str = ""
    optional: str = ""
    meaning: str = ""
    below: str = ""
    held: bool = False
    noisy: bool = False
    warmed: tuple[float, float, float] | None = None

    def __post_init__(self) -> None:
        for name in ("unit", "text", "group", "listed", "optional", "meaning", "below"):
            if not isinstance(getattr(self, name), str):
                raise Problem(f"Quantity: {name}: expected text, found {getattr(self, name)!r}")
        for name in ("nominal", "minimum", "maximum", "warn_above", "warn_below", "absolute", "value"):
            number = getattr(self, name)
            if number is not None and not isinstance(number, Real):
                raise Problem(f"Quantity: {name} of {self.text!r}: expected a number, found {number!r}")
        parse_unit(self.unit, f"Quantity: {self.text}")
        if normalised(self.unit) != self.unit:  # other tools read only this spelling
            raise Problem(
                f'Quantity: {self.text}: expected the unit "{normalised(self.unit)}", found "{self.unit}"'
            )

    @property
    def watched(self) -> bool:
        """Whether the FMU warns of values beyond a limit."""
        return self.warn_above is not None or self.warn_below is not None

    @property
    def absolute_scale(self) -> float:
        """Absolute tolerance of the error control, divided by its relative tolerance."""
        return self.nominal if self.absolute is None else self.absolute

    def of(self, owner: str, named: Callable[[str], str]) -> Quantity:
        """The quantity with `owner` for "{}" in text and heading, and the other name of its rate."""
        heading = self.group.replace("{}", owner)
        return replace(
            self,
            text=self.text.replace("{}", owner),
            listed=self.listed.replace("{}", owner),
            optional=self.optional.replace("{}", owner),
            meaning=self.meaning.replace("{}", owner),
            below=self.below.replace("{}", owner),
            group=heading[:1].upper() + heading[1:],
            rate=self.rate and named(self.rate),
        )


_Declared: TypeAlias = "type[Group] | tuple[Any, ...]"  # a group within a group, see `Group`


@dataclass_transform(frozen_default=True, kw_only_default=True, field_specifiers=(Quantity,))
class Group:
    """Base class of a group of scalars, such as the states of a subsystem; each field is a `Quantity`.

        class State(Group):
            pressure: Scalar = Quantity("Pa", "Pressure of the chamber", 1e7)

    A group is a frozen dataclass with keyword arguments. It inherits the fields of its base groups.
    Groups contain groups, before the fields of the class itself:

        class Parameters(Group, boom=Cylinder, stick=Cylinder):      p.boom is a Cylinder: p.boom.bore

    A variable of the FMU has the names on the way to it, joined by "_": boom_bore. "{}" in the texts of
    `Cylinder` is replaced by the name of the field, or by "lift" for `boom=(Cylinder, "lift")`. A third item
    gives other names: `boom=(Cylinder, "boom", str)` has nothing in front. `flat` and `nested` convert.
    """

    if TYPE_CHECKING:

        def __getattr__(self, name: str) -> Any: ...

    def __init_subclass__(cls, /, **parts: _Declared) -> None:
        declared: dict[str, Any] = {}
        for name, part in parts.items():
            if isinstance(getattr(cls, name, None), property | FunctionType):
                raise Problem(f"{cls.__name__}: {name} is a name in its base already, expected another one")
            of = part if isinstance(part, tuple) else (part, name)
            declared[name] = field(metadata={"part": _Part(*of, name=name)})
        for name, q in vars(cls).items():
            if isinstance(q, Quantity):
                default: dict[str, Any] = {} if q.value is None else {"default": q.value}
                declared[name] = field(**default, metadata={"quantity": q})
        cls.__annotations__ = dict.fromkeys(declared, "Scalar")
        for name, made in declared.items():
            setattr(cls, name, made)
        dataclass(frozen=True, kw_only=True)(cls)

    @classmethod
    def of(cls: type[G], values: Any) -> G:
        """The group with the values of its fields in another one, which has more."""
        return cls(**{f.name: getattr(values, f.name) for f in fields(cls)})  # type: ignore[arg-type]


class _Part:
    """A group within a group: what replaces "{}" in its texts, and the names of its variables outside."""

    def __init__(
        self, group: type[Group], owner: str, named: Callable[[str], str] | None = None, *, name: str
    ) -> None:
        self.group, self.owner, self.named = group, owner, named or f"{name}_{{}}".format


def flat(values: Any) -> dict[str, Scalar]:
    """The variables of a group by name."""
    found: dict[str, Scalar] = {}
    for name, part in _parts(type(values)).items():
        value = getattr(values, name)
        found |= {part.named(n): v for n, v in flat(value).items()} if part else {name: value}
    return found


def nested(group: type[G], values: Mapping[str, Scalar]) -> G:
    """A group from its variables by name, the inverse of `flat`; `values` may contain others."""
    made: dict[str, Any] = {}
    for name, part in _parts(group).items():
        if part is None:
            made[name] = values[name]
        else:
            made[name] = nested(part.group, {n: values[part.named(n)] for n in quantities(part.group)})
    return group(**made)


_PARTS: dict[type[Any], dict[str, _Part | None]] = {}  # `nested` is called in each step of a user's model


def _parts(group: type[Any]) -> dict[str, _Part | None]:
    """The fields of a group, each with the group that it is; None: a scalar."""
    if group not in _PARTS:
        _PARTS[group] = {f.name: f.metadata.get("part") for f in fields(group)}
    return _PARTS[group]


def make_group(
    name: str, members: Mapping[str, Quantity], /, *bases: type[Group], **parts: _Declared
) -> type[Any]:
    """A group class with the members of its bases, followed by its groups and these."""
    return type(name, bases or (Group,), {"__module__": __name__, **members}, **parts)


@dataclass(frozen=True)
class Member:
    """One variable of a terminal.

    name   member name, equal on both sides of a connection
    flow   "in" or "out" for a flow variable (force, torque, volume flow), positive into or out of the
           subsystem; empty for all others
    """

    name: str
    variable: str
    flow: Literal["in", "out", ""] = ""


@dataclass(frozen=True)
class Terminal:
    """A port: variables that are connected together to a terminal of the same kind of another subsystem."""

    name: str
    kind: str
    text: str
    members: tuple[Member, ...]


def _none(*_: Any) -> dict[str, Scalar]:
    return {}


def no_event(*_: Any) -> Scalar:
    """The `next_event` of a subsystem without time events."""
    return math.inf


@dataclass(frozen=True)
class Subsystem:
    """A model that can be exported as an FMU.

    name       model identifier and file name of the FMU
    values     parameters.toml with parameter and start values; the FMU also contains what other files in its
               folder describe (see `folder`). Without a file the `value`s of the quantities are used
    initial    (x, u, p) -> {state: value}: states calculated at initialisation, also from the start values x
               of other states; the other states start at their start value
    require    (x, u, p) -> {statement: expression}: requirements, fulfilled if the expression is positive.
               The FMU reports an error if one is violated at the start or after a step
    derive     (p) -> {parameter: value}: derived parameters; a value applies if the parameter is 0
    next_event (x, u, p) -> seconds to the next time event, a known instant at which a rate jumps; infinite
               without one. In Model Exchange no solver steps over it
    terminals  ports
    circuits   (x, u, p) -> {name: `fmus.components.circuit.Circuit`}: linear graphs of the part
    numbers    content of a parameters.toml (`parameters.read`), for a subsystem that has no such file
    step       longest communication step [s] at which its ports are exchanged without an error that matters:
               the FMU suggests no longer one
    stiff      whether modes are much faster than the motion; if not, an explicit method is tried first
    sampling   of an algorithm of a control unit: interval [s] at which co-simulation advances its states, by
               Euler's method with the inputs of that instant; 0: its states are integrated
    part, variant   component of a system, and the name of this variant of it (`family`)
    validity   range of validity, in one line
    names_of_variants   names in parameters.toml that only other variants of the part declare
    connections   of a part of a known system, for its page: port, FMUs to connect to it (FMU.PORT if the
                  names differ), its rate port or nothing
    notes      what to know about these connections, in sentences
    model      object whose methods the functions are, for what is made from the same equations
    """

    name: str
    text: str
    parameters: type[Any]
    states: type[Any]
    inputs: type[Any]
    outputs: type[Any]
    dynamics: Callable[[Any, Any, Any], Any]
    observe: Callable[[Any, Any, Any], Any]
    values: Path | None = None
    initial: Callable[[Any, Any, Any], Mapping[str, Scalar]] = _none
    require: Callable[[Any, Any, Any], Mapping[str, Scalar]] = _none
    derive: Callable[[Any], Mapping[str, Scalar]] = _none
    next_event: Callable[[Any, Any, Any], Scalar] = no_event
    numbers: Mapping[str, Mapping[str, Any]] | None = None
    terminals: tuple[Terminal, ...] = ()
    circuits: Callable[[Any, Any, Any], Mapping[str, Any]] = _none
    step: float = math.inf
    stiff: bool = True
    sampling: float = 0.0
    part: str = ""
    variant: str = ""
    validity: str = ""
    names_of_variants: frozenset[str] = frozenset()
    connections: tuple[tuple[str, tuple[str, ...], str], ...] = ()
    notes: tuple[str, ...] = ()
    model: Any = None

    def __repr__(self) -> str:
        return f"Subsystem({self.name!r}: {self.text})"

    @property
    def folder(self) -> Path:
        """Folder of README.md, icon.png, view.toml and the reference experiment, as far as they exist."""
        return Path(os.devnull) if self.values is None else self.values.parent

    @property
    def component(self) -> str:
        """Name of the component in a system."""
        return self.part or self.name


def family(part: str, **variants: Subsystem) -> dict[str, Subsystem]:
    """Variants of one part by name, the default variant first, with their FMU names.

    The default variant has the name of the part, another one is `part_variant`. All variants have the same
    inputs, and at least the outputs of the default variant, so they are interchangeable in a system.
    """
    names = {  # that parameters.toml may contain
        v: frozenset(n for g in (sub.parameters, sub.inputs, sub.states) for n in quantities(g))
        for v, sub in variants.items()
    }
    default = next(iter(variants.values()))
    for sub in variants.values():
        for group in ("inputs", "outputs"):
            declared, expected = quantities(getattr(sub, group)), quantities(getattr(default, group))
            differ = [n for n, q in expected.items() if declared.get(n) != q]
            differ += [n for n in declared if n not in expected and group == "inputs"]
            if differ:
                raise Problem(f"{sub.name}: {group} differ from those of {default.name}: {', '.join(differ)}")
    return {
        v: replace(
            sub,
            name=part if sub is default else f"{part}_{v}",
            part=part,
            variant=v,
            names_of_variants=frozenset().union(*names.values()) - names[v],
        )
        for v, sub in variants.items()
    }


_CACHE: dict[type[Any], MappingProxyType[str, Quantity]] = {}  # type hints are slow to resolve


def quantities(group: type[Any]) -> MappingProxyType[str, Quantity]:
    """Quantities of a group in the order of its fields, each with its heading.

    The group may also be a dataclass whose fields are `Annotated[float, Quantity(...)]`.
    """
    if not (isinstance(group, type) and is_dataclass(group)):
        raise Problem(f"expected a subclass of Group, or a dataclass of quantities, found {group!r}")
    if group in _CACHE:
        return _CACHE[group]
    declared: dict[str, Quantity] = {}
    if issubclass(group, Group):
        for f in fields(group):
            if part := _parts(group)[f.name]:
                inner = quantities(part.group).items()
                found = {part.named(n): q.of(part.owner, part.named) for n, q in inner}
            else:
                found = {f.name: f.metadata["quantity"]}
            if double := declared.keys() & found.keys():
                raise Problem(f"{group.__name__}: {min(double)} is declared twice, expected different names")
            declared |= found
    else:
        hints = get_type_hints(group, include_extras=True)
        declared = {f.name: hints[f.name].__metadata__[0] for f in fields(group)}
    heading = ""
    for name, quantity in declared.items():
        if not isinstance(quantity, Quantity):
            expected = 'Annotated[float, Quantity("unit", "text")]'
            raise Problem(f"{group.__name__}.{name}: expected {expected}, found {quantity!r}")
        heading = quantity.group or heading
        if quantity.group != heading:
            declared[name] = replace(quantity, group=heading)
    return _CACHE.setdefault(group, MappingProxyType(declared))


def symbols(group: type[G]) -> G:
    """A group of new scalar symbols, named like its fields."""
    return nested(group, {name: ca.SX.sym(name) for name in quantities(group)})


def unknown(group: type[G]) -> G:
    """A group of numbers that are not known, for what does not depend on them."""
    return nested(group, dict.fromkeys(quantities(group), math.nan))


def column(*values: Scalar) -> Any:
    """Scalars and columns stacked vertically, shape (n, 1), also none of them."""
    return ca.vertcat(*values) if values else ca.SX(0, 1)


def stack(values: Any) -> Any:
    """The variables of a group as one column, shape (n, 1), in order."""
    return column(*flat(values).values())


def unstack(group: type[G], values: Any) -> G:
    """A group from a column, the inverse of `stack`; also for NumPy arrays of shape (n,)."""
    return nested(group, {name: values[i] for i, name in enumerate(quantities(group))})


@dataclass(frozen=True)
class Symbolic:
    """A subsystem as symbols x, u, p (columns) and expressions in them.

    start        initial states from the start values (the symbols x), u and p
    calculated   names of the states that `initial` calculates
    require      expressions that must be positive
    statements   text of each requirement
    """

    x: ca.SX
    u: ca.SX
    p: ca.SX
    dx: ca.SX
    y: ca.SX
    start: ca.SX
    calculated: tuple[str, ...]
    require: ca.SX
    statements: tuple[str, ...]
    next_event: ca.SX

    def function(self, name: str = "model") -> ca.Function:
        """(x, u, p) -> (dx, y)."""
        return ca.Function(name, [self.x, self.u, self.p], [self.dx, self.y], ["x", "u", "p"], ["dx", "y"])

    def initial(self) -> ca.Function:
        """(start values x, u, p) -> initial x."""
        return ca.Function("initial", [self.x, self.u, self.p], [self.start])


def symbolic(sub: Subsystem) -> Symbolic:
    """Evaluate the subsystem's functions once on symbols."""
    for group in (sub.states, sub.inputs, sub.parameters, sub.outputs):
        quantities(group)  # refuses what is no group
    x, u, declared = symbols(sub.states), symbols(sub.inputs), symbols(sub.parameters)
    p = with_derived(sub, declared)
    calculated = _call(sub, "initial", x, u, p)
    unknown = set(calculated) - set(quantities(sub.states))
    if unknown:
        raise _wrong_result(sub, "initial", "names of states", str(sorted(unknown)))
    settable = flat(x)
    states = column(*(settable[name] for name in calculated))
    if ca.depends_on(ca.SX(column(*calculated.values())), states):
        raise Problem(
            f"{sub.name}: initial() reads a state that it computes itself, expected only other states"
        )
    start = [calculated.get(name, value) for name, value in settable.items()]
    require = _call(sub, "require", x, u, p)
    return Symbolic(
        x=stack(x),
        u=stack(u),
        p=stack(declared),
        dx=_evaluate(sub, "dynamics", sub.states, x, u, p),
        y=_evaluate(sub, "observe", sub.outputs, x, u, p),
        start=column(*start),
        calculated=tuple(calculated),
        require=column(*require.values()),
        statements=tuple(require),
        next_event=ca.SX(sub.next_event(x, u, p)),
    )


def with_derived(sub: Subsystem, p: Any) -> Any:
    """The parameters, those that are 0 derived from the others."""
    given = flat(p)
    derived = _call(sub, "derive", p).items()
    return nested(sub.parameters, given | {n: ca.if_else(given[n] > 0, given[n], v) for n, v in derived})


def _call(sub: Subsystem, function: str, *groups: Any) -> Any:
    """Call one of the functions of a subsystem; an exception becomes a Problem with file and line."""
    try:
        result = getattr(sub, function)(*groups)
    except Problem:
        raise
    except Exception as error:  # whatever a user's code raises
        text = f"{type(error).__name__}: {' '.join(str(error).split())}"
        raise Problem(f"{_place(sub, function, error)}{sub.name}: {function}(): {text}") from error
    if function in ("derive", "initial", "require"):
        if not isinstance(result, Mapping):
            raise _wrong_result(sub, function, "a dictionary", result)
        known = _symbols(groups) if result else frozenset()
        for name, value in result.items():
            _scalar(sub, function, name, value, known)
    return result


def _evaluate(sub: Subsystem, function: str, group: type[Any], *groups: Any) -> Any:
    """The result of `dynamics` or `observe` as a column, checked against its group."""
    result = _call(sub, function, *groups)
    if not is_dataclass(result) or list(found := flat(result)) != list(quantities(group)):
        raise _wrong_result(sub, function, group.__name__, result)
    known = _symbols(groups)
    return column(*(_scalar(sub, function, name, value, known) for name, value in found.items()))


def _symbols(groups: Sequence[Any]) -> frozenset[int]:
    """The symbols in some groups, by their hash."""
    return frozenset(s.element_hash() for g in groups for s in ca.symvar(stack(g)))


def _scalar(sub: Subsystem, function: str, name: str, value: Scalar, known: Collection[int]) -> ca.SX:
    """An expression of the known symbols, those of x, u and p; raises Problem for anything else."""
    try:
        expression = ca.SX(value)
    except (NotImplementedError, TypeError):  # CasADi's answers to a wrong type
        raise _wrong_result(sub, function, f"{name} as one expression", value) from None
    if expression.shape != (1, 1):
        raise _wrong_result(sub, function, f"{name} as one expression", f"shape {expression.shape}")
    if free := [s.name() for s in ca.symvar(expression) if s.element_hash() not in known]:
        raise _wrong_result(sub, function, f"{name} in terms of x, u and p", f"the symbol {free[0]}")
    return expression


def _wrong_result(sub: Subsystem, function: str, expected: str, found: object) -> Problem:
    shown = found if isinstance(found, str) else f"{type(found).__name__} {found!r}"
    shown = " ".join(shown.split())[:80]
    return Problem(f"{_place(sub, function)}{sub.name}: {function}(): expected {expected}, found {shown}")


def _place(sub: Subsystem, function: str, error: Exception | None = None) -> str:
    """ "file.py:12: ", the innermost line of an error in the file of a function, else where it begins."""
    code = getattr(getattr(sub, function), "__code__", None)
    if code is None:
        return ""
    begin = f"{Path(code.co_filename).name}:{code.co_firstlineno}: "
    return (place(error, lambda file: file == code.co_filename) if error else "") or begin


def place(problem: BaseException, is_meant: Callable[[str], bool]) -> str:
    """ "file.py:12: ", the innermost line of an exception in a file that is meant; empty without one."""
    frames = [f for f in traceback.extract_tb(problem.__traceback__) if is_meant(f.filename)]
    return "".join(f"{Path(f.filename).name}:{f.lineno}: " for f in frames[-1:])
