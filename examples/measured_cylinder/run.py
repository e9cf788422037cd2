"""Identifies a measured hydraulic axis on some steps of its valve and predicts the others; see README.md.

    python examples/measured_cylinder/run.py FOLDER
    python examples/measured_cylinder/run.py FOLDER --repeats 0 --tests 0     # all runs, half an hour

FOLDER contains the .mat files; a description in TOML is written next to each that is read.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from time import perf_counter

import numpy as np
from axis import AXIS
from figure import draw
from fit import OUTPUTS, draws, identified_values, identify, scatter
from prediction import Band, Errors, calibrated_noise, compare, predict
from recordings import HELD_OUT, files, read, select
from rich.console import Console
from rich.table import Table

from fmus.export.build import build
from fmus.identification.report.prediction import extrapolations
from fmus.identification.results import Estimate
from orchestrator.base.errors import Problem
from orchestrator.data.recording import Recording

DRAWS = 60
WIDTH = 104  # characters of the tables
TRAINING = (1, 3, 5)  # V
BARS = {"stroke": 0.01, "speed": 0.02, "pressure": 2.0, "held": (0.90, 0.99)}


def by_step(recordings: list[Recording]) -> dict[int, list[Recording]]:
    """The recordings of each step [V]; the shortest is the first, all begin at the same time."""
    steps = sorted({int(r.conditions["step"]) for r in recordings})
    return {
        v: sorted((r for r in recordings if r.conditions["step"] == v), key=lambda r: len(r.time))
        for v in steps
    }


def parameters(estimates: tuple[Estimate, ...]) -> Table:
    """The estimated parameters."""
    table = Table(title="Identified on +-1, 3 and 5 V", title_justify="left")
    for heading in ("parameter", "value", "95 % interval", "unit"):
        table.add_column(heading, justify="left" if heading in ("parameter", "unit") else "right")
    for e in estimates:
        interval = f"{e.low:.3g} to {e.high:.3g}" if np.isfinite(e.high) else "open"
        table.add_row(e.name, f"{e.value:.4g}", interval, e.unit)
    return table


def results(errors: dict[int, Errors]) -> Table:
    """Errors of the predictions; the held-out steps are judged."""
    table = Table(title="Prediction by the FMU", title_justify="left")
    table.add_column("")
    rows: dict[str, list[str]] = {}

    def add(name: str, text: str, good: bool, judged: bool) -> None:
        rows.setdefault(name, []).append(text + (" missed" if judged and not good else ""))

    low, high = BARS["held"]
    for volts, e in errors.items():
        judged = volts in HELD_OUT
        table.add_column(f"+-{volts} V\n{'held out' if judged else 'fitted'}", justify="right")
        add("stroke, RMS over range", f"{100 * e.stroke:.2f} %", e.stroke <= BARS["stroke"], judged)
        for name, value in zip(("speed out", "speed in"), e.speeds, strict=True):
            add(name, f"{100 * value:+.2f} %", abs(value) <= BARS["speed"], judged)
        for name, error in e.pressures.items():
            side, ratio = name.partition("_")[0], error / e.repeatability[name]
            add(f"{side} pressure, RMS", f"{1e-6 * error:.3f} MPa", True, False)
            add(f"{side}, over repeatability", f"{ratio:.2f}", not ratio > BARS["pressure"], judged)
        for name, share in e.held.items():
            add(f"{name.replace('_', ' ')} in band", f"{100 * share:.1f} %", low <= share <= high, judged)
    for name, cells in rows.items():
        table.add_row(name, *cells)
    return table


def main(arguments: list[str] | None = None) -> dict[int, Errors]:
    """The command line; returns the errors by step."""
    parser = argparse.ArgumentParser(description="A measured hydraulic axis: identify and predict.")
    parser.add_argument("folder", type=Path)
    parser.add_argument(
        "--repeats", type=int, default=2, help="of each step and pressure to identify on; 0: all"
    )
    parser.add_argument("--tests", type=int, default=3, help="of each step and pressure to predict; 0: all")
    parser.add_argument("--draws", type=int, default=DRAWS, help="simulations for each band")
    parser.add_argument("--out", type=Path, default=Path("build/measured_cylinder"))
    given = parser.parse_args(arguments)
    console, began = Console(width=WIDTH), perf_counter()
    given.out.mkdir(parents=True, exist_ok=True)
    found = files(given.folder)
    training = list(read(select(found, TRAINING, given.repeats or None)))
    tests = list(read(select(found, HELD_OUT, given.tests or None)))
    console.print(
        f"{len(training)} runs to identify, {len(tests)} to predict, {perf_counter() - began:.0f} s"
    )
    spread = scatter(training)
    sd = 100 * np.sqrt(np.diag(spread.covariance))
    console.print(f"speeds scatter from run to run by {sd[0]:.2f} % out and {sd[1]:.2f} % in")
    result = identify(training, spread)
    console.print(parameters(result.estimates()), f"search: {result.reason}, {perf_counter() - began:.0f} s")
    console.print(*result.unidentified, sep="\n")
    fmu = build(AXIS, given.out, values=identified_values(result, training))
    drawn = draws(result, spread, given.draws)
    groups = by_step(training + tests)
    driven = {"command": np.concatenate([r["command"] for r in training])}
    for volts, runs in groups.items():
        for found in extrapolations(runs[-1], driven, driven):
            console.print(f"+-{volts} V: {found}: an extrapolation, which the bands do not cover")
    bands: dict[int, Band] = {v: predict(fmu, runs[-1], drawn) for v, runs in groups.items()}
    fitted = {v: band for v, band in bands.items() if v not in HELD_OUT}
    noise = {name: calibrated_noise(fitted, training, name) for name in OUTPUTS}
    errors = {v: compare(bands[v], runs, noise) for v, runs in groups.items()}
    console.print(results(errors))
    picture = draw(
        {v: (bands[v], groups[v]) for v in bands if v in HELD_OUT}, noise, given.out / "result.png"
    )
    console.print(f"wrote {fmu} and {picture}, {perf_counter() - began:.0f} s", soft_wrap=True)
    return errors


if __name__ == "__main__":
    try:
        main()
    except Problem as mistake:
        sys.exit(f"error: {mistake}")
