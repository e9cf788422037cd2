"""Tables of a convergence study: errors with orders of convergence, wall times, and failures."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from orchestrator.base.text import TextTable, error_display_unit
from orchestrator.base.units import factor_and_offset
from orchestrator.studies.convergence.runs import ConvergenceStudy, SettingRun

UNSTABLE = "unstable"
REFUSED = "not possible"
EMPHASISED = (UNSTABLE, REFUSED)
ORDER_NOTE = "number after an error: observed order of convergence against the next smaller step"


def error_table(study: ConvergenceStudy, group: str) -> TextTable:
    """NRMSE of the worst signal of a group, with the observed order of convergence."""

    def cell(run: SettingRun) -> str:
        order = study.order(run, group)
        return two_digits(run.error(group)) + ("" if order is None else f" {order:4.1f}")

    return _table(study, f"{group}: worst NRMSE against {study.reference.title}; {ORDER_NOTE}", cell)


def maximum_table(study: ConvergenceStudy, group: str) -> TextTable:
    """The largest difference of a group at any instant, in a convenient unit such as bar or mm."""
    unit = error_display_unit(study.reference.groups[group][0].unit).display

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
    adaptive = adaptive_table(study)
    return [*errors, cost_table(study), *([adaptive] if adaptive else [])]


def failures(study: ConvergenceStudy) -> Iterator[str]:
    """For each setting the first unstable step, or why it was not run."""
    for setting in study.settings:
        failed = next((run for run in study.of(setting) if not run.stable), None)
        if failed is None:
            continue
        if failed.refusal:
            yield f"{setting.label}: {REFUSED}: {failed.refusal}"
            continue
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
