"""Recordings of the rig: a folder with NAME.csv and NAME.toml of each experiment, and a README.md.

docs/reference-traces.md describes the format; the README says how the recordings were made, with which
instruments, and that they are simulated.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from pathlib import Path
from time import perf_counter

import numpy as np

from fmus.rig import instruments
from fmus.rig.benches import TOLERANCE
from fmus.rig.experiments import EXPERIMENTS, MACHINES, experiments
from fmus.rig.instruments import Condition, Experiment, Instrument, record
from orchestrator.base.errors import Problem
from orchestrator.base.files import write_columns

DIGITS = 12  # significant; every step of every converter comes back exactly, a command to 1e-11 V
DATE = "2026-11-20"  # of the last change of rig or model that changes recordings ...
CHANGE = "first version"  # ... and why
# what `harvester validate` asks of a prediction of what was held out, NRMSE by group; others are only shown
LIMITS = {"angle": 0.01, "pressure": 0.1}
# one line feeds both drives, so one sensor knows the pressure of both
SHARED = {"swing.supply_pressure": ("boom_stick.supply_pressure",)}
README = "README.md"
HEADING = "# Recordings of the virtual test rig"

_TEXT = """{heading}

**Simulated.** No machine was measured: the signals come from the project's own equations, with the noise
and the converters of instruments added. They stand in for the paper's recordings, which are not public.

| | |
|---|---|
| machine | {machine}: {variants} |
| seed of the noise | {seed} |
| made by | `harvester rig --machine {machine} --seed {seed} --out DIR` |
| rate | 200 Hz, raw: no filter |

Each NAME.csv is described by its NAME.toml: what was done, the columns with their units, the instruments.

| files | experiment (paper, section 4) |
|---|---|
| valve_pa, valve_bt, valve_pb, valve_at | (a) one metering edge of the valve at stepped commands |
| hose_resistance | (b) the 4 m hose at stepped flows |
| hose_dynamics_1 to _4 | (c) the same hose, fast changes: four groups |
| motor_leakage_1, _2 | (d) the swing motor, shaft locked, pressure stepped at port A, then at port B |
| damping_JOINT_1, _2 | (d) the machine, one joint moves |
| machine_train_1, _2 | the machine, all axes move |
| machine_test | section 5: a work cycle, held out from fitting (`use = "test"`) |

| instrument | noise (standard deviation) | step | range | reads 0 below |
|---|---|---|---|---|
{table}

