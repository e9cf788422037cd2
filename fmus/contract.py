"""The one declaration from which everything else is derived: a subsystem.

A subsystem is data plus two pure functions of it,

    dx/dt = dynamics(x, u, p)        y = observe(x, u, p)

over four groups of scalars (`Group`): states x, inputs u, parameters p and outputs y.
Each field is a scalar with a `Quantity` (unit, text, magnitude).
A name that stands both in the states and in the outputs is one variable.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Literal, TypeAlias, TypeVar, dataclass_transform, get_type_hints

import casadi as ca

from orchestrator.base.errors import Problem

Scalar: TypeAlias = Any  # float | ca.SX; the operators of CasADi's own annotations do not fit symbols
G = TypeVar("G")


ModelError = Problem  # its name until version 0.1


@dataclass(frozen=True)
class Quantity:
    """Meaning of one scalar.

    unit, text   SI unit and one line of description
    nominal      magnitude in that unit, for scaling and error control
    absolute     states only: the absolute tolerance over the relative one; without it, nominal
    minimum, maximum   bounds that an importer and the FMU check
    tunable      parameters only: may be changed while the simulation runs
    rate         inputs only: name of the input that carries this one's exact time derivative
    warn_above   inputs and outputs: |value| above which the FMU logs a warning, once per excursion
    group        parameters only: the heading it stands under; without one, that of the parameter before
    value        its number, for a subsystem that has no file of numbers
    """

    unit: str
    text: str
    nominal: float = 1.0
    minimum: float | None = None
    maximum: float | None = None
    tunable: bool = False
    rate: str | None = None
    warn_above: float | None = None
    group: str = ""
    absolute: float | None = None
    value: float | None = None

    @property
    def absolute_scale(self) -> float:
        """Absolute tolerance of the error control over the relative one."""
        return self.nominal if self.absolute is None else self.absolute

    def of(self, prefix: str, owner: str) -> Quantity:
        """With `owner` in place of "{}" in its texts, and its rate by the name with the prefix."""
        heading = self.group.replace("{}", owner)
        return replace(
            self,
            text=self.text.replace("{}", owner),
            group=heading[:1].upper() + heading[1:],
            rate=self.rate and f"{prefix}_{self.rate}",
        )


@dataclass_transform(frozen_default=True, kw_only_default=True, field_specifiers=(Quantity,))
class Group:
    """Scalars that belong together, such as the states of a subsystem; each field is a `Quantity`.

        class State(Group):
            pressure: Scalar = Quantity("Pa", "Pressure of the chamber", 1e7)

    A frozen dataclass, made with fields by name. A group that inherits from others has their fields, too.
    What is needed twice is declared once and put in with a prefix, before the fields of the class itself:

        class Parameters(Group, boom=Cylinder, stick=Cylinder):      boom_bore, boom_rod, ..., stick_bore, ...

    "{}" in its texts becomes the prefix, or the words in `boom=(Cylinder, "lift")`; `Cylinder.of(p, "boom")`
    takes it out again.
    """

    if TYPE_CHECKING:

        def __getattr__(self, name: str) -> Any: ...

    def __init_subclass__(cls, **parts: type[Group] | tuple[type[Group], str]) -> None:
        declared: dict[str, Quantity] = {}
        for prefix, part in parts.items():
            kind, owner = part if isinstance(part, tuple) else (part, prefix)
            declared |= {f"{prefix}_{name}": q.of(prefix, owner) for name, q in quantities(kind).items()}
        declared |= {name: q for name, q in vars(cls).items() if isinstance(q, Quantity)}
        cls.__annotations__ = dict.fromkeys(declared, "Scalar")
        for name, quantity in declared.items():
            default: dict[str, Any] = {} if quantity.value is None else {"default": quantity.value}
            setattr(cls, name, field(**default, metadata={"quantity": quantity}))
        dataclass(frozen=True, kw_only=True)(cls)

    @classmethod
    def of(cls: type[G], values: Any, prefix: str = "") -> G:
        """The group from those fields of `values` that have its names, with this prefix and "_"."""
        before = f"{prefix}_" if prefix else ""
        return cls(**{f.name: getattr(values, before + f.name) for f in fields(cls)})  # type: ignore[arg-type]


def make_group(name: str, members: Mapping[str, Quantity], *bases: type[Group]) -> type[Any]:
    """A group with these members, after those of its bases."""
    return type(name, bases or (Group,), {"__module__": __name__, **members})


@dataclass(frozen=True)
class Member:
    """One variable of a terminal.

    name   equal on both sides of a connection
    flow   "in" or "out" for what is balanced over the connection (force, torque, flow), positive
           into or out of the subsystem; empty for the rest
    """

    name: str
    variable: str
    flow: Literal["in", "out", ""] = ""


@dataclass(frozen=True)
class Terminal:
    """A port: variables that are connected together, to a terminal of the same kind of another subsystem."""

    name: str
    kind: str
    text: str
    members: tuple[Member, ...]


def _none(*_: Any) -> dict[str, Scalar]:
    return {}


def never(*_: Any) -> Scalar:
    """The `corner` of a subsystem without any."""
    return math.inf


@dataclass(frozen=True)
class Subsystem:
    """One FMU-to-be.

    name       identifier: model identifier and file name of the FMU
    values     the parameters.toml with the numbers of parameters and start values; README.md and icon.png
               beside it go into the FMU. Without a file the numbers are the `value`s of the quantities
    initial    (x, u, p) -> {state: value}: states computed at initialisation, perhaps from
               the start values x of the others, which start at their start value
    require    (x, u, p) -> {statement: expression}: what must hold (expression > 0)
               at the start and after every step, else the FMU reports an error
    derive     (p) -> {parameter: value}: the value of a parameter wherever its number is 0
    corner     (x, u, p) -> seconds to the next known instant at which a rate jumps, infinite for none:
               a time event in model exchange, so that no solver steps over it
    terminals  its ports
    numbers    what would stand in that file (`parameters.read`), for a subsystem that has none
    stiff      are there modes much faster than the motion? If not, an explicit method is tried first
    part, variant   the component that it stands for and which fidelity of it (`family`)
    validity   where it holds, in one line
    elsewhere  names in the file that only other variants of the part declare
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
    corner: Callable[[Any, Any, Any], Scalar] = never
    numbers: Mapping[str, Mapping[str, Any]] | None = None
    terminals: tuple[Terminal, ...] = ()
    stiff: bool = True
    part: str = ""
    variant: str = ""
    validity: str = ""
    elsewhere: frozenset[str] = frozenset()

    @property
    def folder(self) -> Path:
        """Where README.md, icon.png and the reference experiment are, if it has any."""
        return Path(os.devnull) if self.values is None else self.values.parent

    @property
    def component(self) -> str:
        """The name that it has in a system."""
        return self.part or self.name


