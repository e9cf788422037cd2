"""`python -m benchmarks.peers`: measures, prints the tables, writes build/peers.json, .csv and .png."""

from __future__ import annotations

import argparse
import json
import tempfile
from collections.abc import Sequence
from pathlib import Path

from rich.console import Console
from rich.progress import track

from benchmarks.peers.cases import Case, cases
from benchmarks.peers.figure import draw, write_csv
from benchmarks.peers.inside import inside
from benchmarks.peers.machine import describe
from benchmarks.peers.measure import Job, jobs
from benchmarks.peers.report import plain, table
from benchmarks.peers.settings import SETTINGS, Setting
from benchmarks.peers.tools import find, left_out
from orchestrator.base.errors import Problem
from orchestrator.base.extras import require

NOTES = """\
us/step: {clock} time of a communication step of 1 ms, the loop over the steps alone, median of the runs,
with all coupling signals recorded as each tool does it (not rec.: without). Then the error over the step.
ms/s: time for a simulated second at the step that gives the error in the heading. Recording: FMPy all
connectors in memory, Ecos a CSV file of six decimals, libcosim a time series in memory, ours in memory
with the accuracy card."""


def main() -> None:
    """Measure what was asked for."""
    asked = _arguments()
    try:
        require("reference", "the exact solution, from which the errors are measured,", "sksundae")
    except Problem as problem:
        raise SystemExit(f"benchmarks.peers: {problem}") from None
    console = Console(width=max(190, Console().width), markup=False, highlight=False)
    settings = [s for s in SETTINGS if not asked.only or any(word in s.label for word in asked.only)]
    settings = _installed(settings, console)
    about = describe()
    console.print(
        "\n".join(f"{name}: {value}" for name, value in about.items()),
        NOTES.format(clock=asked.clock),
        sep="\n\n",
    )
    told = {"machine": about, "repeats": asked.repeats, "clock": asked.clock, "cases": {}}
    measured = []
    with tempfile.TemporaryDirectory() as folder:
        for case in cases(Path(folder), asked.foreign and asked.foreign.resolve(), asked.case or ()):
            todo: list[Job] = list(jobs(case, settings, asked.clock))
            told["cases"][case.name] = _measured(case, settings, todo, asked.repeats, console)
            measured.append((case, todo))
    files = [asked.out.with_suffix(suffix) for suffix in (".json", ".csv", ".png")]
    asked.out.parent.mkdir(parents=True, exist_ok=True)
    files[0].write_text(json.dumps(told, indent=1, default=str), encoding="utf-8")
    draw(write_csv(measured, files[1]), files[2])
    console.print("written:", *files)


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument(
        "--clock", choices=("wall", "cpu"), default="wall", help="cpu: for a machine that others use"
    )
    parser.add_argument(
        "--case", action="append", help="wired, cut, m1, oscillator, motor or truck; all by default"
    )
    parser.add_argument("--foreign", type=Path, help="folder of the FMUs of motor and truck: see others.py")
    parser.add_argument("--only", action="append", help="a part of the names of settings; all by default")
    parser.add_argument(
        "--out",
        type=Path,
        default=Path("build/peers.json"),
        help="systems that are not run stay in the .csv",
    )
    return parser.parse_args()


def _installed(settings: Sequence[Setting], console: Console) -> list[Setting]:
    """Those whose tool can be loaded; the others are told."""
    missing = {}
    for tool in dict.fromkeys(s.tool for s in settings):
        try:
            find(tool)
        except (ImportError, OSError) as reason:
            missing[tool] = reason
            console.print(left_out(tool, reason))
    return [s for s in settings if s.tool not in missing]


def _measured(
    case: Case, settings: Sequence[Setting], todo: Sequence[Job], repeats: int, console: Console
) -> dict[str, object]:
    """All runs of a case; its table is printed."""
    for _ in track(range(repeats), description=case.name, console=console, transient=True):
        for job in todo:
            job.repeat()
    found = {s.label: [job for job in todo if job.setting is s] for s in settings}
    console.print(table(case, settings, found))
    if not case.own:
        return plain(case, settings, found)
    spent = inside(case)
    parts = ", ".join(f"{part} {time:.2f}" for part, time in spent.items())
    console.print(f"inside the FMUs, us per step, called from C: {sum(spent.values()):.2f} ({parts})\n")
    return {**plain(case, settings, found), "inside_us_per_step": spent}


if __name__ == "__main__":
    main()
