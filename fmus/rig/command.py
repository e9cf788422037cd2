"""The command `harvester rig`: all experiments on one machine, recorded into a folder."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from time import perf_counter

from fmus.rig.experiments import MACHINES, PLANS, each
from fmus.rig.writing import HEADING, readme, write
from orchestrator.base.errors import Problem

README = "README.md"


def rig(out: Path, machine: str, seed: int, tell: Callable[[str], None] = print) -> None:
    """Simulate the experiments on a machine and write what the instruments record; tells of each."""
    if machine not in MACHINES:
        raise Problem(f"--machine {machine}: expected {' or '.join(MACHINES)}")
    if seed < 0:
        raise Problem(f"--seed {seed}: expected 0 or more")
    _ready(out)
    begun = perf_counter()
    tell(f"virtual test rig, {machine} machine ({MACHINES[machine]}), seed {seed}")
    (out / README).write_text(readme(machine, seed), encoding="utf-8", newline="\n")
    for experiment in each(machine):
        csv, _ = write(out, experiment, seed)
        tell(f"{csv}  {experiment.time[-1]:.1f} s, {len(experiment.signals)} signals: {experiment.title}")
    tell(f"{len(PLANS)} recordings with their descriptions in {out}, {perf_counter() - begun:.0f} s")


def _ready(out: Path) -> None:
    """Refuses a folder that cannot be written, or that holds something else than recordings of a rig."""
    try:
        out.mkdir(parents=True, exist_ok=True)
        held = sorted(path.name for path in out.iterdir())
    except OSError as error:
        raise Problem(f"{out}: expected a folder, and none can be made: {error.strerror}") from None
    if not os.access(out, os.W_OK | os.X_OK):
        raise Problem(f"{out}: expected a folder to write to, got no permission")
    if held and not _of_a_rig(out / README):
        raise Problem(f"{out}: expected an empty folder or one of the rig, found {held[0]} in it")


def _of_a_rig(readme: Path) -> bool:
    return readme.is_file() and readme.read_bytes().startswith(HEADING.encode())
