"""The command line `harvester`. Thin: each command imports what it needs when it runs."""

from __future__ import annotations

import sys
from io import TextIOWrapper
from pathlib import Path
from typing import Annotated, Any

import typer

from orchestrator.commands.coupled import Coupled
from orchestrator.commands.interrupt import ends_clean
from orchestrator.commands.options import Case, Steps, Swap, System
from orchestrator.commands.reading import seconds
from orchestrator.commands.spread import spread
from orchestrator.commands.texts import swaps
from orchestrator.errors import Problem

app = typer.Typer(
    add_completion=False,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)


INTERRUPTED = 130  # exit status, as of a shell
SYSTEM, BUILD = Path("build/harvester.ssp"), Path("build")
STUDY = BUILD / "convergence"


@app.callback()
def _group() -> None:
    """An electrohydraulic harvester as FMUs: build, co-simulate, validate."""


@app.command()
@spread
def run(
    *,
    system: System = SYSTEM,
    case: Case,
    steps: Steps,
    out: Annotated[
        Path, typer.Option(metavar="FILE", help="Where the trace goes (.csv or .parquet).")
    ] = BUILD / "trace.csv",
    error_estimate: Annotated[
        bool,
        typer.Option(
            "--error-estimate",
            help="Run again at half and at twice the step, or at a tenth of the tolerance of --adaptive;"
            " tell change and order.",
        ),
    ] = False,
    coupled: Coupled,
) -> None:
    """Co-simulate a system and record all its outputs and inputs."""
    from orchestrator.commands import commands

    options = case.options() | steps.options() | {"error_estimate": error_estimate}
    commands.run(system, case.scenario, out, coupling=coupled.given(), **options)


@app.command()
def build(
    model: Annotated[
        str | None,
        typer.Argument(
            metavar="MODEL",
            help="For an FMU whose code is Python: a file with a model of your own, such as my_actuator.py,"
            " or a subsystem, such as fmus.boom_stick:VARIANTS.lumped.",
        ),
    ] = None,
    out: Annotated[
        Path,
        typer.Option(
            metavar="DIR",
            help="Where the files go; those of FMI 3.0 to fmi3/ in it, those in Python to python/.",
        ),
    ] = BUILD,
    fmi: Annotated[
        str, typer.Option(metavar="VERSION", help="2, 3 or both; of a model in Python 2.")
    ] = "both",
    platform: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME",
            help="host (the default), all, or one such as x86_64-windows or aarch64-linux; repeatable.",
        ),
    ] = None,
    parameters: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Numbers in place of those of the parts (.toml), such as harvester identify writes.",
        ),
    ] = None,
) -> None:
    """Build the FMUs of the parts, of the whole, and harvester.ssp; or one of a model in Python."""
    from fmus.export.platforms import select
    from orchestrator.commands import commands

    versions = {"2": (2,), "3": (3,), "both": (2, 3)}
    if fmi not in versions:
        raise Problem(f"--fmi {fmi}: expected {', '.join(versions)}")
    platforms = select(platform or ["host"])
    commands.folder(out)
    if model is not None:
        from fmus.export.python.build import build_model

        if 2 not in versions[fmi]:
            raise Problem(f"--fmi {fmi}: expected 2, an FMU whose code is Python is one of FMI 2.0")
        if parameters is not None:
            raise Problem(f"--parameters {parameters}: a model of your own has its own numbers")
        print(build_model(model, out, platforms))
        return
    from fmus.build import build_machine

    for path in build_machine(out, versions[fmi], platforms, parameters):
        print(f"{path}  {path.stat().st_size / 1e3:.0f} kB")


@app.command()
def variants(
    system: Annotated[
        Path, typer.Argument(metavar="SYSTEM", help="The built system, to measure costs in.")
    ] = SYSTEM,
    combinations: Annotated[
        bool, typer.Option("--combinations", help="Run the work cycle with every combination of variants.")
    ] = False,
    out: Annotated[
        Path, typer.Option(metavar="FILE", help="Where the table of combinations goes (.csv).")
    ] = BUILD / "combinations.csv",
) -> None:
    """List the variants of each part with states, inputs, validity, and what they cost here."""
    from fmus.machine import FAMILIES
    from fmus.variants import lines, names
    from orchestrator.variety import command

    if combinations:
        joints = [f"manipulator.{joint}_speed" for joint in ("swing", "boom", "stick")]
        if not command.table(system, {part: list(family) for part, family in FAMILIES.items()}, joints, out):
            raise typer.Exit(1)
        return
    print("\n".join(lines(command.costs(system, names()) if system.exists() else {})))
    if not system.exists():
        print(f"{system} is not built: no costs measured; make it with: harvester build")


