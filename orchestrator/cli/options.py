"""The application `harvester`, commands from the declarations of their options, and the default system."""

from __future__ import annotations

import re
from collections.abc import Mapping
from functools import partial, wraps
from inspect import Parameter, Signature, signature
from pathlib import Path
from typing import Annotated, Any, TypeAlias, get_args, get_type_hints

import typer

from orchestrator.base.errors import Problem
from orchestrator.base.files import SYSTEMS, find, require_system, tell_once
from orchestrator.base.options import Declared, F, Kind, declarations, declared, option_texts, text_and_rows
from orchestrator.engine.options import CaseOptions

BUILD = Path("build")
SYSTEM = BUILD / "harvester.ssp"

File: TypeAlias = Annotated[Path, Kind("FILE")]
Folder: TypeAlias = Annotated[Path, Kind("DIR")]
Time: TypeAlias = Annotated[float | None, Kind("T", "s")]
Text: TypeAlias = Annotated[str, Kind("NAME")]
System: TypeAlias = Annotated[
    Path | None,
    Kind(
        "SYSTEM",
        positional=True,
        text="An .ssp, .ssd or .fmu file; default: build/harvester.ssp, else the one in the installed"
        " package.",
    ),
]
Scenario: TypeAlias = Annotated[
    Path | None,
    Kind(
        "FILE",
        text="Inputs over time (.csv, .parquet, .mat, .mf4, .tdms); default: those in the system, such as"
        " the work cycle in harvester.ssp; for validate `reference`: the commands of the reference.",
    ),
]


app = typer.Typer(no_args_is_help=True, pretty_exceptions_enable=False, rich_markup_mode=None)


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


def command(function: F) -> F:
    """Decorator: a command of `harvester`.

    Its options are the parameters and the groups of a function. Their help is in the docstrings. The exit
    status is the number that the function returns, or 1 for False.
    """
    hints = get_type_hints(function, include_extras=True)
    (text, rows), options, defaults = text_and_rows(function), dict[str, Declared](), dict[str, Any]()
    texts = {**option_texts(CaseOptions), **rows}
    for name, parameter in signature(function).parameters.items():
        if parameter.kind is Parameter.VAR_KEYWORD:
            (group,) = get_args(hints[name])
            options |= declarations(group)
            texts |= {**option_texts(group), **rows}
        else:
            options[name], defaults[name] = declared(hints[name]), parameter.default
    parameters = []
    for name, option in options.items():
        default = defaults.get(name, False if bool in option.types else None)
        text_of_option = _help(option, texts.get(name.strip("_")) or texts.get(name), options)
        annotation = _annotation(name, option, default, text_of_option)
        parameters.append(Parameter(name, Parameter.KEYWORD_ONLY, default=default, annotation=annotation))

    @wraps(function)
    def flat_command(**values: object) -> None:
        given = {name: _value(name, option, values[name]) for name, option in options.items()}
        chosen = {n: v for n, v in given.items() if n in defaults or v or (v == 0 and v is not False)}
        status = function(**chosen)
        code = int(not status) if isinstance(status, bool) else status
        if code:
            raise typer.Exit(code)

    flat_command.__doc__ = text
    flat_command.__signature__ = Signature(parameters)  # type: ignore[attr-defined]
    flat_command.__annotations__ = {p.name: p.annotation for p in parameters}
    app.command()(flat_command)
    return function


def _flags(name: str, option: Declared) -> tuple[str, ...]:
    return option.kind.flags or (f"--{name.strip('_').replace('_', '-')}",)


def _help(option: Declared, text: str | None, options: Mapping[str, Declared]) -> str:
    """The text of an option with the flags of the options that it names."""
    text = re.sub(
        r"`(\w+)`",
        lambda found: _flags(found[1], options[found[1]])[0] if found[1] in options else found[0],
        text or option.kind.text,
    )
    return f"{text} Repeatable." if text and option.repeatable and not option.kind.positional else text


def _annotation(name: str, option: Declared, default: Any, text: str) -> Any:
    """The parameter of the command-line library."""
    kind, flags = option.kind, _flags(name, option)
    settings: dict[str, Any] = {"help": text, "metavar": kind.word or None}
    if bool in option.types:
        both = f"{flags[0]}/--no-{flags[0][2:]}" if default else flags[0]
        return Annotated[bool, typer.Option(both, help=text)]
    if option.repeatable:
        type_: Any = list[Path] if any(Path in get_args(t) for t in option.types if t != Any) else list[str]
    else:
        type_ = option.numeric or (Path if Path in option.types else str)
    if option.numeric or option.choices:
        settings["parser"] = partial(_read, option)
    made = typer.Argument(**settings) if kind.positional else typer.Option(*flags, **settings)
    return Annotated[type_ | None if default is None else type_, made]


def _read(option: Declared, text: str) -> Any:
    """Parse a text; the command-line library puts the name of the option before the message."""
    try:
        return option.read(text)
    except ValueError as expected:
        raise typer.BadParameter(f"expected {expected}, got {text!r}") from None


def _value(name: str, option: Declared, value: Any) -> Any:
    """The value of an option: texts NAME=VALUE as a mapping, several values as a tuple."""
    if option.mapping is None:
        return tuple(value or ()) if option.repeatable else value
    (flag, *_), form = _flags(name, option), option.kind.form
    convert = option.mapping if option.mapping in (int, float) else str
    values = dict[str, str]()
    for text in value or ():
        key, equals, word = (part.strip() for part in text.partition("="))
        if not equals or not key:
            raise Problem(f"{flag} {text}: expected {form}")
        if values.setdefault(key, word) != word:
            raise Problem(f"{flag} {text}: {key} already has the value {values[key]}")
    try:
        return {key: convert(word) for key, word in values.items()}
    except ValueError:
        raise Problem(f"{flag} {', '.join(f'{k}={v}' for k, v in values.items())}: expected {form}") from None


def tell_built(system: Path, swapped: Mapping[str, str | Path]) -> None:
    """Print which file of parameters the FMUs of a system were built with, if they were."""
    from orchestrator.ssp.load import configured
    from orchestrator.ssp.provenance import built_notes

    for note in built_notes(configured(require_system(system), swap=swapped)):
        print(note, flush=True)


def system_file(chosen: Path | None, name: str = SYSTEM.name) -> Path:
    """The system that the user names, else build/NAME, here, of the checkout or in the package, with a line.

    If there is none, the path, which the caller then reports as missing.
    """
    found, other = find(chosen or BUILD / name, SYSTEMS), find(chosen or name, SYSTEMS)
    if found.exists() or not other.exists():
        return found
    tell_once(f"{found} does not exist; using {other}")
    return other
