"""Table, figures and files of a convergence study.

The tables have a row for each setting and a column for each communication step, figures a curve for each
setting.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from orchestrator.base.files import write_rows
from orchestrator.base.text import TextTable, grouped
from orchestrator.pages.figures import LINE_STYLES, PALETTE, Style, TraceFigure, TraceLine, TracePanel
from orchestrator.pages.html_page import json_values
from orchestrator.results.report import Columns, Figure, Part, Report, Section, Table, Text
from orchestrator.ssp.masters import MASTERS
from orchestrator.studies.convergence.convergence_study import ConvergenceStudy, SettingRun, milliseconds

UNSTABLE, REFUSED = "unstable", "not possible"
ORDER_NOTE = "number after an error: observed order of convergence against the next smaller step"
OWN_STEPS = "own steps"  # of masters with adaptive step size: their errors, and the mean step
# One colour for each family; marks and line styles tell the curves of a family apart.
FAMILIES = ("plain", *MASTERS, "adaptive")
MARKERS = ("o", "s", "^", "D")
SLOPES = (1, 2, 4)  # orders of convergence of the lines in the corner


def report(study: ConvergenceStudy) -> Report:
    """The study with its tables, and why settings are unstable or were not run."""
    failed, groups = failures(study), study.groups
    verdict = f"{len(study.runs)} runs against {study.reference.heading}; not stable: {len(failed)} settings"
    cost = table(study, "wall time per simulated second [ms]", lambda run: f"{1e3 * run.cost:.2g}")
    timed = any(run.walls for run in study.runs)
    found = [*(error_table(study, group) for group in groups), *([cost] if timed else [])]
    drawn = {"Error over step": False, **({"Error over wall time": True} if timed else {})}
    made = {name: figure(study, over_cost=cost) for name, cost in drawn.items()}
    figures = [Figure(f, name, heading=name) for name, f in made.items() if any(p.lines for p in f.panels)]
    data = {
        "reference": study.reference.heading,
        "groups": groups,
        "notes": study.notes,
        "runs": [
            {
                **_row(study, run),
                "walls [s]": run.walls,
                "errors": {row.signal: {"unit": row.unit, **asdict(row.metrics)} for row in run.rows},
            }
            for run in study.runs
        ],
    }
    notes = Section("Notes", [Text([*failed, *(f"note: {note}" for note in study.notes)])], only="")
    parts: list[Part] = [Columns(figures), Section("Tables", [*map(Table, found)], only=""), notes]
    return Report("Convergence", verdict, parts, data)


def write(study: ConvergenceStudy, home: Path) -> list[Path]:
    """Write convergence.html, .json and .csv, a row for each run, to a folder."""
    rows = [_row(study, run) for run in study.runs]
    csv = home / "convergence.csv"
    write_rows(csv, [[*rows[0]], *(row.values() for row in rows)])
    return [*report(study).write(home / "convergence.html"), csv]


def _row(study: ConvergenceStudy, run: SettingRun) -> dict[str, Any]:
    """A run with the worst signal of each group, as a row of the CSV file."""
    coupling = run.setting.coupling
    row: dict[str, Any] = {
        "setting": run.setting.label,
        "master": coupling.method.name,
        "extrapolation order": coupling.extrapolation,
        "most passes": coupling.max_passes,
        "without rate connections": run.setting.without_rates,
        "step [s]": run.step,
        "mean step [s]": run.mean_step,
        "steps": run.steps,
        "simulated [s]": run.simulated,
        "stable": run.stable,
        "wall time over simulated time [1]": json_values(run.cost),
        "ended": run.failure or run.refusal,
    }
    for group in study.groups:
        worst = run.worst(group)
        row[f"{group} nrmse"] = worst and worst.metrics.nrmse
        row[f"{group} worst signal"] = worst and worst.signal
        row[f"{group} order of convergence"] = study.order(run, group)
    return row


# ---- tables


def error_table(study: ConvergenceStudy, group: str) -> TextTable:
    """NRMSE of the worst signal of a group, with the observed order of convergence."""

    def cell(run: SettingRun) -> str:
        order = study.order(run, group)
        error = f"{run.error(group):.1e}".replace("e-0", "e-").replace("e+0", "e+")
        return error + ("" if order is None else f" {order:4.1f}")

    return table(study, f"{group}: worst NRMSE against {study.reference.heading}; {ORDER_NOTE}", cell)


def table(study: ConvergenceStudy, title: str, cell: Callable[[SettingRun], str]) -> TextTable:
    """One row for each setting, one column for each step; adaptive settings have a column of their own."""
    rows = []
    adaptive = any(run.setting.adaptive for run in study.runs)
    for label, runs in grouped(study.runs, lambda run: run.setting.label).items():
        setting = runs[0].setting
        by_step = {} if setting.adaptive else {run.step: run for run in runs}
        own = _cell(runs[0], cell) if setting.adaptive else ""
        mean = f" at {1e3 * runs[0].mean_step:.3g} ms" if own and runs[0].stable else ""
        cells = [_cell(by_step.get(step), cell) for step in study.steps]
        rows.append((label, *cells, *([own + mean] if adaptive else [])))
    head = ["master", *map(milliseconds, study.steps), *([OWN_STEPS] if adaptive else [])]
    return TextTable(head, rows, title=title, strong=(UNSTABLE, REFUSED))


def _cell(run: SettingRun | None, cell: Callable[[SettingRun], str]) -> str:
    if run is None:
        return ""
    return REFUSED if run.refusal else cell(run) if run.stable else UNSTABLE


def failures(study: ConvergenceStudy) -> list[str]:
    """For each curve the first unstable step, or why it was not run."""
    lines = []
    for run in (next((run for run in runs if not run.stable), None) for runs in study.curves):
        if run and run.refusal:
            lines.append(f"{run.setting.curve}: {REFUSED}: {run.refusal}")
        elif run:
            reason = run.failure or "completed, but the error of a signal exceeded its range"
            at = "" if run.setting.adaptive else f" at {milliseconds(run.step)}"
            lines.append(f"{run.setting.label}: {UNSTABLE}{at}: {reason}")
    return lines


# ---- figures


def figure(study: ConvergenceStudy, group: str | None = None, over_cost: bool = False) -> TraceFigure:
    """Error of the worst signal of each group, or of one, over the communication step; both logarithmic.

    over_cost   over the wall time per simulated second instead: the work-precision diagram
    """
    panels = [_panel(study, g, over_cost) for g in ([group] if group else study.groups)]
    places = np.concatenate([line.time for panel in panels for line in panel.lines] or [np.zeros(1)])
    decades = range(int(np.floor(np.nanmin(places))), int(np.ceil(np.nanmax(places))) + 1)
    ticks = {k + float(np.log10(m)): f"{m * 10.0**k:g}" for k in decades for m in (1, 2, 5)}
    axis = "wall time per simulated second [ms]" if over_cost else "communication step [ms]"
    below = f"root mean square error over range of the worst signal, against {study.reference.heading}"
    key = {line.key: line.style for panel in panels for line in panel.lines}
    return TraceFigure(panels, axis=axis, below=below, ticks=ticks, key=[*key.items()])


def _panel(study: ConvergenceStudy, group: str, over_cost: bool) -> TracePanel:
    lines, lost = list[TraceLine](), list[TraceLine]()
    for index, runs in enumerate(study.curves):
        stable = [run for run in runs if run.stable]
        colour, name = PALETTE.colour(FAMILIES.index(runs[0].setting.family)), runs[0].setting.curve
        places = np.log10([1e3 * (run.cost if over_cost else run.mean_step) for run in stable])
        errors = np.array([run.error(group) for run in stable])
        styles: list[Style] = [{"marker": MARKERS[index % 4]}, {"linestyle": LINE_STYLES[index % 4]}]
        lines += [TraceLine(places, errors, {"color": colour, **s}, key=name) for s in styles if stable]
        unstable = np.log10([1e3 * run.mean_step for run in runs if not (run.stable or run.refusal)])
        cross: Style = {"color": colour, "marker": "x", "linestyle": "none"}
        lost += [TraceLine(unstable, np.ones(len(unstable)), cross, key=UNSTABLE)] if len(unstable) else []
    low = float(min((line.values.min() for line in lines), default=1.0))
    if not over_cost:
        lines += lost  # at an error of 1, above the curves
        if len(study.steps) > 1 and low > 0:
            ends = np.array([study.steps[-1] / 3, study.steps[-1]])  # lower right
            for order, dashes in zip(SLOPES, LINE_STYLES, strict=False):
                grey: Style = {"color": PALETTE.soft, "linewidth": 1.2, "linestyle": dashes}
                slope = low * (ends / ends[0]) ** order
                lines.append(TraceLine(np.log10(1e3 * ends), slope, grey, key=f"slope of order {order}"))
    return TracePanel("", lines, f"worst {group}", heights=(9.0, 0.0), log=True)
