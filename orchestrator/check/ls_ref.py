"""Rule that runs the experiments shipped with an FMU and compares with the shipped results.

Draft FMI-LS-REF 1.0.0-alpha.1: manifest, parameter sets, tables, and both forms of the experiments of the
Modelica Association, with the times in the element Experiment or in its child TransientSimulation. The error
of a signal is the root mean square of its deviation over the range of the reference (NRMSE).
"""

import csv
import math
import os
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urlsplit

import numpy as np

from orchestrator.base.errors import Problem
from orchestrator.base.files import Location, has_control
from orchestrator.base.signals import rms, span
from orchestrator.base.xml import Element, child, children, local_name, parse, read_xml
from orchestrator.check.finding import Finding, error, note, warning
from orchestrator.check.probe_process import run
from orchestrator.check.probes import first_run
from orchestrator.check.rule import CheckRule
from orchestrator.check.subject import Subject
from orchestrator.check.tasks.trial_run import flat, inner_step, usual_step
from orchestrator.fmi.description import FmuVariable, ModelDescription, parse_numbers
from orchestrator.ssp.parameter_sets import read_parameter_set

FOLDER = "extra/org.fmi-standard.fmi-ls-ref"
MANIFEST = f"{FOLDER}/fmi-ls-manifest.xml"
NAMESPACE = "http://fmi-standard.org/fmi-ls-manifest"
MAX_TABLE = 50 << 20  # bytes of a table, whose cells take ten times as many in memory
TYPES = ("text/csv", "application/x-ssp-parameter-set")  # media types of files that can be read
RUN = ("Parameters", "Stimuli", "References", "TransientSimulation", "Annotations")  # of a simulation
ERROR_LEVEL, WARNING_LEVEL = 1e-2, 1e-3  # NRMSE above which a finding is an error, a warning
OF_TOLERANCE = 1e4  # as is NRMSE above this multiple of a stated tolerance: a pressure that is 0.01 % off
MAX_LISTED = 6  # signals in a message


@dataclass(frozen=True)
class ShippedExperiment:
    """One experiment; times [s] that are None are those of the default experiment."""

    name: str
    reference: Path
    parameters: Path | None = None
    stimuli: Path | None = None
    start: float | None = None
    stop: float | None = None
    step: float | None = None
    tolerance: float | None = None


def resolve(folder: Path, base: Path, source: str) -> Path | None:
    """The file of a URI that is relative to the folder `base`; None if it is outside of the FMU."""
    try:
        parts = urlsplit(source)
    except ValueError:  # such as brackets without end
        return None
    name = unquote(parts.path)
    if parts.scheme or parts.netloc or not name or name.startswith("/") or has_control(name):
        return None
    path = (base / name).resolve()
    return path if path.is_relative_to(folder.resolve()) else None


def cases(folder: Path) -> tuple[list[ShippedExperiment], list[str]]:
    """The experiments of the manifest, then results without one; and messages about what cannot be run."""
    file, present = folder / MANIFEST, list[tuple[Path, str]]()
    root = parse(Location(file), "fmiReferences")
    name = root.get(f"{{{NAMESPACE}}}fmi-ls-name")
    if name != "org.fmi-standard.fmi-ls-ref":
        raise Problem(f"{MANIFEST}: fmi-ls-name: expected 'org.fmi-standard.fmi-ls-ref', got {name!r}")
    shipped, problems = list[ShippedExperiment](), list[str]()
    for e in children(root, "Related"):
        source, role = e.get("source", ""), e.get("role", "")
        path = resolve(folder, file.parent, source)
        if path is None:
            problems.append(f'{MANIFEST}: "{source}" is outside of the FMU and was not read')
        elif not os.path.isfile(path):
            problems.append(f'{MANIFEST}: "{source}" (role {role}) is missing in the FMU')
        else:
            present.append((path, role))
    for path in (path for path, role in present if role.partition("/")[0] == "experiment"):
        try:
            experiments = children(parse(Location(path), "Experiments"), "Experiment")
            shipped += [_case(folder, path, e) for e in experiments]
        except Problem as problem:
            problems.append(_inside(folder, problem))
    used = {case.reference for case in shipped}
    sets = [path for path, role in present if role == "parameter" and path.suffix == ".ssv"]
    parameters = sets[0] if len(sets) == 1 else None  # several sets are variants, none is the default
    for path, role in present:
        if role == "result" and path not in used and path.suffix.lower() == ".csv":
            inputs = path.with_name(path.name.replace("_out.", "_in."))  # model_in.csv for model_out.csv
            own = inputs if inputs != path and inputs.is_file() else None
            shipped.append(ShippedExperiment(path.stem, path, parameters, own))
    return shipped, problems


def _inside(folder: Path, problem: Problem) -> str:
    """The message with paths relative to the FMU instead of the temporary folder."""
    return str(problem).replace(f"{folder.resolve()}/", "").replace(f"{folder}/", "")


