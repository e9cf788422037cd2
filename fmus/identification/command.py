"""The command `harvester identify`: a folder of recordings becomes parameters.toml and a page."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from time import perf_counter

from fmus.identification.known import Finding
from fmus.identification.machine import FREE
from fmus.identification.outcome import beside, content, worst
from fmus.identification.pipeline import MACHINE, identify
from fmus.identification.recordings.clock import evenly, thinned
from fmus.identification.recordings.reading import left_out, read_folder
from fmus.identification.refinement.problem import parameters, signals
from fmus.identification.report import wording
from fmus.identification.report.comparison import Compared
from fmus.identification.report.identification_page import faults, quality, write_page
from fmus.identification.report.wording import warnings
from fmus.parameters import write
from orchestrator.base.errors import Problem
from orchestrator.base.units import display


def run(
    folder: Path,
    out: Path,
    page: Path,
    *,
    joint: bool = True,
    inertial: bool = False,
    names: Sequence[str] = FREE,
    starts: int = 0,
) -> None:
    """Read, identify, write the parameters and the page; prints what happens.

    out    parameters.toml to write
    page   folder of identification.html and .json

    An interrupt writes the parameters that were found until then, and goes on as one.
    """
    if out.suffix != ".toml":
        raise Problem(f"--out {out}: expected a file that ends in .toml")
    begun = perf_counter()
    recordings = read_folder(folder)
    qualities = [quality(r) for r in recordings]
    seconds = sum(float(r.time[-1] - r.time[0]) for r in recordings)
    print(f"{folder}: {len(recordings)} recordings, {seconds:.0f} s")
    for line in (*faults(qualities), *left_out(folder, recordings)):
        print(f"  {line}")
    recordings = [thinned(evenly(r)) if r.procedure == MACHINE else evenly(r) for r in recordings]
    found = identify(
        recordings, joint=joint, inertial=inertial, names=names, starts=starts, tell=print, show=_show
    )
    tables = {"parameters": {name: e.number() for name, (e, _) in sorted(found.estimates.items())}}
    out.parent.mkdir(parents=True, exist_ok=True)
    write(out, tables)
    if found.interrupted:
        count = len(tables["parameters"])
        print(f"{out}: {count} parameter{'s' * (count > 1)}, as found until the interrupt; no report")
        raise KeyboardInterrupt
    print(f"{out}: {len(tables['parameters'])} parameters with their 95 % intervals")
    shown = beside(found)
    told_page = content(folder, out, found, shown, qualities)
    for line in () if shown is None else _predicted(shown):
        print(line)
    if told_page.explanation:
        print(told_page.explanation.verdict)
    for line in warnings(found.refined, parameters(), signals()) if found.refined else ():
        print(f"warning: {line}")
    html, data = write_page(page, told_page)
    print(f"report: {html}\nnumbers: {data}\n{perf_counter() - begun:.0f} s")


def _show(finding: Finding) -> None:
    """What a procedure found, a line for each parameter in the unit that a person reads."""
    print(f"{finding.procedure}:")
    for e in finding.estimates:
        unit, factor = display(e.unit) or (e.unit, 1.0)  # in ASCII: no terminal has to know superscripts
        value, low, high = (f"{factor * x:.{wording.digits(e)}g}" for x in (e.value, e.low, e.high))
        print(f"  {e.name:<38}{value:>12}  ({low} to {high}) {unit}")


def _predicted(shown: Compared) -> Iterator[str]:
    """How well the recording is predicted, the worst signal of each kind."""
    use = "held out" if shown.recording.use == "test" else "used for fitting"
    yield f"predicted: {shown.recording.source.name}, {use}; NRMSE of the worst signal of each kind"
    for kind, (name, error) in worst(shown).items():
        yield f"  {kind:<10}{100 * error:5.2f} %  {name}"