@app.command()
def parameters(
    subsystem: Annotated[
        str | None,
        typer.Argument(
            help="A part or a variant of it, such as swing or swing_detailed; default: the machine"
        ),
    ] = None,
    source: Annotated[
        str | None,
        typer.Option(metavar="WORD", help="Only numbers with this source, such as paper or assumed."),
    ] = None,
) -> None:
    """Print the numbers of the model with unit, source and note."""
    from fmus.provenance import show

    show(subsystem, source)


@app.command()
def signals(
    system: System = SYSTEM,
    kind: Annotated[str | None, typer.Option(metavar="KIND", help="Only input, output or parameter.")] = None,
    swap: Swap = None,
) -> None:
    """List the variables of a system with unit and meaning."""
    from orchestrator.commands import commands

    commands.signals(system, kind, swaps(swap or []))


@app.command()
@spread
def validate(
    *,
    system: System = SYSTEM,
    reference: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE", help="Reference or measurement, .csv with .toml; default: the work cycle."
        ),
    ] = None,
    layout: Annotated[
        Path | None, typer.Option(metavar="FILE", help="What the report shows (.toml).")
    ] = None,
    play: Annotated[
        list[str] | None,
        typer.Option(
            metavar="PATTERN",
            help="Signals of the reference that go into the run beside its commands, such as"
            " '*.supply_pressure'; repeatable.",
        ),
    ] = None,
    case: Case,
    steps: Steps,
    out: Annotated[Path, typer.Option(metavar="DIR", help="Where run.csv and the report go.")] = BUILD,
    coupled: Coupled,
) -> None:
    """Co-simulate and compare with a reference. Writes a report; exit status 1 if a limit is missed."""
    from fmus.build import data
    from orchestrator.commands.validate import validate as judged

    usual = data("reference/work_cycle.csv"), data("reference/work_cycle.layout.toml")
    options = case.options() | steps.options() | {"coupling": coupled.given(), "play": play or ()}
    if not judged(system, case.scenario, reference, layout, out, usual=usual, **options):
        raise typer.Exit(1)


@app.command()
def compare(
    traces: Annotated[
        list[Path], typer.Argument(metavar="TRACE...", help="Two or more traces (.csv, .parquet) of runs.")
    ],
    against: Annotated[
        Path | None, typer.Option(metavar="FILE", help="The trace to compare with; default: the first.")
    ] = None,
    signals: Annotated[
        list[str] | None,
        typer.Option(
            metavar="PATTERN",
            help="What to show, such as '*_pressure*'; repeatable; default: speeds, pressures and angles."
            " The summary covers all signals.",
        ),
    ] = None,
    start: Annotated[
        float | None, typer.Option(metavar="T", help="Begin of the window [s].", parser=seconds)
    ] = None,
    stop: Annotated[
        float | None, typer.Option(metavar="T", help="End of the window [s].", parser=seconds)
    ] = None,
    out: Annotated[
        Path, typer.Option(metavar="DIR", help="Where comparison.png and comparison.json go.")
    ] = BUILD,
) -> None:
    """Compare traces of runs: difference of each signal from one of them, cost, and a picture."""
    from orchestrator.commands import commands

    commands.compare(traces, out, against=against, signals=signals or (), start=start, stop=stop)


@app.command()
@spread
def convergence(
    *,
    system: System = SYSTEM,
    reference: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Reference, .csv with .toml; default: of the harvester's work cycle its solution,"
            " of any other run the finest hermite run.",
        ),
    ] = None,
    steps: Annotated[
        str, typer.Option(metavar="S,S,...", help="Communication steps [s], with commas.")
    ] = "0.0005,0.001,0.002,0.005,0.01,0.02",
    masters: Annotated[
        str,
        typer.Option(
            metavar="NAME,...",
            help="Only these, such as jacobi, 'hermite 2 passes' or '*order 1'; default: all.",
        ),
    ] = "",
    signals: Annotated[
        list[str] | None,
        typer.Option(
            metavar="PATTERN",
            help="What to judge, such as '*_pressure*'; repeatable, one table each;"
            " default: speeds and pressures.",
        ),
    ] = None,
    case: Case,
    repeats: Annotated[
        int, typer.Option(metavar="N", help="How often each run is timed; the median counts.")
    ] = 3,
    out: Annotated[Path, typer.Option(metavar="DIR", help="Where numbers and pictures go.")] = STUDY,
) -> None:
    """Error over communication step for all masters, and what each costs: tables, numbers, pictures."""
    from fmus.build import data
    from orchestrator.convergence.command import convergence as study

    usually = data("reference/work_cycle.csv")
    options = case.options() | {"scenario": case.scenario, "usually": usually}
    study(system, reference, out, steps, masters, signals or (), repeats, **options)