def _case(folder: Path, file: Path, e: Element) -> ShippedExperiment:
    name, inner = e.get("name", file.stem), child(e, "TransientSimulation")
    for other in (x for x in e if isinstance(x.tag, str)):
        if local_name(other) not in RUN:
            raise Problem(f'experiment "{name}": expected a TransientSimulation, got a {local_name(other)}')
        if (kind := other.get("type", TYPES[0])) not in TYPES:
            got = f"{local_name(other)} of type {kind}"
            raise Problem(f'experiment "{name}": expected files of type {" or ".join(TYPES)}, got {got}')
    files, numbers = dict[str, Path | None](), list[float | None]()
    for tag in ("References", "Parameters", "Stimuli"):
        source = None if (named := child(e, tag)) is None else named.get("source", "")
        files[tag] = path = None if source is None else resolve(folder, file.parent, source)
        if source is not None and (path is None or not os.path.isfile(path)):
            raise Problem(f"{file.name}: {tag}: {source!r} is missing in the FMU")
    for key in ("startTime", "stopTime", "stepSize", "tolerance"):
        text = e.get(key) if inner is None or e.get(key) is not None else inner.get(key)
        try:
            numbers.append(None if text is None else float(text))
        except ValueError:
            raise Problem(f"{file.name}: {name}: {key}: expected a number, got {text!r}") from None
    if (reference := files["References"]) is None:
        raise Problem(f'experiment "{name}" has no reference result')
    return ShippedExperiment(name, reference, files["Parameters"], files["Stimuli"], *numbers)


def parameter_set(path: Path) -> dict[str, str]:
    """Name -> value of a parameter set in SSV format."""
    values = read_parameter_set(read_xml(Location(path), "ParameterSet"), {})
    return {value.name: value.text for value in values}


def table(path: Path) -> tuple[list[float], dict[str, list[str]]]:
    """Times and columns of a CSV file; cells are text, as they may contain arrays, booleans or strings."""
    if (size := path.stat().st_size) > MAX_TABLE:
        raise Problem(f"{path.name}: expected at most {MAX_TABLE / 1e6:.0f} MB, got {size / 1e6:.0f} MB")
    try:
        text = path.read_text(encoding="utf-8-sig")
        head = text.partition("\n")[0]
        delimiter = ";" if ";" in head and "," not in head else ","
        # line by line: a quote without an end must not join rows
        rows = [r for line in text.splitlines() for r in csv.reader([line], delimiter=delimiter) if r]
    except (UnicodeDecodeError, csv.Error) as reason:  # such as a cell that is too long
        raise Problem(f"{path.name}: expected a CSV file in UTF-8, got {reason}") from None
    if len(rows) < 2:
        raise Problem(f"{path.name}: expected a header and rows of numbers, got {len(rows)} lines")
    names = [n.strip() for n in rows[0]]
    for n, row in enumerate(rows, 1):
        if len(row) != len(names):
            raise Problem(f"{path.name}: line {n}: expected {len(names)} columns, got {len(row)}")
    try:
        time = [float(row[0]) for row in rows[1:]]
    except ValueError as reason:
        raise Problem(f"{path.name}: expected times in the first column: {reason}") from None
    return time, {name: [row[i] for row in rows[1:]] for i, name in enumerate(names) if i}


@dataclass
class ExperimentComparison:
    """Errors of one experiment, and problems with its files or its run."""

    errors: dict[str, float] = field(default_factory=dict)  # signal -> NRMSE
    problems: list[str] = field(default_factory=list)  # about signals that cannot be compared or set
    failure: str = ""  # why the run was not completed
    late: bool = False  # the run was stopped because its time was over


def compare_experiment(subject: Subject, case: ShippedExperiment) -> ExperimentComparison:
    """Run an experiment and compare; raises Problem if a file cannot be read."""
    model, kind, result = subject.model, first_run(subject).kinds[0], ExperimentComparison()
    time, columns = table(case.reference)
    expected = _numbers_of(model, columns, "the result", result)
    if not expected:
        result.problems.append(f"{case.reference.name} has no column of a numeric variable of the model")
        return result
    input_time, inputs = table(case.stimuli) if case.stimuli else ([], {})
    driven = _numbers_of(model, inputs, case.stimuli.name if case.stimuli else "", result)
    start = case.start if case.start is not None else model.experiment.number("startTime") or 0.0
    stop = case.stop if case.stop is not None else time[-1]
    shortest = min((b - a for a, b in pairwise(time) if b > a), default=usual_step(model))
    job: dict[str, Any] = {
        "start": start,
        "stop": stop,
        "step": case.step or model.experiment.number("stepSize") or inner_step(model) or shortest,
        "tolerance": case.tolerance or model.experiment.number("tolerance"),
        "signals": list(expected),
        "times": [t for t in time if start <= t <= stop * (1 + 1e-12)],
        "parameters": _parameters(model, case.parameters, result),
        "inputs": list(driven),
        "input_times": input_time,
        "input_rows": np.hstack([*driven.values()]).tolist() if driven else [[] for _ in input_time],
    }
    described = model.for_run(*job["signals"], *job["inputs"], *job["parameters"])
    outcome = run(subject.folder, described, kind, "shipped_experiment:run", payload=job)
    errors = (text for severity, text in outcome.remarks if severity == "error")
    result.late, result.failure = outcome.late, outcome.failure or next(errors, "")
    if not result.failure:
        nearest = [int(np.argmin(np.abs(np.array(time) - t))) for t in outcome.result["times"]]
        variables = [model.by_name[name] for name in expected]
        result.errors = _errors(variables, np.hstack([*expected.values()])[nearest], outcome.result)
    return result