def family(part: str, **variants: Subsystem) -> dict[str, Subsystem]:
    """Variants of one part by name, the usual one first; completes what makes them a family.

    The usual one is named like the part, another one `part_variant`. All have the same inputs, and at least
    the outputs of the usual one: whichever stands in a system, the wires and the signals fit.
    """
    names = {v: _startable(sub) for v, sub in variants.items()}
    usual = next(iter(variants.values()))
    for sub in variants.values():
        for group in ("inputs", "outputs"):
            declared, wanted = quantities(getattr(sub, group)), quantities(getattr(usual, group))
            differ = [n for n, q in wanted.items() if declared.get(n) != q]
            differ += [n for n in declared if n not in wanted and group == "inputs"]
            if differ:
                raise Problem(f"{sub.name}: {group} differ from those of {usual.name}: {', '.join(differ)}")
    return {
        v: replace(
            sub,
            name=part if sub is usual else f"{part}_{v}",
            part=part,
            variant=v,
            elsewhere=frozenset().union(*names.values()) - names[v],
        )
        for v, sub in variants.items()
    }


def _startable(sub: Subsystem) -> frozenset[str]:
    """The names that may stand in the file of numbers."""
    return frozenset(n for g in (sub.parameters, sub.inputs, sub.states) for n in quantities(g))


