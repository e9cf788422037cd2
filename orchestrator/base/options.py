"""Options, declared once for Python, the command line, study files and SSP annotations.

A group of options is a TypedDict, whose docstring has the text of each option. The type has the kind of the
value: its unit, its word in the help and its flag on the command line. A name in backquotes is an option.
Only the standard library is imported here, so that `harvester --help` stays fast.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from inspect import cleandoc
from math import inf
from pathlib import Path
from textwrap import fill
from types import UnionType
from typing import Annotated, Any, Literal, TypeAlias, TypedDict, TypeVar, Union, get_args, get_origin
from typing import get_type_hints as hints_of

from orchestrator.base.coupling import Control, Coupling, Master
from orchestrator.base.errors import Problem, suggest


@dataclass(frozen=True)
class Kind:
    """What the value of an option is.

    word         in the help, in place of the value
    unit         of a number; a text has any unit of this quantity, such as "1 ms"
    flags        on the command line; default: the name of the option
    form         of one item of a mapping, for messages
    least, most  limits of a number
    positional   an argument of a command
    text         help of an option without a row in a docstring
    """

    word: str = ""
    unit: str = ""
    flags: tuple[str, ...] = ()
    form: str = ""
    least: float = -inf
    most: float = inf
    positional: bool = False
    text: str = ""


Seconds: TypeAlias = Annotated[float | str | None, Kind("T", "s")]
Number: TypeAlias = Annotated[float | None, Kind("TOL")]
Tolerance: TypeAlias = Annotated[float | None, Kind("TOL", least=1e-16, most=1.0)]
Whole: TypeAlias = Annotated[int | None, Kind("N")]
Patterns: TypeAlias = Annotated[str | Sequence[str] | None, Kind("PATTERN")]
Sets: TypeAlias = Annotated[
    str | Path | Sequence[str | Path] | None, Kind("SET", flags=("--parameters", "--pose"))
]
Swaps: TypeAlias = Annotated[
    Mapping[str, str | Path] | None, Kind("COMPONENT=FMU", form="component=variant or component=file.fmu")
]
Values: TypeAlias = Annotated[
    Mapping[str, float | bool | str] | None,
    Kind("NAME=VALUE", form="component.variable=value or input=value"),
]
_STEPS = "component=N, the number of internal steps per communication step"
Substeps: TypeAlias = Annotated[
    Mapping[str, int] | None, Kind("COMPONENT=N", flags=("--factor",), form=_STEPS)
]


class SystemArguments(TypedDict, total=False):
    """Variants, parameters and connections of a system.

    swap         Replace the FMU of a component by a variant, such as boom_stick=detailed, or by a file,
                 boom_stick=FILE.fmu; default: the FMUs in the system.
    parameters   Parameter set of the system, such as reach, or a file FILE.ssv; later ones override; default:
                 the values in the system.
    set          Start value of COMPONENT.VARIABLE, such as manipulator.head_mass=600. A name without a
                 component sets all inputs of this name (supply_pressure) or a parameter that components share
                 (boom_stroke). Unit: that of `harvester signals`, or given, such as
                 supply.pressure_setting=180bar.
    cut          Remove the connections to the inputs COMPONENT.VARIABLE that match, such as '*_rate';
                 default: none.
    """

    swap: Swaps
    parameters: Sets
    set: Values
    cut: Patterns


class SpanArguments(TypedDict, total=False):
    """The time span of a run.

    start   Start time [s]; default: the start time in the system, else 0.
    stop    Stop time [s]; default: the end of the scenario, else the stop time in the system or its FMUs.
    """

    start: Seconds
    stop: Seconds


class StepArguments(TypedDict, total=False):
    """Communication step, and time between recorded points.

    step          Communication step [s], with `adaptive` the first one; default: the step in the system or
                  its FMUs, 1e-3 for the harvester.
    record_step   Time between recorded points [s], a multiple of the step, with `adaptive` any time; default:
                  every step. Commands record every 0.005 s; only `harvester run` with `adaptive` records
                  every step.
    """

    step: Seconds
    record_step: Seconds


class AccuracyArguments(TypedDict, total=False):
    """How accurate a run is to be, in place of coupling, step and tolerance.

    accuracy      Largest RMS error over the range of a signal, such as 1e-3: master, step and FMU tolerance
                  follow from it. Default of the commands, if neither options nor the system choose master or
                  step, and all FMUs have directional derivatives: 1e-3, validate: 1e-4.
    accuracy_of   With `accuracy`: the outputs COMPONENT.VARIABLE that it applies to, such as '*_speed';
                  default: the velocities of power bonds, else all outputs.
    """

    accuracy: Annotated[float | None, Kind("ERROR")]
    accuracy_of: Patterns


class SolverArguments(TypedDict, total=False):
    """The solvers in the FMUs.

    tolerance   Relative tolerance of the solvers in the FMUs; default: with `accuracy` 0.03 of it, else the
                tolerance in the DefaultExperiment of each FMU.
    """

    tolerance: Tolerance


class LimitArguments(TypedDict, total=False):
    """Estimate of errors, and limits of a run.

    error_estimate   Estimate the error of the outputs that the coupling causes. If an FMU has no directional
                     derivatives, repeat the run at half and at twice the step, and print the change of the
                     signals.
    time_limit       Limit of the wall time of the run [s]; default: no limit.
    memory_limit     Memory limit of the process that runs the FMUs [GB, 1e9 bytes]; default: the memory of
                     the computer.
    """

    error_estimate: bool | Literal["fast"] | None
    time_limit: Seconds
    memory_limit: Annotated[float | None, Kind("GB", "GB", most=1e6)]  # more is meant in bytes


class CouplingArguments(TypedDict, total=False):
    """How the components are coupled; relative errors are fractions of a signal's magnitude.

    master               jacobi, gauss-seidel, hermite or interface-jacobian; default: the master in the
                         system, else gauss-seidel.
    order                Order of the extrapolation of outputs over a step: 0 (held), 1, 2 or 3; default: 0
                         for jacobi and gauss-seidel, else 3.
    passes               hermite: largest number of passes over a step, at least 1; default: 8.
    coupling_tolerance   hermite: repeat a step while the end value of a signal, or its time derivative times
                         the step, changes by more than TOL times its magnitude (the nominal value, or the
                         largest value so far); default: 1e-5, with `adaptive` 0.3 of its TOL.
    correct              Correct the inputs by the extrapolation error of the previous step.
    lag                  interface-jacobian: linearise the components every N steps; default: 1.
    factors              Number of internal steps of the component per communication step; default: 1.
    adaptive             Adapt the step so that the estimated error of each signal stays below TOL times its
                         magnitude (the nominal value, or the largest value so far), such as 1e-3; default:
                         equal steps.
    control              With `adaptive`: what TOL limits: error (of the signals) or energy (the power error
                         of the power bonds); default: error.
    guard                Without `adaptive`: divide a step if the estimated error of a signal exceeds TOL
                         times its magnitude, or if the scenario has a corner inside the step; all components
                         must be able to restore their states; 0: never; default: 0.01 for hermite and
                         interface-jacobian, else 0.
    smallest             With `adaptive`: shortest step [s], accepted with any error; default: 1e-7.
    largest              With `adaptive`: longest step [s]; default: 0.1.
    """

    master: Annotated[Master | Coupling | None, Kind("NAME")]
    order: Whole
    passes: Whole
    coupling_tolerance: Number
    correct: bool | None
    lag: Whole
    factors: Substeps
    adaptive: Number
    control: Annotated[Control | None, Kind("WHAT")]
    guard: Number
    smallest: Seconds
    largest: Seconds


class ProcessArguments(TypedDict, total=False):
    """Options of a run in Python only.

    bonds       Power bonds, as pairs of input names, whose energy error is recorded; default: those that
                follow from the units.
    progress    Show a progress bar if the run takes longer than a second.
    isolate     Run in a process of its own, so that an FMU that crashes ends only that process; default: yes.
    open        Opens a component: returns an FMU, or any object with the methods of
                `orchestrator.fmi.calls.Slave`; a function other than `open_slave` needs this process.
    """

    bonds: Sequence[tuple[str, str]] | None
    progress: bool | None
    isolate: bool | None
    open: Callable[[Any], Any] | None


class CaseArguments(SystemArguments, SpanArguments, total=False):
    """What is run: variants, parameters, connections, time span."""


class CoupledArguments(CaseArguments, StepArguments, AccuracyArguments, CouplingArguments, total=False):
    """What a co-simulation runs, how accurate, and how it is coupled."""


class CommandArguments(CoupledArguments, SolverArguments, LimitArguments, total=False):
    """Options of the command `run`."""


class RunArguments(CommandArguments, ProcessArguments, total=False):
    """Options of `run`."""


class MachinesArguments(SystemArguments, StepArguments, SolverArguments, CouplingArguments, total=False):
    """Options of machines that are simulated at once.

    workers   Number of cores to use; default: all.
    """

    workers: int | None


class BatchArguments(MachinesArguments, SpanArguments, total=False):
    """Options of `batch`.

    time_limit     Limit of the wall time of all machines together [s]; the others end there as failed;
                   default: no limit.
    memory_limit   Memory limit of each process that runs machines one by one [GB, 1e9 bytes]; default: the
                   memory of the computer.
    """

    time_limit: Seconds
    memory_limit: Annotated[float | None, Kind("GB", "GB", most=1e6)]


class ReferenceArguments(CaseArguments, total=False):
    """Options of `reference`.

    record_step   Time between recorded points [s]; default: 0.005.
    tolerance     Relative tolerance of the solver, 1e-14 to 1e-2, and absolute, times the magnitude that the
                  FMU gives for each state; default: 2e-14.
    """

    record_step: Seconds
    tolerance: Number


class LinearArguments(SystemArguments, total=False):
    """Options of `linearize`.

    inputs    Input of the linear model, COMPONENT.VARIABLE or all inputs with this name; its connection is
              removed; default: the inputs of the system, and the inputs that are connected to operator_input.
    outputs   Outputs COMPONENT.VARIABLE that match, such as '*_angle'; default: all.
    steady    Linearize at the steady state with the joint angles of the operating point; all other states are
              computed.
    speeds    With `steady`: constant speed of a joint [rad/s], such as boom=0.1; default: 0.
    time      Linearize at this time of a run [s]; default: at the start.
    step      With `time`: communication step of that run [s]; default: the step in the system or its FMUs.
    """

    inputs: Annotated[str | Sequence[str] | None, Kind("NAME", flags=("--input",))]
    outputs: Annotated[str | Sequence[str] | None, Kind("PATTERN", flags=("--output",))]
    steady: bool | None
    speeds: Annotated[
        Mapping[str, float] | None,
        Kind("JOINT=V", flags=("--speed",), form="joint=speed, such as boom=0.1"),
    ]
    time: Seconds
    step: Seconds


FIELDS = {"coupling_tolerance": "tolerance"}  # option -> field of `Coupling`, where they differ
GROUPS = (
    *(SystemArguments, SpanArguments, StepArguments, AccuracyArguments, SolverArguments, LimitArguments),
    *(CouplingArguments, ProcessArguments, MachinesArguments),
)


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
        return any(get_origin(t) in (Sequence, list, Mapping) for t in self.types)

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
            if value in self.choices or type(value) in self.types:
                return value
            raise ValueError(f"one of {', '.join(self.choices)}{', True, False' * (bool in self.types)}")
        if self.mapping is not None and not isinstance(value, Mapping):
            raise ValueError("a mapping from name to value")
        if self.repeatable and self.mapping is None:
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
            unit = f" of {UNITS[self.kind.unit]}" if self.kind.unit else ""
            limits = {
                f"at least {self.kind.least:g}": self.kind.least,
                f"at most {self.kind.most:.0f}": self.kind.most,
            }
            told = "".join(f", {text}" for text, limit in limits.items() if abs(limit) < inf)
            raise ValueError(f"a {'whole ' * (self.numeric is int)}number{unit}{told}") from None
        return number

    def _parsed(self, text: str) -> Any:
        """The number in a text, which may have a unit."""
        try:
            return self.numeric(text)
        except ValueError:
            if not self.kind.unit:
                raise
        from orchestrator.base.units import factor_and_offset, number_and_unit  # not for --help: NumPy

        number, unit = number_and_unit(text)
        factor, offset = factor_and_offset(unit, self.kind.unit, "unit")
        return float(f"{factor * float(number) + offset:.15g}")  # 0.3 ms is 0.0003 s


UNITS = {"s": "seconds", "GB": "GB"}


@cache
def declared(hint: Any) -> Declared:
    """The declaration that an annotation makes."""
    inner = get_args(hint)
    if get_origin(hint) is Annotated:
        found = declared(inner[0])
        return Declared(inner[1], found.types, found.choices)
    if get_origin(hint) is Literal:
        return Declared(choices=inner)
    if get_origin(hint) not in (Union, UnionType):
        return Declared(types=(hint,) if hint is not type(None) else ())
    parts = [declared(member) for member in inner]
    kind = next((part.kind for part in parts if part.kind != Kind()), Kind())
    types, choices = ([v for part in parts for v in getattr(part, n)] for n in ("types", "choices"))
    return Declared(kind, tuple(types), tuple(choices))


@cache
def declarations(group: Any) -> Mapping[str, Declared]:
    """The options of a group."""
    return {name: declared(hint) for name, hint in hints_of(group, include_extras=True).items()}


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
    texts = text_and_rows(group)[1]
    for other in GROUPS:
        texts = text_and_rows(other)[1] | texts
    return {name: texts.get(name, "") for name in declarations(group)}


def chosen(group: Any, options: Mapping[str, Any], function: str) -> dict[str, Any]:
    """The options of a call that are not None, in SI units.

    Raises TypeError for a name that is not in the group, and Problem for a wrong value.
    """
    known, values = declarations(group), dict[str, Any]()
    for name, value in options.items():
        if name not in known:
            raise TypeError(f"{function}() has no option {name!r}{suggest(name, [*known, 'scenario'])}")
        if value is not None:
            values[name] = _checked(name, known[name], value)
    return values


def _checked(name: str, option: Declared, value: Any) -> Any:
    try:
        return option.read(value)
    except ValueError as expected:
        raise Problem(f"{name}: expected {expected}, got {value!r}") from None


def seconds(value: float | str | None, name: str) -> float | None:
    """A time [s], which may be a text with a unit; raises Problem, beginning with its name, for others."""
    return None if value is None else float(_checked(name, declared(Seconds), value))


F = TypeVar("F", bound=Callable[..., Any])


def documented(group: Any) -> Callable[[F], F]:
    """Decorator: adds the texts of the options of a group to the docstring of a function."""

    def decorate(function: F) -> F:
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
