"""Writes a recording: NAME.csv and NAME.toml, as docs/reference-traces.md describes them."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from fmus.rig.benches.bench import TOLERANCE
from fmus.rig.instruments import Instrument
from fmus.rig.recording import Condition, Experiment, record
from fmus.tables import write_csv

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
    write_csv(csv, ("time", *readings), np.column_stack([experiment.time, *readings.values()]), DIGITS)
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
