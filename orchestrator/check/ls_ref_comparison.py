"""The experiment that an FMU ships (FMI-LS-REF): run it in a child process, compare with the result it ships.

The error of a signal is the root mean square of its deviation, over the range of the reference (NRMSE).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orchestrator.base.errors import Problem
from orchestrator.check.finding import CheckRule, Finding, error, note, warning
from orchestrator.check.ls_ref_files import (
    MANIFEST,
    Related,
    ResultTable,
    ShippedExperiment,
    experiments,
    manifest,
    parameter_set,
    shown,
    table,
)
from orchestrator.check.probe_process import run
from orchestrator.check.probes import first_run
from orchestrator.check.subject import Subject
from orchestrator.check.tasks.trial_run import experiment, flat, inner_step, usual_step
from orchestrator.fmi.raw_description import DeclaredVariable, ModelDescription, parse_numbers

SETTABLE = ("parameter", "structuralParameter", "input")


@dataclass
class ExperimentComparison:
    """errors   signal -> NRMSE over range
    problems   what could not be compared or set
    end        why the run did not come to its end; empty when it did
    late       its time was over
    """

    errors: dict[str, float] = field(default_factory=dict)
    problems: list[str] = field(default_factory=list)
    end: str = ""
    late: bool = False


def compare(subject: Subject, case: ShippedExperiment) -> ExperimentComparison:
    """Run and compare; raises Problem when a file cannot be read."""
    model, kind = subject.model, first_run(subject).kinds[0]
    reference, result = table(case.reference), ExperimentComparison()
    signals = _signals(model, reference, result)
    job = _job(model, case, reference, signals, result)
    if not signals:
        result.problems.append(f"{case.reference.name} has no column that is a number of the model")
        return result
    outcome = run(subject.folder, model, kind, "shipped_experiment:run", payload=job)
    result.late = outcome.late
    result.end = outcome.end or next((text for severity, text in outcome.said if severity == "error"), "")
    if not result.end:
        result.errors = _errors(model, reference, signals, outcome.result)
    return result


def _signals(model: ModelDescription, reference: ResultTable, result: ExperimentComparison) -> list[str]:
    """Columns that are numeric variables; the others are reported, but texts."""
    known = model.by_name
    strange = [n for n in reference.columns if n not in known]
    if strange:
        result.problems.append(f"the result has columns {', '.join(strange[:5])}, the model does not")
    return [n for n in reference.columns if n in known and known[n].is_number]


# ---- what the child gets


def _job(
    model: ModelDescription,
    case: ShippedExperiment,
    reference: ResultTable,
    signals: Sequence[str],
    result: ExperimentComparison,
) -> dict[str, Any]:
    default = experiment(model, "startTime") or 0.0
    start = case.start if case.start is not None else default
    stop = case.stop if case.stop is not None else reference.time[-1]
    job: dict[str, Any] = {
        "start": start,
        "stop": stop,
        "step": case.step or _step(model, reference),
        "tolerance": case.tolerance or experiment(model, "tolerance"),
        "signals": list(signals),
        "times": [t for t in reference.time if start <= t <= stop * (1 + 1e-12)],
        "parameters": _parameters(model, case, result),
    }
    return job | _stimuli(model, case, result)


def _step(model: ModelDescription, reference: ResultTable) -> float:
    """As declared; what an FMU says nothing about is taken from the rows of the result."""
    gaps = [b - a for a, b in pairwise(reference.time) if b > a]
    declared = experiment(model, "stepSize") or inner_step(model)
    return declared or min(gaps, default=usual_step(model))


def _parameters(
    model: ModelDescription, case: ShippedExperiment, result: ExperimentComparison
) -> dict[str, Any]:
    if case.parameters is None:
        return {}
    values: dict[str, Any] = {}
    for name, text in parameter_set(case.parameters).items():
        v = model.by_name.get(name)
        if v is None or not _settable(v):
            why = "which cannot be set" if v else "which the model does not have"
            result.problems.append(f"{case.parameters.name} sets {name}, {why}")
        else:
            values[name] = text if v.type == "String" else _numbers(text, v, case.parameters.name)
    return values


def _settable(v: DeclaredVariable) -> bool:
    usual = v.variability != "constant" and (v.causality in SETTABLE or v.initial in ("exact", "approx"))
    return usual and (v.is_number or v.type == "String")


def _numbers(text: str, v: DeclaredVariable, file: str) -> list[float]:
    try:
        values = list(parse_numbers(text))
    except ValueError:
        values = []
    if len(values) != v.size:
        raise Problem(f"{file}: {v.name} is {text!r}, expected {v.size} numbers")
    return values


def _stimuli(
    model: ModelDescription, case: ShippedExperiment, result: ExperimentComparison
) -> dict[str, Any]:
    if case.stimuli is None:
        return {"inputs": [], "input_times": [], "input_rows": []}
    given = table(case.stimuli)
    names = [n for n in given.columns if n in model.by_name and model.by_name[n].is_number]
    strange = [n for n in given.columns if n not in model.by_name]
    if strange:
        result.problems.append(
            f"{case.stimuli.name} has columns {', '.join(strange[:5])}, the model does not"
        )
    columns = [_column(model.by_name[n], given.columns[n], case.stimuli.name) for n in names]
    rows = np.hstack(columns).tolist() if columns else [[] for _ in given.time]
    return {"inputs": names, "input_times": given.time, "input_rows": rows}


def _column(v: DeclaredVariable, texts: Sequence[str], file: str) -> NDArray[np.float64]:
    """Values of one variable over time, shape (n, size)."""
    return np.array([_numbers(text, v, file) for text in texts])


# ---- the comparison


def _errors(
    model: ModelDescription, reference: ResultTable, signals: Sequence[str], found: Mapping[str, Any]
) -> dict[str, float]:
    """NRMSE of each signal; of rows before and after the inputs were set those that fit better."""
    variables = [model.by_name[n] for n in signals]
    truth = np.hstack([_column(v, reference.columns[v.name], "result") for v in variables])
    places = np.array([int(np.argmin(np.abs(np.array(reference.time) - t))) for t in found["times"]])
    owners = flat(variables)
    expected = truth[places]
    errors: dict[str, float] = {}
    tries = [np.array(found[which]) for which in ("before", "after") if found[which]]
    for i, v in enumerate(owners):
        scale = _scale(expected[:, i], v)
        values = [float(np.sqrt(np.mean((rows[:, i] - expected[:, i]) ** 2))) / scale for rows in tries]
        best = min((x for x in values if not math.isnan(x)), default=math.inf)
        errors[v.name] = max(best, errors.get(v.name, 0.0))
    return errors


def _scale(column: NDArray[np.float64], v: DeclaredVariable) -> float:
    """Range; of a signal that rests its magnitude."""
    size, spread = float(np.max(np.abs(column))), float(np.ptp(column))
    return spread if spread > 1e-9 * size else max(size, v.nominal)


WRONG, POOR = 1e-2, 1e-3  # errors from which they are worth an error, a warning
LISTED = 6  # signals in a text


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
    found, texts = cases(folder, related)
    for text in texts:
        yield warning(text)
    for case in found:
        yield from _judged(subject, case)


def _inside(folder: Path, problem: Problem) -> str:
    """The text without the folder for the time of the check."""
    return str(problem).replace(f"{folder}/", "")


def _missing(related: list[Related]) -> Iterator[Finding]:
    for r in related:
        if r.path is None:
            yield note(f'{MANIFEST}: "{r.source}" lies outside of the FMU and was not looked at')
        elif not r.path.is_file():
            yield warning(f'{MANIFEST}: "{r.source}" (role {r.role}) is missing in the FMU')


# ---- which experiments there are


def cases(folder: Path, related: list[Related]) -> tuple[list[ShippedExperiment], list[str]]:
    """Experiments of the files with this role, then results without experiment; and what is left out."""
    there = [r for r in related if r.path is not None and r.path.is_file()]
    found: list[ShippedExperiment] = []
    texts: list[str] = []
    for r in there:
        if r.path is None or r.role.partition("/")[0] != "experiment":
            continue
        try:
            for case in experiments(folder, r.path):
                if isinstance(case, ShippedExperiment):
                    found.append(case)
                else:
                    texts.append(f"{shown(folder, r.path)}: {case}")
        except Problem as problem:
            texts.append(_inside(folder, problem))
    used = {case.reference for case in found}
    sets = [r.path for r in there if r.role == "parameter" and str(r.path).endswith(".ssv")]
    for r in there:
        if r.path is None or r.role != "result" or r.path in used or r.path.suffix.lower() != ".csv":
            continue
        one = sets[0] if len(sets) == 1 else None  # several are variants: none of them is the default
        found.append(ShippedExperiment(r.path.stem, r.path, one, _inputs_of(r.path)))
    return found, texts


def _inputs_of(result: Path) -> Path | None:
    """The inputs that belong to a result by their name: model_in.csv next to model_out.csv."""
    stem = result.stem
    for ending in ("_out", "_result", "_ref"):
        stem = stem.removesuffix(ending)
    names = (result.with_name(f"{stem}{ending}.csv") for ending in ("_in", "_input"))
    return next((p for p in names if p.is_file()), None)


# ---- how well they are met


def _judged(subject: Subject, case: ShippedExperiment) -> Iterator[Finding]:
    if why := first_run(subject).problem:
        yield note(f'experiment "{case.name}" was not run: {why}')
        return
    try:
        result = compare(subject, case)
    except Problem as problem:
        yield warning(f'experiment "{case.name}": {_inside(subject.folder.resolve(), problem)}')
        return
    for text in result.problems:
        yield warning(f'experiment "{case.name}": {text}')
    if result.end:
        say = note if result.late else error
        yield say(f'experiment "{case.name}" does not come to its end: {result.end}')
    elif result.errors:
        yield _summary(case, result)


def _summary(case: ShippedExperiment, result: ExperimentComparison) -> Finding:
    """The signals, worst first."""
    ranked = sorted(result.errors.items(), key=lambda item: -item[1])
    worst = ranked[0][1]
    texts = [f"{name} {value:.2g}" for name, value in ranked[:LISTED]]
    more = f" and {len(ranked) - LISTED} more" if len(ranked) > LISTED else ""
    word = "differs from" if worst > POOR else "agrees with"
    text = f'experiment "{case.name}" {word} {case.reference.name}: NRMSE over range {", ".join(texts)}{more}'
    return (error if worst > WRONG else warning if worst > POOR else note)(text)


EXPERIMENT = CheckRule(
    "reference.result", "The experiment that the FMU ships gives the result it ships", _experiment
)
