"""Declarations of options, for Python, the command line, study files and SSP annotations.

A group of options is a frozen dataclass, whose docstring has the text of each option. The type has the kind
of the value: its unit, its word in the help and its flag on the command line. A name in backquotes is an
option. The groups are in `engine.options` and `ssp.coupling`. They and this file import only the standard
library, so that `harvester --help` stays fast. The keywords of a function are the options of a group, see
`engine.arguments`.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, is_dataclass
from functools import cache
from inspect import Parameter, cleandoc, signature
from math import inf
from pathlib import Path
from textwrap import fill
from types import UnionType
from typing import Annotated, Any, Literal, TypeAlias, TypeVar, Union, get_args, get_origin
from typing import get_type_hints as hints_of

from orchestrator.base.errors import Problem, suggest
from orchestrator.base.numerals import integer, real


@dataclass(frozen=True)
class Kind:
    """What the value of an option is.

    word         in the help, in place of the value
    unit         of a number; a text has any unit of this quantity, such as "1 ms"
    flags        on the command line; default: the name of the option
    form         of one item of a mapping, for messages
    least, most  limits of a number
    positional   an argument of a command
    choices      the texts that are allowed
    text         help of an option without a row in a docstring
    option       its name, where the field of a group has another one
    others       types of values that are accepted in place of a text
    """

    word: str = ""
    unit: str = ""
    flags: tuple[str, ...] = ()
    form: str = ""
    least: float = -inf
    most: float = inf
    positional: bool = False
    choices: tuple[str, ...] = ()
    text: str = ""
    option: str = ""
    others: tuple[type, ...] = ()

    def __repr__(self) -> str:
        return f"Kind({self.word!r})"


Time: TypeAlias = float | str | None  # [s], or a text with a unit, as an argument of a function
Seconds: TypeAlias = Annotated[float | None, Kind("T", "s")]
Number: TypeAlias = Annotated[float | None, Kind("TOL")]
Tolerance: TypeAlias = Annotated[float | None, Kind("TOL", least=1e-16, most=1.0)]
Whole: TypeAlias = Annotated[int | None, Kind("N")]
Patterns: TypeAlias = Annotated[tuple[str, ...], Kind("PATTERN")]
Sets: TypeAlias = Annotated[tuple[str | Path, ...], Kind("SET", flags=("--parameters", "--pose"))]
Swaps: TypeAlias = Annotated[
    Mapping[str, str | Path], Kind("COMPONENT=FMU", form="component=variant or component=file.fmu")
]
Values: TypeAlias = Annotated[
    Mapping[str, float | bool | str], Kind("NAME=VALUE", form="component.variable=value or input=value")
]
Faults: TypeAlias = Annotated[
    Mapping[str, float | str], Kind("NAME=SIZE@TIME", form="input=value@time, such as 2mm2@20s")
]
_STEPS = "component=N, the number of internal steps per communication step"
Substeps: TypeAlias = Annotated[Mapping[str, int], Kind("COMPONENT=N", flags=("--factor",), form=_STEPS)]

GROUPS: list[Any] = []  # of options, in which a text is looked for that a group does not have


# ---- reading


@dataclass(frozen=True)
class Declared:
    """The declaration of an option: its kind, the types of its value, and the texts that are allowed."""

    kind: Kind = Kind()
    types: tuple[Any, ...] = ()
    choices: tuple[str, ...] = ()

    @property
    def repeatable(self) -> bool:
        """Can there be several values?"""
        return any(get_origin(t) in (tuple, list, Mapping) for t in self.types)

    @property
    def mapping(self) -> Any:
        """The type of the values of a mapping; None for other options."""
        return next((get_args(t)[1] for t in self.types if get_origin(t) is Mapping), None)

    @property
    def numeric(self) -> Any:
        """float or int for a number; None for other options."""
        return next((t for t in (float, int) if t in self.types and bool not in self.types), None)

    def read(self, value: Any) -> Any:
        """A value in SI units, several as a tuple; raises ValueError with what is expected."""
        if self.choices:
            accepted = (*self.kind.others, *(t for t in self.types if t is not str))
            if value in self.choices or type(value) in accepted:
                return value
            raise ValueError(f"one of {', '.join(self.choices)}{', True, False' * (bool in self.types)}")
        if self.mapping is not None and not isinstance(value, Mapping):
            raise ValueError("a mapping from name to value")
        if self.repeatable and self.mapping is None:
            if not isinstance(value, Iterable):
                raise ValueError("a text or a list of texts")
            return (value,) if isinstance(value, str | Path) else tuple(value)
        if self.numeric:
            return self._number(value)
        if self.types == (bool,) and not isinstance(value, bool):
            raise ValueError("True or False")
        return value

    def _number(self, value: Any) -> Any:
        try:
            number = self._parsed(value) if isinstance(value, str) else self.numeric(value)
            if isinstance(value, bool) or (self.numeric is int and number != float(value)):
                raise ValueError
            if number < self.kind.least or number > self.kind.most:
                raise ValueError
        except (TypeError, ValueError, OverflowError, Problem):
            expected = EXPECTED.get(self.kind.unit) or f"a {'whole ' * (self.numeric is int)}number"
            limits = {
                f"at least {self.kind.least:g}": self.kind.least,
                f"at most {self.kind.most:.0f}": self.kind.most,
            }
            told = "".join(f", {text}" for text, limit in limits.items() if abs(limit) < inf)
            raise ValueError(f"{expected}{told}") from None
        return number

    def _parsed(self, text: str) -> Any:
        """The number in a text, which may have a unit."""
        try:
            return {float: real, int: integer}[self.numeric](text)
        except ValueError:
            if not self.kind.unit:
                raise
        from orchestrator.base.units import factor_and_offset, number_and_unit  # not for --help: NumPy

        number, unit = number_and_unit(text)
        factor, offset = factor_and_offset(unit, self.kind.unit, "unit")
        return float(f"{factor * float(number) + offset:.15g}")  # 0.3 ms is 0.0003 s


EXPECTED = {"s": "a number of seconds or a time such as 500ms or 5min", "GB": "a number of GB"}


@cache
def declared(hint: Any) -> Declared:
    """The declaration that an annotation makes."""
    inner = get_args(hint)
    if get_origin(hint) is Annotated:
        found = declared(inner[0])
        return Declared(inner[1], found.types, found.choices or inner[1].choices)
    if get_origin(hint) is Literal:
        return Declared(choices=inner)
    if get_origin(hint) not in (Union, UnionType):
        return Declared(types=(hint,) if hint is not type(None) else ())
    parts = [declared(member) for member in inner]
    kind = next((part.kind for part in parts if part.kind != Kind()), Kind())
    types, choices = ([v for part in parts for v in getattr(part, n)] for n in ("types", "choices"))
    return Declared(kind, tuple(types), tuple(choices))


KEYWORDS: dict[Any, Any] = {}  # the keywords of a function, as a type checker has them -> the group


@cache
def declarations(group: Any) -> Mapping[str, Declared]:
    """The options of a group, in the order of its bases; of a field that is a group those of that one."""
    return {name: option for name, (_, option) in _declarations(KEYWORDS.get(group, group)).items()}


@cache
def field_names(group: Any) -> Mapping[str, str]:
    """Option -> field of a group."""
    return {name: field for name, (field, _) in _declarations(group).items()}


def _declarations(group: Any) -> dict[str, tuple[str, Declared]]:
    found = dict[str, tuple[str, Declared]]()
    for base in filter(is_dataclass, group.__bases__):
        found |= _declarations(base)
    hints = hints_of(group, include_extras=True)
    for name in group.__annotations__ if "__annotations__" in vars(group) else ():
        if is_dataclass(hints[name]):
            found |= _declarations(hints[name])
        else:
            option = declared(hints[name])
            found[option.kind.option or name] = name, option
    return found


ROW = re.compile(r"(\w+) {2,}(\S.*)")


def text_and_rows(documented: Any) -> tuple[str, dict[str, str]]:
    """The text of a docstring, and the text of each option in it; empty if Python runs without docstrings."""
    text, rows, row = list[str](), dict[str, str](), ""
    for line in cleandoc(documented.__doc__ or "").splitlines():
        if found := ROW.fullmatch(line):
            row, rows[found[1]] = found[1], found[2]
        elif row and line.startswith("  "):
            rows[row] += f" {line.strip()}"
        else:
            row = ""
            text.append(line)
    return "\n".join(text).strip(), rows


@cache
def option_texts(group: Any) -> Mapping[str, str]:
    """The text of each option of a group, or of the first group that declares it."""
    texts = text_and_rows(KEYWORDS.get(group, group))[1]
    for other in GROUPS:
        texts = text_and_rows(other)[1] | texts
    return {name: texts.get(name, "") for name in declarations(group)}


# option of FMPy's simulate_fmu -> ours
OF_FMPY = {
    "start_time": "start", "stop_time": "stop", "step_size": "step", "output_interval": "record_step",
    "relative_tolerance": "tolerance", "start_values": "set", "timeout": "time_limit",
}  # fmt: skip


Group = TypeVar("Group")


def chosen(group: type[Group], options: Mapping[str, Any], function: str) -> Group:
    """The record of the options of a call; those that are None are not chosen.

    Raises TypeError for a name that is not in the group, and Problem for a wrong value.
    """
    of: Any = group  # whose hash a type checker does not know
    values = checked(of, options, function)
    for name, inner in _inner_groups(of).items():
        own = {option: values.pop(option) for option in declarations(inner) if option in values}
        values |= {name: inner.chosen(own)} if own else {}
    return group(**values)


@cache
def _inner_groups(group: Any) -> Mapping[str, Any]:
    """The fields of a group that are groups themselves, which have a function `chosen`."""
    return {name: hint for name, hint in hints_of(group).items() if is_dataclass(hint)}


def given(record: Any, group: Any = None) -> dict[str, Any]:
    """The options of a record that differ from their defaults, by name; group: default: its own."""
    group = group or type(record)
    found, usual, inner = dict[str, Any](), group(), _inner_groups(group)
    for option, name in field_names(group).items():
        if hasattr(usual, name) and (value := getattr(record, name)) != getattr(usual, name):
            found[option] = value
    for name, of in inner.items():
        found |= given(getattr(record, name), of)
    return found


def checked(group: Any, options: Mapping[str, Any], function: str) -> dict[str, Any]:
    """The options of a call that are not None, in SI units.

    Raises TypeError for a name that is not in the group, and Problem for a wrong value.
    """
    known, values = declarations(group), dict[str, Any]()
    for name, value in options.items():
        if name not in known:
            here = f"; did you mean {OF_FMPY[name]}?" if OF_FMPY.get(name) in known else ""
            hint = here or suggest(name, [*known, "scenario"])
            raise TypeError(f"{function}() has no option {name!r}{hint}")
        if value is not None:
            values[name] = _checked(name, known[name], value)
    return values


def _checked(name: str, option: Declared, value: Any) -> Any:
    try:
        return option.read(value)
    except ValueError as expected:
        raise Problem(f"{name}: expected {expected}, got {value!r}") from None


def seconds(value: Time, name: str) -> float | None:
    """A time [s], which may be a text with a unit; raises Problem, beginning with its name, for others."""
    return None if value is None else float(_checked(name, declared(Seconds), value))


F = TypeVar("F", bound=Callable[..., Any])


def documented(group: Any) -> Callable[[F], F]:
    """Decorator: adds the options of a group to the docstring and the signature of a function."""

    def decorate(function: F) -> F:
        plain = signature(function)
        own = [p for p in plain.parameters.values() if p.kind is not Parameter.VAR_KEYWORD]
        options = [
            Parameter(name, Parameter.KEYWORD_ONLY, default=None, annotation=hint)
            for name, hint in hints_of(group).items()
        ]
        function.__signature__ = plain.replace(parameters=[*own, *options])  # type: ignore[attr-defined]
        if function.__doc__:
            texts = option_texts(group)
            width = max(map(len, texts)) + 3
            indent = " " * (4 + width)
            rows = "\n".join(
                fill(text, 100, subsequent_indent=indent, initial_indent=f"    {name:{width}}")
                for name, text in texts.items()
            )
            function.__doc__ = f"{function.__doc__.rstrip()}\n\n    Options:\n\n{rows}\n    "
        return function

    return decorate
