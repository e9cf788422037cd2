"""Logs of a machine in the field, written to files with what loggers do: the machine is found from each."""

import json
import re
from functools import cache
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from identification.procedures.lumped_machine import ENCODER
from identification.refinement.test_refine_machine import SENSORS, SOME, machine_recording
from kit import shards

from fmus.identification import machine
from fmus.identification.machine import COMMANDS, lookup, nominal, signal_names
from fmus.identification.recordings.clock import resample_uniformly
from fmus.identification.recordings.reading import doubtful, read
from fmus.identification.refinement.refine import compiled, refine
from fmus.identification.report.prediction import compare, excitation

SECONDS, RATE = 8.0, 200
NO_VALUE = 6553.5e5  # Pa: 0xFFFF on a bus
UNITS = {"pressure": "Pa", "angle": "deg", "command": "V"}
SUPPLY = "swing.supply_pressure"


def kind(name: str) -> str:
    """Command, angle or pressure; empty for another column."""
    return next((k for k in UNITS if k in name), "")


@cache
def logged() -> dict[str, np.ndarray]:
    """Columns at 200 Hz of a machine without flow meters; the swing begins at -2 degrees."""
    made = machine_recording(SECONDS)
    columns = {"time": made.time} | {n: made[n] for n in made if kind(n)}
    columns |= {n: np.degrees(y) for n, y in columns.items() if "_angle" in n}
    columns["manipulator.swing_angle"] = columns["manipulator.swing_angle"] - 2
    noise = np.random.default_rng(4).normal(0, 1e4, made.time.size)
    return columns | {SUPPLY: columns[SUPPLY] + noise}


def held(columns, rows, gap=False):
    """Commands at 20 Hz, angles at 50 Hz, pressures at 100 Hz: in one table with repeated or empty cells."""
    every, k = {"command": 10, "angle": 4, "pressure": 2}, np.arange(rows)
    sent = {n: k // every[kind(n)] * every[kind(n)] for n in columns if n != "time"}
    sampled = {n: np.where(gap & (k != row), np.nan, columns[n][row]) for n, row in sent.items()}
    return {"time": columns["time"]} | sampled


def around(columns):
    """Angles from 0 to 360 degrees."""
    return columns | {n: y % 360 for n, y in columns.items() if "angle" in n}


def early(columns, *milliseconds):
    """Commands with the time of their request."""
    late = dict(zip(COMMANDS.values(), np.multiply(milliseconds, RATE) // 1000, strict=True))
    return {n: np.append(y[late.get(n, 0) :], np.full(late.get(n, 0), y[-1])) for n, y in columns.items()}


def coded(columns, *names):
    """'Not available' in one of 300 samples."""
    row, places = np.arange(columns["time"].size), [*columns]
    lost = {n: np.where(row % 300 == 7 + places.index(n), NO_VALUE, columns[n]) for n in names}
    return columns | lost


PRESSURES = [signal_names()[n] for n in SENSORS if kind(n) == "pressure"]
# what is in the log, keys of its signals of these kinds, and what is told
LOGS = {
    "as it was": (lambda c: c, {}, ""),
    "encoder 0 to 360": (around, {}, "swing_angle: jumps .* unwrapped"),
    "commands 20 ms early": (lambda c: early(c, 20, 20, 20), {"command": {"delay": 0.02}}, ""),
    "commands 10 to 100 ms early": (lambda c: early(c, 10, 40, 100), {"command": {"delay_error": 0.2}}, ""),
    "empty cells": (lambda c: held(c, c["time"].size, gap=True), {}, ""),
    "repeated cells": (lambda c: held(c, c["time"].size), {n: {"held": True} for n in UNITS}, ""),
    "codes at the pressures": (
        lambda c: coded(c, *PRESSURES),
        {},
        r"head_pressure: \d+ samples far from all others: error codes\? invalid = \[655350000\]",
    ),
    "codes at the supply": (lambda c: coded(c, SUPPLY), {}, r"supply_pressure: \d+ samples far from all"),
    "codes that are stated": (
        lambda c: coded(c, SUPPLY, *PRESSURES),
        {"pressure": {"invalid": [NO_VALUE]}},
        "",
    ),
    "50 Hz": (lambda c: {n: y[::4] for n, y in c.items()}, {}, ""),
    "20 Hz": (lambda c: {n: y[::10] for n, y in c.items()}, {}, ""),
}


def write(folder: Path, columns: dict[str, np.ndarray], keys: dict[str, dict[str, object]]) -> Path:
    """The log and its description; a pressure sensor for 400 bar."""
    pd.DataFrame(columns).to_csv(folder / "a.csv", index=False)
    instrument = {
        "pressure": {"noise": 1e4, "resolution": 400e5 / 4096, "span": [0.0, 400e5]},
        "angle": {"noise": np.degrees(ENCODER.sd)},
    }
    text = '[experiment]\nprocedure = "machine"\n'
    for name in (n for n in columns if n != "time"):
        k = kind(name)
        entries = {"unit": UNITS[k]} | instrument.get(k, {}) | keys.get(k, {})
        text += f'[signals."{name}"]\n' + "".join(f"{key} = {json.dumps(v)}\n" for key, v in entries.items())
    (folder / "a.toml").write_text(text, encoding="utf-8")
    return folder / "a.csv"


# each way of logging with the keys for it, at the slowest clock; an undisturbed log is a part of all
# and three delays to be found are in test_delays.py
OTHERS = ("as it was", "50 Hz", "codes at the supply", "empty cells", "commands 10 to 100 ms early")
QUICK = {*LOGS} - {*OTHERS}


@pytest.mark.parametrize("name", shards.few(QUICK, LOGS, shards.search))
def test_the_machine_is_found_from_a_field_log(tmp_path, capsys, name):
    """With the keys that the messages name, or with none; the fit leaves the noise of the sensors."""
    change, keys, told = LOGS[name]
    recording = read(write(tmp_path, change(logged()), keys))
    lines = [*doubtful([recording]), *capsys.readouterr().err.splitlines()]
    assert any(re.search(told, line) for line in lines) if told else lines == []
    recording = resample_uniformly(recording)
    names = [n for n in SOME if n != "bulk_modulus"]
    known = nominal()
    task = machine.problem([recording], known, names)
    found = refine(task, compiled(task))
    assert found.converged
    # 160 samples of 9 signals at 20 Hz, the fewest: 1 / sqrt(2 * 1440) = 1.9 %, four times that
    assert found.history[-1].residual == pytest.approx(1, abs=0.08)
    truth = {n: lookup(n, known).value for n in names}
    for e in machine.estimates(found):
        # 3 parameters of 11 logs exceed 4.5 standard deviations once in 5000 sets
        assert abs(np.log(e.value / truth[e.name])) < 4.5 * e.sd / e.value, e
    (corrected,) = machine.corrected([recording], found)
    drives = excitation(corrected)  # what the report simulates; its filters fit clocks of 20 Hz, too
    assert compare(corrected, dict(corrected.signals)).nrmse()
    for command, signal in COMMANDS.items():
        right = np.interp(drives.time, logged()["time"], logged()[signal])
        # linear between samples at 20 Hz, and a thousandth of a period
        assert np.sqrt(np.mean((drives.commands[command] - right)[drives.time > 0.2] ** 2)) < 0.1
