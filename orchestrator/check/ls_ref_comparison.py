"""Rule that runs the experiments shipped with an FMU (FMI-LS-REF) and compares with the shipped results.

The error of a signal is the root mean square of its deviation over the range of the reference (NRMSE).
"""

import math
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orchestrator.base.errors import Problem
from orchestrator.base.extras import MissingExtra, require
from orchestrator.base.signals import rms, span
from orchestrator.check.finding import Finding, error, note, warning
from orchestrator.check.probe_process import run
from orchestrator.check.probes import first_run
from orchestrator.check.read_ls_ref import (
    MANIFEST,
    Related,
    ResultTable,
    ShippedExperiment,
    experiments,
    manifest,
    parameter_set,
    relative,
    table,
)
from orchestrator.check.rule import CheckRule
from orchestrator.check.subject import Subject
from orchestrator.check.tasks.trial_run import flat, inner_step, usual_step
from orchestrator.fmi.description import FmuVariable, ModelDescription, parse_numbers


@dataclass
class ExperimentComparison:
    """Errors of one experiment, and problems with its files or its run.

    errors     signal -> NRMSE
    problems   messages about signals that cannot be compared or set
    failure    why the run was not completed; empty if it was
    late       the run was stopped because its time was over
    """

    errors: dict[str, float] = field(default_factory=dict)
    problems: list[str] = field(default_factory=list)
    failure: str = ""
    late: bool = False


def compare(subject: Subject, case: ShippedExperiment) -> ExperimentComparison:
    """Run an experiment and compare; raises Problem if a file cannot be read."""
    model, kind = subject.model, first_run(subject).kinds[0]
    reference, result = table(case.reference), ExperimentComparison()
    signals = _numeric_columns(model, reference, "the result", result)
    start = case.start if case.start is not None else model.experiment.number("startTime") or 0.0
    stop = case.stop if case.stop is not None else reference.time[-1]
    job: dict[str, Any] = {
        "start": start,
        "stop": stop,
        "step": case.step or _step(model, reference),
        "tolerance": case.tolerance or model.experiment.number("tolerance"),
        "signals": signals,
        "times": [t for t in reference.time if start <= t <= stop * (1 + 1e-12)],
        "parameters": _parameters(model, case.parameters, result),
        **_stimuli(model, case.stimuli, result),
    }
    if not signals:
        result.problems.append(f"{case.reference.name} has no column of a numeric variable of the model")
        return result
    if kind == "ModelExchange":
        require("check", "a run in Model Exchange", "fmpy")
    described = model.for_run(*signals, *job["inputs"], *job["parameters"])
    outcome = run(subject.folder, described, kind, "shipped_experiment:run", payload=job)
    errors = (text for severity, text in outcome.remarks if severity == "error")
    result.late, result.failure = outcome.late, outcome.failure or next(errors, "")
    if not result.failure:
        result.errors = _errors(model, reference, signals, outcome.result)
    return result


def _numeric_columns(
    model: ModelDescription, content: ResultTable, file: str, result: ExperimentComparison
) -> list[str]:
    """Columns of numeric variables; columns that are not variables are reported."""
    variables = model.by_name
    if unknown := [n for n in content.columns if n not in variables]:
        text = f"the model has no variables {', '.join(unknown[:5])}, which {file} contains"
        result.problems.append(text)
    return [n for n in content.columns if n in variables and variables[n].is_number]


def _step(model: ModelDescription, reference: ResultTable) -> float:
    """The declared step size; without one, the smallest interval between rows of the result."""
    intervals = [b - a for a, b in pairwise(reference.time) if b > a]
    declared = model.experiment.number("stepSize") or inner_step(model)
    return declared or min(intervals, default=usual_step(model))


def _parameters(model: ModelDescription, file: Path | None, result: ExperimentComparison) -> dict[str, Any]:
    if file is None:
        return {}
    values: dict[str, Any] = {}
    for name, text in parameter_set(file).items():
        v = model.by_name.get(name)
        if v is None or not (v.settable and (v.is_number or v.type == "String")):
            reason = "which cannot be set" if v else "which is not a variable of the model"
            result.problems.append(f"{file.name} sets {name}, {reason}")
        else:
            values[name] = text if v.type == "String" else _numbers(text, v, file.name)
    return values


def _numbers(text: str, v: FmuVariable, file: str) -> list[float]:
    try:
        values = list(parse_numbers(text))
    except ValueError:
        values = []
    if len(values) != v.size:
        raise Problem(f"{file}: {v.name}: expected {v.size} numbers, got {text!r}")
    return values


def _stimuli(model: ModelDescription, file: Path | None, result: ExperimentComparison) -> dict[str, Any]:
    if file is None:
        return {"inputs": [], "input_times": [], "input_rows": []}
    stimuli = table(file)
    names = _numeric_columns(model, stimuli, file.name, result)
    columns = [_column(model.by_name[n], stimuli.columns[n], file.name) for n in names]
    rows = np.hstack(columns).tolist() if columns else [[] for _ in stimuli.time]
    return {"inputs": names, "input_times": stimuli.time, "input_rows": rows}


def _column(v: FmuVariable, cells: Sequence[str], file: str) -> NDArray[np.float64]:
    """Values of one variable over time, shape (n, size)."""
    return np.array([_numbers(text, v, file) for text in cells])


# ---- the comparison