_DECLARED: dict[type[Any], MappingProxyType[str, Quantity]] = {}  # type hints are slow to resolve


def quantities(group: type[Any]) -> MappingProxyType[str, Quantity]:
    """The quantities of a group in the order of its fields, each with the heading it stands under.

    Also of a dataclass whose fields are `Annotated[float, Quantity(...)]`.
    """
    if group in _DECLARED:
        return _DECLARED[group]
    if issubclass(group, Group):
        declared = {f.name: f.metadata["quantity"] for f in fields(group)}  # type: ignore[arg-type]
    else:
        hints = get_type_hints(group, include_extras=True)
        declared = {f.name: hints[f.name].__metadata__[0] for f in fields(group)}
    heading = ""
    for name, quantity in declared.items():
        heading = quantity.group or heading
        declared[name] = replace(quantity, group=heading)
    return _DECLARED.setdefault(group, MappingProxyType(declared))


def symbols(group: type[G]) -> G:
    """A group of fresh scalar symbols named like its fields."""
    return group(**{f.name: ca.SX.sym(f.name) for f in fields(group)})  # type: ignore[arg-type]


def column(*values: Scalar) -> Any:
    """Scalars and columns under each other, shape (n, 1); the one place that hides CasADi's types."""
    return ca.vertcat(*values) if values else ca.SX(0, 1)


def stack(values: Any) -> Any:
    """The fields of a group as one column, shape (n, 1), in field order."""
    return column(*[getattr(values, f.name) for f in fields(values)])


def unstack(group: type[G], values: Any) -> G:
    """A group from a column, the inverse of `stack`; also for NumPy arrays of shape (n,)."""
    return group(**{f.name: values[i] for i, f in enumerate(fields(group))})  # type: ignore[arg-type]


@dataclass(frozen=True)
class Symbolic:
    """A subsystem written out: symbols x, u, p (columns) and the expressions of them."""

    x: ca.SX
    u: ca.SX
    p: ca.SX
    dx: ca.SX
    y: ca.SX
    start: ca.SX  # x at the start: of the start values (the symbols x), u and p
    calculated: tuple[str, ...]  # states that `initial` computes
    require: ca.SX
    statements: tuple[str, ...]
    corner: ca.SX

    def function(self, name: str = "model") -> ca.Function:
        """(x, u, p) -> (dx, y)."""
        return ca.Function(name, [self.x, self.u, self.p], [self.dx, self.y], ["x", "u", "p"], ["dx", "y"])

    def initial(self) -> ca.Function:
        """(start values x, u, p) -> x at the start."""
        return ca.Function("initial", [self.x, self.u, self.p], [self.start])


def symbolic(sub: Subsystem) -> Symbolic:
    """Evaluate the subsystem's functions once on symbols."""
    x, u, given = symbols(sub.states), symbols(sub.inputs), symbols(sub.parameters)
    derived = {
        n: ca.if_else(getattr(given, n) > 0, getattr(given, n), v) for n, v in sub.derive(given).items()
    }
    p = replace(given, **derived)
    computed = dict(sub.initial(x, u, p))
    unknown = set(computed) - set(quantities(sub.states))
    if unknown:
        raise Problem(f"{sub.name}: initial() returns {sorted(unknown)}, expected names of states")
    own = column(*(getattr(x, name) for name in computed))
    if ca.depends_on(ca.SX(column(*computed.values())), own):
        raise Problem(f"{sub.name}: initial() uses a state that it computes, expected those of others")
    start = [computed.get(f.name, getattr(x, f.name)) for f in fields(sub.states)]
    require = dict(sub.require(x, u, p))
    return Symbolic(
        x=stack(x),
        u=stack(u),
        p=stack(given),
        dx=stack(sub.dynamics(x, u, p)),
        y=stack(sub.observe(x, u, p)),
        start=column(*start),
        calculated=tuple(computed),
        require=column(*require.values()),
        statements=tuple(require),
        corner=ca.SX(sub.corner(x, u, p)),
    )