Commands are what the computer sent: known exactly. White noise, a step of the converter, a range and a
dead zone are all that the instruments do: they have no error of zero or gain, no delay and no drift, dead
zones have sharp ends, and the clock is exact. Real instruments are worse.
"""


def write_all(out: Path, machine: str, seed: int, report: Callable[[str], None] = print) -> None:
    """Simulate the experiments on a machine and write what the instruments record; reports each."""
    if machine not in MACHINES:
        raise Problem(f"--machine {machine}: expected {' or '.join(MACHINES)}")
    if seed < 0:
        raise Problem(f"--seed {seed}: expected 0 or more")
    _ready(out)
    begun = perf_counter()
    report(f"virtual test rig, {machine} machine ({MACHINES[machine]}), seed {seed}")
    (out / README).write_text(readme(machine, seed), encoding="utf-8", newline="\n")
    for experiment in experiments(machine):
        csv, _ = write(out, experiment, seed)
        report(f"{csv}  {experiment.time[-1]:.1f} s, {len(experiment.signals)} signals: {experiment.title}")
    report(f"{len(EXPERIMENTS)} recordings with their descriptions in {out}, {perf_counter() - begun:.0f} s")


def _ready(out: Path) -> None:
    """Refuses a folder that cannot be written, or that holds something else than recordings of a rig."""
    try:
        out.mkdir(parents=True, exist_ok=True)
        held = sorted(path.name for path in out.iterdir())
    except OSError as error:
        raise Problem(f"{out}: expected a folder, and none can be made: {error.strerror}") from None
    if not os.access(out, os.W_OK | os.X_OK):
        raise Problem(f"{out}: expected a folder to write to, got no permission")
    of_a_rig = README in held and (out / README).read_bytes().startswith(HEADING.encode())
    if held and not of_a_rig:
        raise Problem(f"{out}: expected an empty folder or one of the rig, found {held[0]} in it")


def readme(machine: str, seed: int) -> str:
    """The text for one folder of recordings."""
    shown = (instruments.PRESSURE, instruments.FLOW, instruments.LEAKAGE, instruments.ANGLE)
    return _TEXT.format(
        heading=HEADING,
        machine=machine,
        variants=MACHINES[machine],
        seed=seed,
        table="\n".join(map(_row, shown)),
    )


def _row(i: Instrument) -> str:
    ends = f"{i.low:g} to {i.high:.6g} {i.unit}" if i.high < float("inf") else "none"
    dead = f"{i.dead_zone:g} {i.unit}" if i.dead_zone else "-"
    return f"| {i.text} | {i.noise:g} {i.unit} | {i.step:.4g} {i.unit} | {ends} | {dead} |"


def write(folder: Path, experiment: Experiment, seed: int) -> tuple[Path, Path]:
    """Write one recording; the paths of the table and of what describes it."""
    readings = record(experiment, seed)
    csv, toml = (folder / f"{experiment.name}.{ending}" for ending in ("csv", "toml"))
    write_columns(csv, ("time", *readings), np.column_stack([experiment.time, *readings.values()]), DIGITS)
    toml.write_text(f"{description(experiment, seed)}\n", encoding="utf-8", newline="\n")
    return csv, toml


def description(experiment: Experiment, seed: int) -> str:
    """The text of the TOML."""
    source = f"virtual test rig (fmus/rig), {experiment.machine} machine, noise of seed {seed}"
    judged = experiment.use == "test"
    groups = dict.fromkeys(map(_group, experiment.signals)) if judged else {}
    tables: dict[str, dict[str, str]] = {
        "reference": {
            "title": json.dumps(experiment.title),
            "kind": '"simulation"',
            "origin": f'"{source}; simulated, no machine was measured"',
            "made_by": f'"harvester rig --machine {experiment.machine} --seed {seed} --out DIR"',
            "solver": '"CVODES (BDF), exact Jacobian, restarted at the corners of the commands"',
            "relative_tolerance": f"{TOLERANCE:g}",
            "date": DATE,
            "change": json.dumps(CHANGE),
        },
        "experiment": {
            "procedure": f'"{experiment.procedure}"',
            "use": f'"{experiment.use}"',
            **{name: _condition(condition) for name, condition in experiment.conditions.items()},
        },
        "time": {"unit": '"s"'},
    }
    if judged:
        tables["tolerances"] = {
            group: f'{{ metric = "nrmse", limit = {LIMITS[group]} }}' if group in LIMITS else '"none"'
            for group in groups
        }
    for name in experiment.signals:
        about = ({"group": f'"{_group(name)}"'} if judged else {}) | _sensor(experiment.instruments[name])
        tables[f"signals.{json.dumps(name)}"] = about
        for other in SHARED.get(name, ()):
            tables[f"signals.{json.dumps(other)}"] = {"column": json.dumps(name)} | about
    blocks = (
        "\n".join([f"[{head}]", *(f"{key} = {value}" for key, value in table.items())])
        for head, table in tables.items()
    )
    return "\n\n".join(blocks)


def _group(signal: str) -> str:
    """What kind of signal it is; the supply is given to the machine, not predicted."""
    words = signal.partition(".")[2].split("_")
    kind = next(w for w in reversed(words) if w in ("command", "pressure", "angle", "flow"))
    return "supply" if words[0] == "supply" else kind


def _condition(condition: Condition) -> str:
    if isinstance(condition, str):
        return json.dumps(condition)
    value, unit = condition
    return f"{{ value = {value!r}, unit = {json.dumps(unit)} }}"


def _sensor(instrument: Instrument) -> dict[str, str]:
    """The unit of the column, and the instrument if there is one."""
    about = {"unit": f'"{instrument.unit}"'}
    if instrument.text:
        about |= {
            "sensor": json.dumps(instrument.text),
            "noise": repr(instrument.noise),
            "resolution": repr(instrument.step),
        }
        if np.isfinite([instrument.low, instrument.high]).all():
            about["span"] = f"[{instrument.low!r}, {instrument.high!r}]"
        about["dead_zone"] = repr(instrument.dead_zone)
    return about