def _errors(
    model: ModelDescription, reference: ResultTable, signals: Sequence[str], run: Mapping[str, Any]
) -> dict[str, float]:
    """NRMSE of each signal, the smaller one of the rows before and after the inputs are set."""
    variables = [model.by_name[n] for n in signals]
    table_ = np.hstack([_column(v, reference.columns[v.name], "result") for v in variables])
    indices = np.array([int(np.argmin(np.abs(np.array(reference.time) - t))) for t in run["times"]])
    expected = table_[indices]
    errors: dict[str, float] = {}
    results = [np.array(run[key]) for key in ("before", "after") if run[key]]
    for i, v in enumerate(flat(variables)):
        column = expected[:, i]
        scale = span(column) or max(float(np.max(np.abs(column))), v.magnitude)  # of a constant its magnitude
        values = [rms(rows[:, i] - column) / scale for rows in results]
        smallest = min((x for x in values if not math.isnan(x)), default=math.inf)
        errors[v.name] = max(smallest, errors.get(v.name, 0.0))
    return errors


ERROR_LEVEL, WARNING_LEVEL = 1e-2, 1e-3  # NRMSE above which a finding is an error, a warning
OF_TOLERANCE = 1e4  # as is NRMSE above this multiple of a stated tolerance: a pressure that is 0.01 % off
MAX_LISTED = 6  # signals in a message


def _experiment(subject: Subject) -> Iterable[Finding]:
    folder = subject.folder.resolve()
    if not (folder / MANIFEST).is_file():
        return
    try:
        related = manifest(folder)
    except Problem as problem:
        yield warning(_inside(folder, problem))
        return
    yield from _missing(related)
    shipped, problems = cases(folder, related)
    for text in problems:
        yield warning(text)
    for case in shipped:
        yield from _case_findings(subject, case)


def _inside(folder: Path, problem: Problem) -> str:
    """The message with paths relative to the FMU instead of the temporary folder."""
    return str(problem).replace(f"{folder}/", "")


def _missing(related: list[Related]) -> Iterator[Finding]:
    for r in related:
        if r.path is None:
            yield note(f'{MANIFEST}: "{r.source}" is outside of the FMU and was not read')
        elif not os.path.isfile(r.path):
            yield warning(f'{MANIFEST}: "{r.source}" (role {r.role}) is missing in the FMU')


# ---- experiments


def cases(folder: Path, related: list[Related]) -> tuple[list[ShippedExperiment], list[str]]:
    """The experiments of the manifest, then results without experiment; and messages about the others."""
    present = [r for r in related if r.path is not None and os.path.isfile(r.path)]
    shipped: list[ShippedExperiment] = []
    problems: list[str] = []
    for r in present:
        if r.path is None or r.role.partition("/")[0] != "experiment":
            continue
        try:
            for case in experiments(folder, r.path):
                if isinstance(case, ShippedExperiment):
                    shipped.append(case)
                else:
                    problems.append(f"{relative(folder, r.path)}: {case}")
        except Problem as problem:
            problems.append(_inside(folder, problem))
    used = {case.reference for case in shipped}
    sets = [r.path for r in present if r.role == "parameter" and str(r.path).endswith(".ssv")]
    for r in present:
        if r.path is None or r.role != "result" or r.path in used or r.path.suffix.lower() != ".csv":
            continue
        parameters = sets[0] if len(sets) == 1 else None  # several sets are variants, none is the default
        shipped.append(ShippedExperiment(r.path.stem, r.path, parameters, _inputs_of(r.path)))
    return shipped, problems


def _inputs_of(result: Path) -> Path | None:
    """The file with the inputs of a result by its name: model_in.csv for model_out.csv."""
    stem = result.stem
    for ending in ("_out", "_result", "_ref"):
        stem = stem.removesuffix(ending)
    names = (result.with_name(f"{stem}{ending}.csv") for ending in ("_in", "_input"))
    return next((p for p in names if p.is_file()), None)


# ---- findings


def _case_findings(subject: Subject, case: ShippedExperiment) -> Iterator[Finding]:
    if reason := first_run(subject).problem:
        yield note(f'experiment "{case.name}" was not run: {reason}')
        return
    try:
        result = compare(subject, case)
    except MissingExtra as missing:
        yield note(f'experiment "{case.name}" was not run: {missing}')
        return
    except Problem as problem:
        yield warning(f'experiment "{case.name}": {_inside(subject.folder.resolve(), problem)}')
        return
    for text in result.problems:
        yield warning(f'experiment "{case.name}": {text}')
    if result.failure:
        make = note if result.late else error
        yield make(f'experiment "{case.name}" was not completed: {result.failure}')
    elif result.errors:
        yield _summary(case, result)


def _summary(case: ShippedExperiment, result: ExperimentComparison) -> Finding:
    """The signals, worst first."""
    ranked = sorted(result.errors.items(), key=lambda item: -item[1])
    worst = ranked[0][1]
    level = min(ERROR_LEVEL, OF_TOLERANCE * (case.tolerance or math.inf))
    errors = ", ".join(f"{name} {value:.2g}" for name, value in ranked[:MAX_LISTED])
    more = f" and {len(ranked) - MAX_LISTED} more" if len(ranked) > MAX_LISTED else ""
    make = error if worst > level else warning if worst > WARNING_LEVEL else note
    verb = "agrees with" if make is note else "differs from"
    text = f'experiment "{case.name}" {verb} {case.reference.name}: NRMSE {errors}{more}'
    return make(text)


EXPERIMENT = CheckRule(
    "reference.result",
    "The FMU reproduces the result of the experiment that it ships",
    _experiment,
    "draft of FMI-LS-REF",
)
