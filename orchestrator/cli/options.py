"""The application `harvester`, the options that several commands share, and the parsing of values."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, fields, is_dataclass
from functools import wraps
from inspect import Parameter, Signature, signature
from pathlib import Path
from typing import Annotated, Any, TypeVar, get_type_hints

import typer

from orchestrator.base.errors import Problem

BUILD = Path("build")
SYSTEM = BUILD / "harvester.ssp"

app = typer.Typer(
    add_completion=False,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)


def _print_version(requested: bool) -> None:
    if requested:
        from fmus.package_files import version_text

        print(version_text(BUILD))
        raise typer.Exit


@app.callback()
def _main(
    version: Annotated[
        bool,
        typer.Option(
            "--version", callback=_print_version, is_eager=True, help="Print versions and where the FMUs are."
        ),
    ] = False,
) -> None:  # the docstring is the text of `harvester --help`
    """An electrohydraulic harvester as FMUs: build, co-simulate, validate."""


def with_option_groups(command: Callable[..., None]) -> Callable[..., None]:
    """Decorator: replace each parameter that is a dataclass (a group of options) by its fields."""
    hints = get_type_hints(command, include_extras=True)
    groups: dict[str, Any] = {name: hint for name, hint in hints.items() if is_dataclass(hint)}
    parameters: dict[str, Parameter] = {}
    for name, parameter in signature(command).parameters.items():
        if name in groups:
            types = get_type_hints(groups[name], include_extras=True)
            for f in fields(groups[name]):
                parameters[f.name] = _parameter(f.name, f.default, types[f.name])
        else:
            parameters[name] = _parameter(name, parameter.default, hints[name])

    @wraps(command)
    def flat_command(**values: Any) -> None:
        for name, group in groups.items():
            values[name] = group(**{f.name: values.pop(f.name) for f in fields(group)})
        command(**values)

    flat_command.__signature__ = Signature(list(parameters.values()))  # type: ignore[attr-defined]
    flat_command.__annotations__ = {name: p.annotation for name, p in parameters.items()}
    return flat_command


def _parameter(name: str, default: Any, annotation: Any) -> Parameter:
    return Parameter(name, Parameter.KEYWORD_ONLY, default=default, annotation=annotation)


T = TypeVar("T")


def seconds(text: str) -> float:
    """Parse a time [s]."""
    return _read(text, float, "a number of seconds")


def number(text: str) -> float:
    """Parse a number."""
    return _read(text, float, "a number")


def integer(text: str) -> int:
    """Parse an integer."""
    return _read(text, int, "a whole number")


def positive_integer(text: str) -> int:
    """Parse an integer above zero."""
    value = _read(text, int, "a whole number above 0")
    if value < 1:
        raise typer.BadParameter(f"expected a whole number above 0, got {text!r}")
    return value


def _read(text: str, convert: Callable[[str], T], expected: str) -> T:
    try:
        return convert(text)
    except ValueError:
        raise typer.BadParameter(f"expected {expected}, got {text!r}") from None


def swaps(texts: Iterable[str]) -> dict[str, str]:
    """{component: variant or path} from the texts 'component=variant'."""
    return assignments(texts, "--swap", "component=variant or component=file.fmu")


def substeps(texts: Iterable[str]) -> dict[str, int]:
    """{component: number of its own steps per communication step} from the texts 'component=N'."""
    expected = "component=N, the number of internal steps per communication step"
    counts = assignments(texts, "--factor", expected)
    for name, text in counts.items():
        if not text.isdecimal():
            raise Problem(f"--factor {name}={text}: expected {expected}")
    return {name: int(text) for name, text in counts.items()}


def assignments(
    texts: Iterable[str], option: str = "--set", expected: str = "component.variable=value or input=value"
) -> dict[str, str]:
    """{name: value} from the texts 'name=value' of an option."""
    values = dict[str, str]()
    for text in texts:
        name, equals, value = (part.strip() for part in text.partition("="))
        if not equals or not name:
            raise Problem(f"{option} {text}: expected {expected}")
        if values.setdefault(name, value) != value:
            raise Problem(f"{option} {text}: {name} already has the value {values[name]}")
    return values


def tell_built(system: Path, swapped: Mapping[str, str]) -> None:
    """Print which file of parameters the FMUs of a system were built with, if they were."""
    from orchestrator.base.files import require_system
    from orchestrator.ssp.load import load
    from orchestrator.ssp.provenance import built_notes
    from orchestrator.ssp.swap import with_swaps

    for note in built_notes(with_swaps(load(require_system(system)), swapped)):
        print(note, flush=True)


System = Annotated[
    Path | None,
    typer.Argument(
        metavar="SYSTEM",
        help="An .ssp, .ssd or .fmu file; default: build/harvester.ssp, else the one in the"
        " installed package.",
    ),
]


def system_file(chosen: Path | None, name: str = SYSTEM.name) -> Path:
    """The system that the user names, else build/NAME, else the one in the package, with a line about that.

    If there is none, the path, which the caller then reports as missing.
    """
    from orchestrator.base.files import SYSTEMS, find

    return find(chosen or BUILD / name, SYSTEMS)


Swap = Annotated[
    list[str] | None,
    typer.Option(
        metavar="COMPONENT=FMU",
        help=(
            "Replace the FMU of a component by a variant, such as boom_stick=detailed, or by a "
            "file, boom_stick=FILE.fmu; repeatable; default: the FMUs in the system (in "
            "`track` also the detailed machine)."
        ),
    ),
]

Parameters = Annotated[
    list[str] | None,
    typer.Option(
        "--parameters",
        "--pose",
        metavar="SET",
        help="Parameter set of the system, such as reach, or a file FILE.ssv; repeatable, later ones"
        " override; default: the values in the system.",
    ),
]
Set = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        metavar="NAME=VALUE",
        help=(
            "Start value of COMPONENT.VARIABLE, such as manipulator.head_mass=600. A name without a "
            "component sets all inputs of this name (supply_pressure) or a parameter that components "
            "share (boom_stroke). Unit: that of `harvester signals`, or given, such as "
            "supply.pressure_setting=180bar; repeatable."
        ),
    ),
]


@dataclass(frozen=True)
class RunOptions:
    """What is run: scenario, time span, variants, parameters, connections."""

    scenario: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help=(
                "Inputs over time (.csv, .parquet, .mat); default: the inputs in the system, such "
                "as the work cycle in harvester.ssp; for validate --reference: the commands of the "
                "reference."
            ),
        ),
    ] = None
    start: Annotated[
        float | None,
        typer.Option(
            metavar="T", help="Start time [s]; default: the start time in the system, else 0.", parser=seconds
        ),
    ] = None
    stop: Annotated[
        float | None,
        typer.Option(
            metavar="T",
            help=(
                "Stop time [s]; default: the end of the scenario, else the stop time in the "
                "system or its FMUs."
            ),
            parser=seconds,
        ),
    ] = None
    swap: Swap = None
    parameters: Parameters = None
    set_: Set = None
    cut: Annotated[
        list[str] | None,
        typer.Option(
            metavar="PATTERN",
            help="Remove the connections to the inputs COMPONENT.VARIABLE that match, such as '*_rate';"
            " repeatable; default: none.",
        ),
    ] = None

    def options(self) -> dict[str, Any]:
        """Keyword arguments of the functions that the commands call, without the scenario."""
        return {
            "start": self.start,
            "stop": self.stop,
            "swap": swaps(self.swap or []),
            "parameters": self.parameters or (),
            "set": assignments(self.set_ or []),
            "cut": self.cut or (),
        }


@dataclass(frozen=True)
class StepOptions:
    """Communication step, and time between recorded points."""

    step: Annotated[
        float | None,
        typer.Option(
            metavar="S",
            help=(
                "Communication step [s], with --adaptive the first one; default: the step in the "
                "system or its FMUs, 1e-3 for the harvester."
            ),
            parser=seconds,
        ),
    ] = None
    record_step: Annotated[
        float | None,
        typer.Option(
            metavar="S",
            help=(
                "Time between recorded points [s], a multiple of the step; default: the largest "
                "multiple up to 0.005, or the step itself. With --adaptive: any time; default: every "
                "step (validate: 0.005)."
            ),
            parser=seconds,
        ),
    ] = None

    def options(self) -> dict[str, Any]:
        """Keyword arguments of the functions that the commands call."""
        return {"step": self.step, "record_step": self.record_step}


@dataclass(frozen=True)
class AccuracyOptions:
    """How accurate a run is to be, in place of coupling, step and tolerance."""

    accuracy: Annotated[
        float | None,
        typer.Option(
            metavar="ERROR",
            help="Largest RMS error over the range of a signal, such as 1e-3: master, step and FMU tolerance"
            " follow from it. Default, if neither options nor the system choose master or step, and all"
            " FMUs have directional derivatives: 1e-3, validate: 1e-4.",
            parser=number,
        ),
    ] = None
    accuracy_of: Annotated[
        list[str] | None,
        typer.Option(
            metavar="PATTERN",
            help="With --accuracy: the outputs COMPONENT.VARIABLE that it applies to, such as '*_speed';"
            " repeatable; default: the velocities of power bonds, else all outputs.",
        ),
    ] = None

    def options(self) -> dict[str, Any]:
        """Keyword arguments of the functions that the commands call."""
        return {"accuracy": self.accuracy, "accuracy_of": tuple(self.accuracy_of or ())}


@dataclass(frozen=True)
class CouplingOptions:
    """How the components are coupled: the choices of `Coupling`."""

    master: Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            help=(
                "jacobi, gauss-seidel, hermite or interface-jacobian; default: the master in the "
                "system, else gauss-seidel."
            ),
        ),
    ] = None
    order: Annotated[
        int | None,
        typer.Option(
            metavar="N",
            help="Order of the extrapolation of outputs over a step: 0 (held), 1, 2 or 3; default: 0 for"
            " jacobi and gauss-seidel, else 3.",
            parser=integer,
        ),
    ] = None
    passes: Annotated[
        int | None,
        typer.Option(
            metavar="N",
            help="hermite: largest number of passes over a step, at least 1; default: 8.",
            parser=integer,
        ),
    ] = None
    coupling_tolerance: Annotated[
        float | None,
        typer.Option(
            metavar="TOL",
            help="hermite: repeat a step while a signal changes by more than TOL times its magnitude (the"
            " nominal value, or the largest value so far); default: 1e-5, with --adaptive 0.3 of its TOL.",
            parser=number,
        ),
    ] = None
    correct: Annotated[
        bool,
        typer.Option("--correct", help="Correct the inputs by the extrapolation error of the previous step."),
    ] = False
    lag: Annotated[
        int | None,
        typer.Option(
            metavar="N",
            help="interface-jacobian: linearise the components every N steps; default: 1.",
            parser=integer,
        ),
    ] = None
    factor: Annotated[
        list[str] | None,
        typer.Option(
            metavar="COMPONENT=N",
            help="Number of internal steps of the component per communication step; repeatable; default: 1.",
        ),
    ] = None
    adaptive: Annotated[
        float | None,
        typer.Option(
            metavar="TOL",
            help="Adapt the step so that the estimated error of each signal stays below TOL times its"
            " magnitude (the nominal value, or the largest value so far), such as 1e-3; default: equal"
            " steps.",
            parser=number,
        ),
    ] = None
    control: Annotated[
        str | None,
        typer.Option(
            metavar="WHAT",
            help=(
                "With --adaptive: what TOL limits: error (of the signals) or energy (the power "
                "error of the power bonds); default: error."
            ),
        ),
    ] = None
    guard: Annotated[
        float | None,
        typer.Option(
            metavar="TOL",
            help=(
                "Without --adaptive: divide a step if the estimated error of a signal exceeds TOL "
                "times its magnitude, or if the scenario has a corner inside the step; all "
                "components must be able to restore their states; 0: never; default: 0.01 for "
                "hermite and interface-jacobian, else 0."
            ),
            parser=number,
        ),
    ] = None
    smallest: Annotated[
        float | None,
        typer.Option(
            metavar="S",
            help="With --adaptive: shortest step [s], accepted with any error; default: 1e-7.",
            parser=seconds,
        ),
    ] = None
    largest: Annotated[
        float | None,
        typer.Option(metavar="S", help="With --adaptive: longest step [s]; default: 0.1.", parser=seconds),
    ] = None

    def given(self) -> dict[str, Any]:
        """The options that were given, by the field names of `Coupling`."""
        options = {f.name: getattr(self, f.name) for f in fields(self)}
        options["tolerance"] = options.pop("coupling_tolerance")
        options["factors"] = substeps(options.pop("factor") or []) or None
        options["correct"] = self.correct or None
        return {name: value for name, value in options.items() if value is not None}