def _numbers_of(
    model: ModelDescription, columns: Mapping[str, list[str]], file: str, result: ExperimentComparison
) -> dict[str, Any]:
    """Values of the numeric variables over time, shape (n, size); columns that are none are reported."""
    variables = model.by_name
    if unknown := ", ".join([n for n in columns if n not in variables][:5]):
        result.problems.append(f"the model has no variables {unknown}, which {file} contains")
    known = {n: variables[n] for n in columns if n in variables and variables[n].is_number}
    return {n: np.array([_numbers(text, v, file) for text in columns[n]]) for n, v in known.items()}


def _parameters(model: ModelDescription, file: Path | None, result: ExperimentComparison) -> dict[str, Any]:
    values: dict[str, Any] = {}
    for name, text in (parameter_set(file) if file else {}).items():
        v, where = model.by_name.get(name), file.name if file else ""
        if v is None or not (v.settable and (v.is_number or v.type == "String")):
            reason = "cannot be set" if v else "is not a variable of the model"
            result.problems.append(f"{where} sets {name}, which {reason}")
        else:
            values[name] = text if v.type == "String" else _numbers(text, v, where)
    return values


def _numbers(text: str, v: FmuVariable, file: str) -> list[float]:
    try:
        values = list(parse_numbers(text))
    except ValueError:
        values = []
    if len(values) != v.size:
        raise Problem(f"{file}: {v.name}: expected {v.size} numbers, got {text!r}")
    return values


def _errors(variables: Iterable[FmuVariable], expected: Any, found: Mapping[str, Any]) -> dict[str, float]:
    """NRMSE of each signal, the smaller one of the rows before and after the inputs are set."""
    errors, results = dict[str, float](), [np.array(found[key]) for key in ("before", "after")]
    for i, v in enumerate(flat(list(variables))):
        column = expected[:, i]
        scale = span(column) or max(float(np.max(np.abs(column))), v.magnitude)  # of a constant its magnitude
        values = [rms(rows[:, i] - column) / scale for rows in results]
        smallest = min((x for x in values if not math.isnan(x)), default=math.inf)
        errors[v.name] = max(smallest, errors.get(v.name, 0.0))
    return errors


def _experiment(subject: Subject) -> Iterable[Finding]:
    folder = subject.folder.resolve()
    if not (folder / MANIFEST).is_file():
        return
    try:
        shipped, problems = cases(folder)
    except Problem as problem:
        shipped, problems = [], [_inside(folder, problem)]
    yield from map(warning, problems)
    yield from (finding for case in shipped for finding in _findings(subject, case))


def _findings(subject: Subject, case: ShippedExperiment) -> Iterator[Finding]:
    name = f'experiment "{case.name}"'
    only = "it has only Model Exchange" if [*first_run(subject).kinds] == ["ModelExchange"] else ""
    if reason := first_run(subject).problem or only:
        yield note(f"{name} was not run: {reason}")
        return
    try:
        result = compare_experiment(subject, case)
    except Problem as problem:
        yield warning(f"{name}: {_inside(subject.folder, problem)}")
        return
    yield from (warning(f"{name}: {text}") for text in result.problems)
    if result.failure:
        yield (note if result.late else error)(f"{name} was not completed: {result.failure}")
    elif result.errors:  # the signals, worst first
        ranked = sorted(result.errors.items(), key=lambda item: -item[1])
        worst, level = ranked[0][1], min(ERROR_LEVEL, OF_TOLERANCE * (case.tolerance or math.inf))
        errors = ", ".join(f"{signal} {value:.2g}" for signal, value in ranked[:MAX_LISTED])
        more = f" and {len(ranked) - MAX_LISTED} more" if len(ranked) > MAX_LISTED else ""
        make = error if worst > level else warning if worst > WARNING_LEVEL else note
        verb = "agrees with" if make is note else "differs from"
        yield make(f"{name} {verb} {case.reference.name}: NRMSE {errors}{more}")


EXPERIMENT = CheckRule(
    "reference.result",
    "The FMU reproduces the result of the experiment that it ships",
    _experiment,
    "draft of FMI-LS-REF",
)
