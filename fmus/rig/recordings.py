"""Writes the recordings of the rig: a folder with NAME.csv and NAME.toml of each experiment, and a README.md.

docs/recordings.md describes the format. The README contains the experiments, the instruments and the command,
and states that the recordings are simulated.
"""

import os
from collections.abc import Callable
from dataclasses import replace
from datetime import date
from functools import partial
from importlib.resources import files
from pathlib import Path
from time import perf_counter
from typing import Literal

import numpy as np

from fmus.rig.benches import TOLERANCE
from fmus.rig.experiments import EXPERIMENTS, LISTED, MACHINES, Experiment, experiment, record
from orchestrator.base.errors import Problem
from orchestrator.base.files import Location, write_columns, write_whole
from orchestrator.base.processes import mapping
from orchestrator.data.description import Description, Origin, SignalDescription, Tolerance, write_description

DIGITS = 12  # significant digits: readings are exact to the resolution of each converter, commands to 1e-11 V
DATE = date(2026, 11, 25)  # date of the last change of rig or model that changes recordings
CHANGE = "pressure of the return line recorded; 4 bar in that of the detailed machine"  # reason of that
LIMITS = {"angle": 0.01, "pressure": 0.1}  # NRMSE by group, for `harvester validate` on test recordings
# signal -> other signals with the same sensor: both drives have the same supply and return line
SHARED = {f"swing.{line}_pressure": (f"boom_stick.{line}_pressure",) for line in ("supply", "tank")}
SECONDS = {"lumped": 25, "detailed": 180}  # machine -> processor time of all experiments [s], roughly
MANY = 4  # experiments that are worth the start of a process
README = "README.md"
HEADING = "# Recordings of the virtual test rig"


def write_all(
    out: Path, machine: str, seed: int, report: Callable[[str], None] = print, processes: int = 1
) -> None:
    """Simulate the experiments on a machine and write their recordings; `report` gets a line for each.

    processes   number of processes that simulate; the files are the same with any number
    """
    if machine not in MACHINES:
        raise Problem(f"--machine {machine}: expected {' or '.join(MACHINES)}")
    if seed < 0:
        raise Problem(f"--seed {seed}: expected 0 or more")
    _check_folder(out)
    start = perf_counter()
    processes = min(processes, len(EXPERIMENTS) // MANY)
    report(f"virtual test rig, {machine} machine ({MACHINES[machine]}), seed {seed}")
    cores = f" on {processes} cores" * (processes > 1)
    report(f"  takes about {SECONDS[machine]} s of processor time{cores}")
    write_whole(out / README, readme(machine, seed))
    with mapping(processes) as each:
        for line in each(partial(_write_named, out, machine, seed), EXPERIMENTS):
            report(line)
    report(f"{len(EXPERIMENTS)} recordings with their descriptions in {out}, {perf_counter() - start:.0f} s")


def _write_named(out: Path, machine: str, seed: int, name: str) -> str:
    """Simulate and write one experiment; a line about it."""
    done = experiment(name, machine)
    csv, _ = write(out, done, seed)
    return f"{csv}  {done.time[-1]:.1f} s, {len(done.signals)} signals: {done.title}"


def _check_folder(out: Path) -> None:
    """Make the folder; Problem if it is not writable or contains anything except recordings of the rig."""
    try:
        out.mkdir(parents=True, exist_ok=True)
        names = sorted(path.name for path in out.iterdir())
    except OSError as error:
        raise Problem(f"{out}: expected a folder, got {error.strerror}") from None
    if not os.access(out, os.W_OK | os.X_OK):
        raise Problem(f"{out}: expected a folder to write to, got no permission")
    has_recordings = README in names and Location(out / README).text().startswith(HEADING)
    if names and not has_recordings:
        raise Problem(f"{out}: expected an empty folder or one of the rig, got a folder with {names[0]}")


def readme(machine: str, seed: int) -> str:
    """The content of README.md."""
    text, table = (files("fmus.rig") / "README.template").read_text(encoding="utf-8"), ""
    for i in LISTED:
        span = f"{i.span[0]:g} to {i.span[1]:.6g} {i.unit}" if i.span else "none"
        zone = f"{i.dead_zone:g} {i.unit}" if i.dead_zone else "-"
        table += f"\n| {i.sensor} | {i.noise:g} {i.unit} | {i.resolution:.4g} {i.unit} | {span} | {zone} |"
    known = {"heading": HEADING, "machine": machine, "variants": MACHINES[machine], "seed": seed}
    return text.format(**known, table=table.strip())


def write(folder: Path, experiment: Experiment, seed: int) -> tuple[Path, Path]:
    """Write one recording; returns the paths of the CSV file and of its description."""
    readings = record(experiment, seed)
    csv, toml = (folder / f"{experiment.name}.{suffix}" for suffix in ("csv", "toml"))
    write_columns(csv, ("time", *readings), np.column_stack([experiment.time, *readings.values()]), DIGITS)
    write_description(toml, description(experiment, seed))
    return csv, toml


def description(experiment: Experiment, seed: int) -> Description:
    """The content of NAME.toml; a test recording also has groups of signals with limits."""
    source = f"virtual test rig (fmus/rig), {experiment.machine} machine, noise of seed {seed}"
    signals: dict[str, SignalDescription] = {}
    limits: dict[str, Tolerance | Literal["none"]] = {}
    for name in experiment.signals:
        signals[name] = experiment.instruments[name]
        if experiment.use == "test":
            group = _group(name)
            limits[group] = Tolerance("nrmse", LIMITS[group]) if group in LIMITS else "none"
            signals[name] = replace(signals[name], group=group)
        signals |= {other: replace(signals[name], column=name) for other in SHARED.get(name, ())}
    return Description(
        signals,
        reference=Origin(
            title=experiment.title,
            kind="simulation",
            origin=f"{source}; simulated, no machine was measured",
            made_by=f"harvester rig --machine {experiment.machine} --seed {seed} --out DIR",
            solver="CVODES (BDF), exact Jacobian, restarted at the corners of the commands",
            relative_tolerance=TOLERANCE,
            date=DATE,
            change=CHANGE,
        ),
        experiment={"procedure": experiment.procedure, "use": experiment.use, **experiment.conditions},
        tolerances=limits,
    )


def _group(signal: str) -> str:
    """The group of a signal: the supply, whose lines are inputs of the model, or its physical quantity."""
    words = signal.partition(".")[2].split("_")
    quantity = next(w for w in reversed(words) if w in ("command", "pressure", "angle", "flow"))
    return "supply" if words[0] in ("supply", "tank") else quantity
