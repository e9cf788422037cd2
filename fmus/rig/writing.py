"""The README.md beside the recordings: what they are, how they were made, with which instruments.

Writes a recording: NAME.csv and NAME.toml, as docs/reference-traces.md describes them.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from fmus.rig import instruments
from fmus.rig.benches import TOLERANCE
from fmus.rig.experiments import MACHINES
from fmus.rig.instruments import Instrument
from fmus.rig.recording import Condition, Experiment, record
from orchestrator.base.files import write_columns

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


DIGITS = 12  # significant; every step of every converter comes back exactly, a command to 1e-11 V
DATE = "2026-11-20"  # of the last change of rig or model that changes recordings ...
CHANGE = "first version"  # ... and why
# what `harvester validate` asks of a prediction of what was held out, NRMSE by group; others are only shown
LIMITS = {"angle": 0.01, "pressure": 0.1}
# one line feeds both drives, so one sensor knows the pressure of both
SHARED = {"swing.supply_pressure": ("boom_stick.supply_pressure",)}


def write(folder: Path, experiment: Experiment, seed: int) -> tuple[Path, Path]:
    """Write one recording; the paths of the table and of what describes it."""
    readings = record(experiment, seed)
    csv, toml = (folder / f"{experiment.name}.{ending}" for ending in ("csv", "toml"))
    write_columns(csv, ("time", *readings), np.column_stack([experiment.time, *readings.values()]), DIGITS)
    text = "\n".join(description(experiment, seed))
    toml.write_text(f"{text}\n", encoding="utf-8", newline="\n")
    return csv, toml


def description(experiment: Experiment, seed: int) -> Iterator[str]:
    """The lines of the TOML."""
    yield "[reference]"
    yield f"title = {json.dumps(experiment.title)}"
    yield 'kind = "simulation"'
    origin = f"virtual test rig (fmus/rig), {experiment.machine} machine, noise of seed {seed}"
    yield f'origin = "{origin}; simulated, no machine was measured"'
    yield f'made_by = "harvester rig --machine {experiment.machine} --seed {seed} --out DIR"'
    yield 'solver = "CVODES (BDF), exact Jacobian, restarted at the corners of the commands"'
    yield f"relative_tolerance = {TOLERANCE:g}"
    yield f"date = {DATE}"
    yield f"change = {json.dumps(CHANGE)}"
    yield ""
    yield "[experiment]"
    yield f'procedure = "{experiment.procedure}"'
    yield f'use = "{experiment.use}"'
    for name, condition in experiment.conditions.items():
        yield f"{name} = {_condition(condition)}"
    yield ""
    yield "[time]"
    yield 'unit = "s"'
    judged = experiment.use == "test"
    if judged:
        yield ""
        yield "[tolerances]"
        for group in dict.fromkeys(map(_group, experiment.signals)):
            limit = f'{{ metric = "nrmse", limit = {LIMITS[group]} }}' if group in LIMITS else '"none"'
            yield f"{group} = {limit}"
    for name in experiment.signals:
        for known in (name, *SHARED.get(name, ())):
            yield ""
            yield f"[signals.{json.dumps(known)}]"
            yield from (f"column = {json.dumps(name)}" for _ in range(known != name))
            yield from (f'group = "{_group(name)}"' for _ in range(judged))
            yield from _signal(experiment.instruments[name])


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


def _signal(instrument: Instrument) -> Iterator[str]:
    """The unit of the column, and the instrument if there is one."""
    yield f'unit = "{instrument.unit}"'
    if not instrument.text:
        return
    yield f"sensor = {json.dumps(instrument.text)}"
    yield f"noise = {instrument.noise!r}"
    yield f"resolution = {instrument.step!r}"
    if np.isfinite([instrument.low, instrument.high]).all():
        yield f"span = [{instrument.low!r}, {instrument.high!r}]"
    yield f"dead_zone = {instrument.dead_zone!r}"
