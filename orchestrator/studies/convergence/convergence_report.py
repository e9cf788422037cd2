"""Tables, figures and files of a convergence study.

The tables have a row for each setting and a column for each communication step, figures a curve for each
setting.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from orchestrator.base.files import write_rows, write_whole
from orchestrator.base.text import TextTable, error_display_unit
from orchestrator.base.units import factor_and_offset
from orchestrator.pages.figures import LINE_STYLES, PALETTE
from orchestrator.pages.html_page import json_values, write_text
from orchestrator.pages.plotting import legend, new_figure, png, style_axes
from orchestrator.results.report import Report, Table, Text
from orchestrator.ssp.masters import MASTERS
from orchestrator.studies.convergence.convergence_study import ConvergenceStudy, SettingRun, milliseconds

UNSTABLE, REFUSED = "unstable", "not possible"
ORDER_NOTE = "number after an error: observed order of convergence against the next smaller step"
DPI = 110
SIZE = (9.6, 5.2)  # [in]
# One colour for each family, different in hue and in lightness (Okabe and Ito, darkened); markers and line
# styles tell the curves of a family apart.
DARK = ("#c2341d", "#c98500", "#00735a", "#0b5fa5", "#333333", "#8f3f8f")
COLOURS = dict(zip(("plain", *MASTERS, "adaptive"), DARK, strict=True))
MARKERS = ("o", "s", "^", "D")
SLOPES = (1, 2, 4)  # orders of convergence of the lines in the corner


def report(study: ConvergenceStudy) -> Report:
    """The study with its tables, and why settings are unstable or were not run."""
    failed = failures(study)
    verdict = f"{len(study.runs)} runs against {study.reference.title}; not stable: {len(failed)} settings"
    notes = [*failed, *(f"note: {note}" for note in study.notes)]
    data = {
        "reference": study.reference.title,
        "groups": study.reference.groups,
        "notes": study.notes,
        "runs": [_data(study, run) for run in study.runs],
    }
    return Report("Convergence", verdict, [*map(Table, tables(study)), Text(notes)], data)


def write(study: ConvergenceStudy, home: Path) -> list[Path]:
    """Write convergence.csv, .json, .png and work_precision.png to a folder; figures of the first group."""
    csv, json = home / "convergence.csv", home / "convergence.json"
    rows = [_row(study, run) for run in study.runs]
    write_rows(csv, [[*rows[0]], *(row.values() for row in rows)])
    write_text(json, report(study).json() + "\n")
    figures = {"convergence.png": draw(study), "work_precision.png": draw(study, over_cost=True)}
    return [csv, json, *(write_whole(home / name, png(f, DPI)) for name, f in figures.items())]


def _data(study: ConvergenceStudy, run: SettingRun) -> dict[str, Any]:
    """What the JSON file contains of a run: the columns of the CSV file, and all signals."""
    units, errors = study.reference.recording.units, dict[str, Any]()
    for group, found in run.errors.items():
        signals = {
            n: {"nrmse": e.nrmse, "maximum": e.maximum_error, "unit": units[n]} for n, e in found.items()
        }
        errors[group] = {"order of convergence": study.order(run, group), "signals": signals}
    return {**_row(study, run), "walls [s]": run.walls, "errors": errors}


def _row(study: ConvergenceStudy, run: SettingRun) -> dict[str, Any]:
    """A run with the worst signal of each group, as a row of the CSV file."""
    row: dict[str, Any] = {
        "setting": run.setting.label,
        "master": run.setting.coupling.method.name,
        "extrapolation order": run.setting.coupling.extrapolation,
        "most passes": run.setting.coupling.max_passes,
        "without rate connections": run.setting.without_rates,
        "step [s]": run.step,
        "mean step [s]": run.mean_step,
        "steps": run.steps,
        "simulated [s]": run.simulated,
        "stable": run.stable,
        "wall [s]": json_values(run.wall),
        "wall time over simulated time [1]": json_values(run.cost),
        "ended": run.failure or run.refusal,
    }
    for group in study.reference.groups:
        worst = next(iter(run.errors.get(group, ())), None)
        row[f"{group} nrmse"] = run.error(group) if worst else None
        row[f"{group} worst signal"] = worst
        row[f"{group} order of convergence"] = study.order(run, group)
    return row


# ---- tables


def tables(study: ConvergenceStudy) -> list[TextTable]:
    """All tables that the command prints."""
    errors = [error_table(study, group) for group in study.reference.groups]
    cost = _table(study, "wall time per simulated second [ms]", _cost)
    return [table for table in (*errors, cost, adaptive_table(study)) if table]


def error_table(study: ConvergenceStudy, group: str) -> TextTable:
    """NRMSE of the worst signal of a group, with the observed order of convergence."""

    def cell(run: SettingRun) -> str:
        order = study.order(run, group)
        return two_digits(run.error(group)) + ("" if order is None else f" {order:4.1f}")

    return _table(study, f"{group}: worst NRMSE against {study.reference.title}; {ORDER_NOTE}", cell)


def maximum_table(study: ConvergenceStudy, group: str) -> TextTable:
    """The largest difference of a group at any instant, in a convenient unit such as bar or mm."""
    units = study.reference.recording.units
    unit = error_display_unit(units[study.reference.groups[group][0]]).display

    def cell(run: SettingRun) -> str:
        name, error = max(run.errors[group].items(), key=lambda item: item[1].maximum_error)
        factor, _ = factor_and_offset(units[name], unit, name)
        return _short_exponent(f"{error.maximum_error * factor:.2g}")

    return _table(study, f"{group}: largest difference [{unit or '1'}] from {study.reference.title}", cell)


def adaptive_table(study: ConvergenceStudy) -> TextTable | None:
    """Masters with adaptive step size, one row for each case; None if there are none."""
    groups = list(study.reference.groups)
    rows = []
    for run in (run for run in study.runs if run.setting.adaptive):
        errors = [_cell(run, lambda r, group=group: two_digits(r.error(group))) for group in groups]  # type: ignore[misc]
        steps = (str(run.steps), f"{1e3 * run.mean_step:.3g} ms")
        rows.append((run.setting.label, *steps, *errors, _cell(run, _cost)))
    head = ("master", "steps", "mean step", *groups, "wall [ms/s]")
    title = f"adaptive step size: worst NRMSE against {study.reference.title}"
    return TextTable(head, rows, title=title, strong=(UNSTABLE, REFUSED)) if rows else None


def _table(study: ConvergenceStudy, title: str, cell: Callable[[SettingRun], str]) -> TextTable:
    """One row for each setting with given steps, one column for each step."""
    rows = []
    for runs in (runs for runs in study.curves if not runs[0].setting.adaptive):
        by_step = {run.step: run for run in runs}
        rows.append((runs[0].setting.label, *(_cell(by_step.get(step), cell) for step in study.steps)))
    head = ["master", *map(milliseconds, study.steps)]
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


def two_digits(value: float) -> str:
    """A pure number with two digits, such as 6.4e-5."""
    return _short_exponent(f"{value:.1e}")


def _short_exponent(number: str) -> str:
    return number.replace("e-0", "e-").replace("e+0", "e+")


def _cost(run: SettingRun) -> str:
    return f"{1e3 * run.cost:.2g}"


# ---- figures


def draw(study: ConvergenceStudy, group: str | None = None, over_cost: bool = False) -> Figure:
    """Error of the worst signal of a group, the first one by default, over the communication step.

    over_cost   over the wall time per simulated second instead: the work-precision diagram
    """
    group = group or next(iter(study.reference.groups))
    figure = new_figure(*SIZE)
    axes = figure.subplots()
    x = "wall time per simulated second [ms]" if over_cost else "communication step [ms]"
    style_axes(axes, x, f"worst {group}, root mean square error over range", size=10)
    axes.set(xscale="log", yscale="log")
    axes.set_title(f"against: {study.reference.title}", loc="left", fontsize=9, color=PALETTE.faint)
    crosses = []
    for runs in study.curves:
        stable, colour, index = (
            [r for r in runs if r.stable],
            COLOURS[runs[0].setting.family],
            len(axes.lines),
        )
        crosses += [(1e3 * r.mean_step, colour) for r in runs if not (r.stable or r.refusal)]
        style = {"linestyle": LINE_STYLES[index % 4], "marker": MARKERS[index % 4], "markersize": 4}
        places = [1e3 * (run.cost if over_cost else run.mean_step) for run in stable]
        errors, label = [run.error(group) for run in stable], runs[0].setting.curve
        if stable:
            axes.plot(places, errors, label=label, color=colour, lw=1.4, **style)
    low, high = axes.get_ylim()
    if not over_cost:
        for k, (step, colour) in enumerate(crosses):  # above the curves, side by side
            shift = 1.03 ** (k % 5 - 2)
            axes.plot([step * shift], [high], color=colour, marker="x", markersize=6, linestyle="")
        if study.steps:  # none, if all settings are adaptive
            _draw_slopes(axes, study.steps, low)
        axes.set_xticks([1e3 * step for step in study.steps], [f"{1e3 * step:g}" for step in study.steps])
    else:
        axes.xaxis.set_major_formatter("{x:g}")
    axes.minorticks_off()
    below = ["x at the top: unstable"] if crosses and not over_cost else []
    legend(figure, loc="outside right upper", ncols=1, title="\n".join(below) or None, title_fontsize=8)
    return figure


def _draw_slopes(axes: Any, steps: list[float], low: float) -> None:
    """Lines with the slopes of orders of convergence, lower right."""
    right = 1e3 * steps[-1]
    for order in SLOPES:
        ends = np.array([right / 1.5, right])
        axes.plot(ends, low * (ends / ends[0]) ** order, color=PALETTE.faint, linewidth=0.9)
        axes.annotate(
            f"order {order}", (right, low * 1.5**order), fontsize=8, color=PALETTE.soft, va="center"
        )
