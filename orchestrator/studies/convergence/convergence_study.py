"""`harvester convergence`: choose settings, steps and reference, run, make tables, write files.

The tables have a row for each setting and a column for each communication step.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from math import isfinite
from pathlib import Path
from typing import Any, Unpack

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn

from orchestrator.base.errors import Problem
from orchestrator.base.files import make_folder, require_system, write_rows, write_whole
from orchestrator.base.options import checked, seconds, taken
from orchestrator.base.text import TextTable, error_display_unit
from orchestrator.base.units import factor_and_offset
from orchestrator.data.recording import read_recording
from orchestrator.engine.arguments import CaseArguments
from orchestrator.pages.html_page import json_values, write_json
from orchestrator.pages.plotting import png
from orchestrator.results.validate_system import another_model
from orchestrator.ssp.load import configured
from orchestrator.studies.convergence.figures import draw_error, draw_work_precision
from orchestrator.studies.convergence.reference_solution import default_signals, finest_run, from_recording
from orchestrator.studies.convergence.runs import (
    ConvergenceStudy,
    SettingRun,
    choose,
    rate_inputs,
    run_settings,
)

UNSTABLE = "unstable"
REFUSED = "not possible"
EMPHASISED = (UNSTABLE, REFUSED)
ORDER_NOTE = "number after an error: observed order of convergence against the next smaller step"


OTHER_RUN = ("parameters", "set", "swap")  # options with which the default reference does not fit
DPI = 110


def convergence(
    system: Path,
    reference: Path | None,
    out: Path,
    steps: str,
    masters: str,
    signals: Sequence[str],
    repeats: int,
    default_reference: Path,
    report: Callable[[ConvergenceStudy, Path], object],
    scenario: Path | None = None,
    **options: Unpack[CaseArguments],
) -> ConvergenceStudy:
    """Run a study and report it; after an interrupt the finished runs are reported.

    steps              times [s], separated by commas
    masters            names separated by commas, as of `choose`
    default_reference  used if no reference is given, and if it fits this system and this run
    report             prints and writes the study, which goes to the folder `out`
    options            of `run`
    """
    if repeats < 1:
        raise Problem(f"repeats: expected at least 1, got {repeats}")
    settings, step_list = choose(_items(masters)), read_steps(steps)
    given = checked(CaseArguments, options, "convergence")
    other_run = any(given.get(name) for name in OTHER_RUN) or scenario is not None
    coupled = configured(require_system(system), **taken(given, "cut", "swap"))
    if not coupled.connections:
        raise Problem(f"{system}: expected connected FMUs, got no connection: there is nothing to couple")
    make_folder(out)
    given = {name: value for name, value in given.items() if value} | {"scenario": scenario}
    if reference is None and not other_run:
        names = from_recording(read_recording(default_reference)).names
        reference = default_reference if set(names) <= set(coupled.names()) else None
    if reference:
        recording = read_recording(reference)
        solution, note = from_recording(recording, signals), another_model(coupled, recording)
    else:
        solution = finest_run(coupled, default_signals(coupled, signals), step_list, **given)
        note = f"no reference for this run: {solution.title}, half the smallest step, is used instead"
    rates, runs = rate_inputs(coupled), list[SettingRun]()
    # without rate inputs plain settings would equal those of order 0
    fitting = [setting for setting in settings if rates or not setting.without_rates]
    plain_note = f"plain: without the connections of rate ports: {', '.join(rates)}"
    notes = [note, *solution.notes, plain_note if any(s.without_rates for s in fitting) else ""]
    try:
        running = run_settings(coupled, solution, fitting, step_list, repeats, rates, **given)
        for setting_run in with_progress(running, sum(len(s.cases) or len(step_list) for s in fitting)):
            runs.append(setting_run)
    finally:
        study = ConvergenceStudy(solution, tuple(runs), tuple(filter(None, notes)))
        if runs:
            report(study, out)
    return study


def read_steps(text: str) -> list[float]:
    """Steps [s] from a list with commas, the smallest first."""
    steps = []
    for item in _items(text):
        steps.append(seconds(item, f"steps {text}") or 0.0)
        if not (steps[-1] > 0 and isfinite(steps[-1])):
            raise Problem(f"steps {text}: expected positive times, got {item}")
    if not steps:
        raise Problem("steps: expected at least one, got none")
    return sorted(set(steps))


def _items(text: str) -> list[str]:
    """The items of a list with commas."""
    return [part.strip() for part in text.split(",") if part.strip()]


def with_progress(runs: Iterable[SettingRun], total: int) -> Iterator[SettingRun]:
    """The runs as they come, with a progress bar."""
    text = TextColumn("{task.completed} of {task.total}  {task.description}")
    console = Console(stderr=True)
    with Progress(text, BarColumn(), console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task("", total=total)
        for run in runs:
            description = f"{run.setting.label}, {run.case or milliseconds(run.step)}"
            bar.update(task, advance=1, description=description)
            yield run


def write(study: ConvergenceStudy, home: Path) -> list[Path]:
    """Write convergence.csv, .json, .png and work_precision.png to a folder; figures of the first group."""
    csv_path, json_path = home / "convergence.csv", home / "convergence.json"
    rows = [_csv_row(study, run) for run in study.runs]
    write_rows(csv_path, [[*rows[0]], *(row.values() for row in rows)])
    write_json(json_path, as_dict(study))
    figures = {"convergence.png": draw_error(study), "work_precision.png": draw_work_precision(study)}
    for name, figure in figures.items():
        write_whole(home / name, png(figure, DPI))
    return [csv_path, json_path, *(home / name for name in figures)]


def as_dict(study: ConvergenceStudy) -> Mapping[str, Any]:
    """The study for convergence.json: reference, signals by group, notes, and all runs with all errors."""
    return {
        "reference": study.reference.title,
        "groups": {group: list(names) for group, names in study.reference.groups.items()},
        "notes": list(study.notes),
        "runs": [_json_run(study, run) for run in study.runs],
    }


def _columns(run: SettingRun) -> dict[str, Any]:
    """What the CSV and the JSON file contain of a run, except for its errors."""
    coupling = run.setting.cases.get(run.case, run.setting.coupling)
    return {
        "setting": run.setting.label,
        "master": coupling.method.name,
        "extrapolation order": coupling.extrapolation,
        "most passes": coupling.max_passes,
        "without rate connections": run.setting.without_rates,
        "case": run.case,
        "step [s]": run.step,
        "mean step [s]": run.mean_step,
        "steps": run.steps,
        "simulated [s]": run.simulated,
        "stable": run.stable,
        "wall [s]": json_values(run.wall),
        "wall time over simulated time [1]": json_values(run.cost),
        "ended": run.failure or run.refusal,
    }


def _json_run(study: ConvergenceStudy, run: SettingRun) -> dict[str, Any]:
    errors = dict[str, Any]()
    for group, deviations in run.errors.items():
        signals = {e.signal: {"nrmse": e.nrmse, "maximum": e.maximum, "unit": e.unit} for e in deviations}
        errors[group] = {"order of convergence": study.order(run, group), "signals": signals}
    return {**_columns(run), "walls [s]": list(run.walls), "errors": errors}


def _csv_row(study: ConvergenceStudy, run: SettingRun) -> dict[str, Any]:
    """A row of the CSV: of each group its worst signal."""
    row = _columns(run)
    for group in study.reference.groups:
        worst = run.errors[group][0] if run.errors else None
        row[f"{group} nrmse"] = worst.nrmse if worst else None
        row[f"{group} worst signal"] = worst.signal if worst else None
        row[f"{group} order of convergence"] = study.order(run, group)
    return row


def error_table(study: ConvergenceStudy, group: str) -> TextTable:
    """NRMSE of the worst signal of a group, with the observed order of convergence."""

    def cell(run: SettingRun) -> str:
        order = study.order(run, group)
        return two_digits(run.error(group)) + ("" if order is None else f" {order:4.1f}")

    return _table(study, f"{group}: worst NRMSE against {study.reference.title}; {ORDER_NOTE}", cell)


def maximum_table(study: ConvergenceStudy, group: str) -> TextTable:
    """The largest difference of a group at any instant, in a convenient unit such as bar or mm."""
    unit_of_group = study.reference.recording.units[study.reference.groups[group][0]]
    unit = error_display_unit(unit_of_group).display

    def cell(run: SettingRun) -> str:
        error = run.maximum(group)
        return _short_exponent(f"{error.maximum * factor_and_offset(error.unit, unit, error.signal)[0]:.2g}")

    return _table(study, f"{group}: largest difference [{unit or '1'}] from {study.reference.title}", cell)


def cost_table(study: ConvergenceStudy) -> TextTable:
    """Wall time of the stable runs."""
    return _table(study, "wall time per simulated second [ms]", _cost)


def adaptive_table(study: ConvergenceStudy) -> TextTable | None:
    """Masters with adaptive step size, one row for each case; None if there are none."""
    groups = list(study.reference.groups)
    rows = []
    for run in study.runs:
        if run.case:
            errors = [two_digits(run.error(group)) if run.stable else _cell(run, _cost) for group in groups]
            steps = (str(run.steps), f"{1e3 * run.mean_step:.3g} ms")
            rows.append((f"{run.setting.label} {run.case}", *steps, *errors, _cell(run, _cost)))
    head = ("master", "steps", "mean step", *groups, "wall [ms/s]")
    title = f"adaptive step size: worst NRMSE against {study.reference.title}"
    return TextTable(head, rows, title=title, strong=EMPHASISED) if rows else None


def tables(study: ConvergenceStudy) -> list[TextTable]:
    """All tables that the command prints."""
    errors = [error_table(study, group) for group in study.reference.groups]
    return [table for table in (*errors, cost_table(study), adaptive_table(study)) if table]


def failures(study: ConvergenceStudy) -> Iterator[str]:
    """For each setting the first unstable step, or why it was not run."""
    for setting in study.settings:
        failed = next((run for run in study.of(setting) if not run.stable), None)
        if failed and failed.refusal:
            yield f"{setting.label}: {REFUSED}: {failed.refusal}"
        elif failed:
            reason = failed.failure or "completed, but the error of a signal exceeded its range"
            yield f"{setting.label}: {UNSTABLE} at {failed.case or milliseconds(failed.step)}: {reason}"


def milliseconds(step: float) -> str:
    """A step [s] as text in milliseconds."""
    return f"{1e3 * step:g} ms"


def two_digits(value: float) -> str:
    """A pure number with two digits, such as 6.4e-5."""
    return _short_exponent(f"{value:.1e}")


def _short_exponent(number: str) -> str:
    return number.replace("e-0", "e-").replace("e+0", "e+")


def _cost(run: SettingRun) -> str:
    return f"{1e3 * run.cost:.2g}"


def _table(study: ConvergenceStudy, title: str, cell: Callable[[SettingRun], str]) -> TextTable:
    """One row for each setting with given steps, one column for each step."""
    rows = []
    for setting in study.settings:
        if not setting.cases:
            by_step = {run.step: run for run in study.of(setting)}
            rows.append((setting.label, *(_cell(by_step.get(step), cell) for step in study.steps)))
    return TextTable(["master", *map(milliseconds, study.steps)], rows, title=title, strong=EMPHASISED)


def _cell(run: SettingRun | None, cell: Callable[[SettingRun], str]) -> str:
    if run is None:
        return ""
    return REFUSED if run.refusal else cell(run) if run.stable else UNSTABLE