@app.command()
def rig(
    out: Annotated[Path, typer.Option(metavar="DIR", help="Where the recordings go.")],
    machine: Annotated[
        str, typer.Option(metavar="NAME", help="lumped, the set of the paper, or detailed.")
    ] = "detailed",
    seed: Annotated[int, typer.Option(metavar="N", help="Of the noise; equal seeds give equal files.")] = 0,
) -> None:
    """Record the paper's experiments on a virtual test rig: CSV files as of a real one, but simulated."""
    from fmus.rig import command

    command.rig(out, machine, seed)


@app.command()
def identify(
    folder: Annotated[
        Path,
        typer.Argument(metavar="DIR", help="Recordings: data files, each with a .toml that describes it."),
    ],
    out: Annotated[Path, typer.Option(metavar="FILE", help="Where the parameters go (.toml).")] = Path(
        "parameters.toml"
    ),
    report: Annotated[
        Path, typer.Option(metavar="DIR", help="Where identification.html and .json go.")
    ] = BUILD,
    joint: Annotated[
        bool, typer.Option("--joint/--no-joint", help="Refine all together, if the machine was recorded.")
    ] = True,
    inertia: Annotated[
        bool, typer.Option("--inertia", help="Estimate inertial parameters from joint motion, too.")
    ] = False,
    free: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME",
            help="What the joint refinement may change; repeatable; default: what a work cycle shows.",
        ),
    ] = None,
    starts: Annotated[
        int,
        typer.Option(metavar="N", help="Refine again from N random starts: do they lead to the same result?"),
    ] = 4,
) -> None:
    """Find the machine's parameters from recordings: the paper's procedures, then all together."""
    from fmus.identification.command import run as identified
    from fmus.identification.machine import FREE
    from orchestrator.commands import commands

    commands.folder(out.parent)
    commands.folder(report)
    identified(folder, out, report, joint=joint, inertial=inertia, names=tuple(free or FREE), starts=starts)


@app.command()
def check(
    fmu: Annotated[Path | None, typer.Argument(metavar="FILE", help="Any .fmu file.")] = None,
    for_: Annotated[
        str,
        typer.Option(
            "--for", metavar="TOOL", help="simulink, dymola, openmodelica, amesim, another, or any."
        ),
    ] = "any",
    json: Annotated[
        Path | None, typer.Option(metavar="OUT", help="Write the findings to a file, for programs.")
    ] = None,
    static: Annotated[bool, typer.Option("--static", help="Run nothing of the FMU.")] = False,
    timeout: Annotated[
        float, typer.Option(metavar="SECONDS", help="A call into the FMU that takes longer is a hang.")
    ] = 10.0,
    rules: Annotated[bool, typer.Option("--rules", help="Print the table of rules.")] = False,
) -> None:
    """Tell what is wrong with an FMU, and for which tool. Exit status 1 if there are errors."""
    from orchestrator.check import command

    if not command.run(fmu, for_, json, rules, static, timeout):
        raise typer.Exit(1)


def main(arguments: list[str] | None = None) -> int:
    """Run the command line; a mistake becomes one line on stderr and exit status 2."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper):
            stream.reconfigure(errors="replace")  # a console that lacks the sign of a unit shows another one
    try:
        with ends_clean():
            status: Any = app(args=arguments, prog_name="harvester", standalone_mode=False)
    except KeyboardInterrupt:
        return _stopped()
    except Exception as error:
        return _stopped() if isinstance(error.__cause__, KeyboardInterrupt) else _told(error)
    if status == INTERRUPTED:  # some versions of the command-line library swallow the interrupt itself
        return _stopped()
    return status if isinstance(status, int) else 0


def _stopped() -> int:
    print("harvester: interrupted", file=sys.stderr)
    return INTERRUPTED


def _told(error: Exception) -> int:
    """Tell a user's mistake or a refusal of the operating system in one line; re-raise defects."""
    contract = sys.modules.get("fmus.contract")  # there if the models were used
    mistakes = (Problem,) if contract is None else (Problem, contract.ModelError)
    show, message = getattr(error, "show", None), str(error)  # of the command-line library: show()
    if show is not None:
        message = error.format_message()  # type: ignore[attr-defined]
        if "\n" in message:  # no command given: its message is the help
            show()
            return 2
        context = getattr(error, "ctx", None)
        message = f"{message.rstrip('.')}; see {context.command_path if context else 'harvester'} --help"
    elif isinstance(error, OSError) and error.filename:
        message = f"{error.filename}: {error.strerror}"
    elif not isinstance(error, mistakes):
        raise error
    print(f"harvester: {message}", file=sys.stderr)
    return 2


if __name__ == "__main__":
    sys.exit(main())
