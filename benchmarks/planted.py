"""Limits of the work cycle's reference, and the planted errors that they notice: half an hour.

    python -m benchmarks.planted limits    # writes the signals of data/reference/work_cycle.toml
    python -m benchmarks.planted           # writes the tables of docs/recordings.md

Both simulate the work cycle with the FMUs in build/. The limit of a signal is FACTOR times the error of the
default master, at least FLOOR. Each connected input of an FMU has a limit, too: its reference is the column
of the output that it is connected to.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from orchestrator import Trace, load, run
from orchestrator.base.text import TextTable, number
from orchestrator.data.description import read_description
from orchestrator.data.recording import Recording, read_recording
from orchestrator.data.table import Array, read_columns
from orchestrator.engine.result import Result
from orchestrator.results.layout import Layout
from orchestrator.results.metrics import HARDLY_MOVES
from orchestrator.results.validate_system import comparable
from orchestrator.results.validation import ValidatedSignal, Validation, validate
from orchestrator.ssp.system import System

ROOT = Path(__file__).resolve().parents[1]
META = ROOT / "data" / "reference" / "work_cycle.toml"
SCENARIO = ROOT / "data" / "scenarios" / "work_cycle.csv"
PAGE = ROOT / "docs" / "recordings.md"
RECORD_STEP = 0.02  # s, the samples of the reference
FACTOR = 10.0  # `jacobi` at 1 ms has 4 times the error of the default master
# NRMSE: ten times the errors inside FMUs at their default tolerance, and of the nine digits of the file
FLOOR = 1e-6
GROUPS = {
    "m": "tip",
    "m/s": "velocity",
    "m/s2": "acceleration",
    "rad/s2": "acceleration",
    "Pa": "line pressure",
    "m3/s": "line flow",
    "N": "load",
    "N.m": "load",
    "m3": "void",
    "J": "energy",
    "W": "power",
    "kg": "payload",
    "K": "temperature",
    "kg/s": "payload",
}  # of a signal without label, by unit; others are rates


# ---- limits


def write_limits() -> None:
    """Write the signals of META, after its head."""
    system = load(ROOT / "build" / "harvester.ssp")
    columns, result = column_of(system), run(system, record_step=RECORD_STEP)
    rows = validate(result, unlimited(columns, result)).rows
    lines = [signal_line(row, columns[row.signal]) for row in rows]
    head, _, _ = META.read_text(encoding="utf-8").partition("\n[signals]\n")
    META.write_text("\n".join([head, "[signals]", *lines, ""]), encoding="utf-8", newline="\n")


def column_of(system: System) -> dict[str, str]:
    """Signal -> column of the reference: outputs, and inputs that are connected to one of them.

    Inputs that are connected to a component without inputs, such as operator_input, are played, not judged;
    the three commands are both.
    """
    names = META.with_suffix(".csv").read_text(encoding="utf-8").partition("\n")[0].split(",")[1:]
    sources = {str(c.target): str(c.source) for c in system.connections}
    return (
        {name: name for name in read_description(META).signals if name in names}
        | {name: name for name in names}
        | {target: source for target, source in sources.items() if source in names}
    )


def unlimited(columns: Mapping[str, str], result: Result) -> Recording:
    """The columns as a reference without limits, in the units of the run."""
    table = read_columns(META.with_suffix(".csv"), {"time", *columns.values()})
    signals = {name: table.values[column] for name, column in columns.items()}
    units = {name: result.trace.units.get(name, "") for name in signals}
    return Recording(table.values["time"], signals, units, META.with_suffix(".csv"))


def signal_line(row: ValidatedSignal, column: str) -> str:
    """A signal in TOML, with the label and the group that it has."""
    known = read_description(META).signals.get(row.signal)
    entries: dict[str, str | float] = {"unit": row.unit, "group": GROUPS.get(row.unit, "rate")}
    if known and known.label:
        entries |= {"group": known.group, "label": known.label}
    if column != row.signal:
        entries |= {"column": column, "group": "connected input"}
    if any(note.startswith(HARDLY_MOVES) for note in row.notes):
        entries["range"] = row.metrics.normalised_by
    text = ", ".join(f"{key} = {value!r}".replace("'", '"') for key, value in entries.items())
    return f'"{row.signal}" = {{ {text}, tolerance = {{ metric = "nrmse", limit = {limit(row):.1e} }} }}'


def limit(row: ValidatedSignal) -> float:
    """The limit of a signal that has this error with the default master."""
    return max(FACTOR * (row.metrics.nrmse or 0.0), FLOOR)


# ---- planted errors

Damage = Callable[[Trace], Mapping[str, Array]]  # the signals that it changes


def late(*names: str) -> Damage:
    """Signals 1 ms late, to first order; without names all."""
    return lambda run_: {n: run_[n] - 1e-3 * np.gradient(run_[n], run_.time) for n in names or run_.signals}


def scaled(name: str, factor: float) -> Damage:
    """One signal times a factor."""
    return lambda run_: {name: factor * run_[name]}


def exchanged(first: str, second: str) -> Damage:
    """Two signals in the place of each other."""
    return lambda run_: {first: run_[second], second: run_[first]}


def spike(name: str) -> Damage:
    """One row off by 5 % of the range."""
    return lambda run_: {name: run_[name] + 0.05 * np.ptp(run_[name]) * (np.arange(run_.time.size) == 1000)}


PRESSURES = ("boom_stick.boom_head_pressure", "boom_stick.stick_rod_pressure", "swing.swing_pressure_a")
SCALED = (
    *(*PRESSURES, "supply.supply_pressure", "manipulator.boom_angle"),
    *("manipulator.swing_speed", "manipulator.boom_speed", "boom_stick.boom_head_flow", "supply.supply_flow"),
)
EXCHANGED = (
    ("manipulator.tip_x", "manipulator.tip_y"),
    ("manipulator.kinetic_energy", "manipulator.potential_energy"),
    ("manipulator.swing_acceleration", "manipulator.boom_acceleration"),
    ("manipulator.boom_angle", "manipulator.stick_angle"),
    ("boom_stick.boom_head_pressure", "boom_stick.boom_rod_pressure"),
    ("swing.swing_pressure_a", "swing.swing_motor_pressure_a"),
    ("boom_stick.stored_energy", "swing.stored_energy"),
)
DAMAGES: Mapping[str, Damage] = {
    "all signals 1 ms late": late(),
    **{f"`{name}` 1 ms late": late(name) for name in PRESSURES},
    **{f"`{name}` 0.2 % too large": scaled(name, 1.002) for name in SCALED},
    **{f"`{a}` and `{b}` exchanged": exchanged(a, b) for a, b in EXCHANGED},
    "sign of `swing.swing_torque`": scaled("swing.swing_torque", -1.0),
    **{f"one row of `{name}` off by 5 % of the range": spike(name) for name in PRESSURES},
}
PARAMETERS = (
    *("manipulator.head_mass", "manipulator.stick_mass", "manipulator.column_inertia"),
    *("manipulator.boom_piston_damping", "boom_stick.bulk_modulus", "boom_stick.boom_bore"),
    *("boom_stick.valve_area", "boom_stick.boom_dead_volume", "swing.valve_area"),
    *("swing.motor_displacement", "swing.internal_leakage_resistance", "supply.pressure_setting"),
)


def damaged(trace: Trace, damage: Damage) -> Trace:
    """A run with a planted error."""
    return Trace(trace.time, {**trace.signals, **damage(trace)}, trace.units)


def wrong(system: System, name: str) -> dict[str, float]:
    """A parameter that is 1 % too large."""
    return {name: 1.01 * float(system.variable(system.port(name)).start)}


# ---- the right machine

RIGHT: Mapping[str, tuple[str, Mapping[str, Any]]] = {
    "gauss-seidel, 1 ms": ("harvester.ssp", {}),
    "gauss-seidel, 2 ms": ("harvester.ssp", {"step": 2e-3}),
    "jacobi, 1 ms": ("harvester.ssp", {"master": "jacobi", "step": 1e-3}),
    "hermite, 5 ms": ("harvester.ssp", {"master": "hermite", "step": 5e-3}),
    "hermite, `--adaptive 1e-4`": ("harvester.ssp", {"master": "hermite", "adaptive": 1e-4}),
    "interface-jacobian, 5 ms": ("harvester.ssp", {"master": "interface-jacobian", "step": 5e-3}),
    "interface-jacobian, 10 ms": ("harvester.ssp", {"master": "interface-jacobian", "step": 1e-2}),
    "`--accuracy 1e-4`": ("harvester.ssp", {"accuracy": 1e-4}),
    "gauss-seidel, 1 ms, FMI 3.0": ("fmi3/harvester.ssp", {}),
    "the machine in one FMU": ("harvester.fmu", {"scenario": SCENARIO}),
}


def judged(system: System, **options: Any) -> Validation:
    """A run of the work cycle against the reference."""
    trace = run(system, options.pop("scenario", None), record_step=RECORD_STEP, **options).trace
    reference, trace = comparable(system, trace, read_recording(META), Layout())
    return validate(trace, reference)


# ---- tables


def main() -> None:
    """Write the tables."""
    system = load(ROOT / "build" / "harvester.ssp")
    right = {n: judged(load(ROOT / "build" / file), **options) for n, (file, options) in RIGHT.items()}
    trace, reference = run(system, record_step=RECORD_STEP).trace, read_recording(META)
    planted = {n: validate(damaged(trace, d), reference) for n, d in DAMAGES.items()}
    planted |= {f"`{n}` 1 % too large": judged(system, set=wrong(system, n)) for n in PARAMETERS}
    fill("right machine", table("run", right))
    fill("planted errors", table("planted error", planted))


def table(head: str, cases: Mapping[str, Validation]) -> TextTable:
    """A row for each validation."""
    rows = []
    for name, found in cases.items():
        worst = max(found.judged, key=lambda row: row.limit_use)
        count = f"{len(found.failed)} of {len(found.judged)}"
        rows.append([name, count, f"`{worst.signal}`", number(worst.limit_use, 2)])
    return TextTable((head, "outside their limits", "worst signal", "error over limit"), rows, left=(0, 2))


def fill(name: str, made: TextTable) -> None:
    """Put a table in its place in PAGE."""
    text = PAGE.read_text(encoding="utf-8")
    place = re.compile(rf"(<!-- {name} -->\n).*?(\n<!-- end -->)", re.DOTALL)
    filled = place.sub(lambda match: match[1] + made.markdown() + match[2], text)
    PAGE.write_text(filled, encoding="utf-8", newline="\n")


if __name__ == "__main__":
    if sys.argv[1:] == ["limits"]:
        write_limits()
    else:
        main()
