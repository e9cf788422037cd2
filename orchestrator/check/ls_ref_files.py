"""The files of FMI-LS-REF in an FMU: manifest, experiments, parameter sets, tables.

Drafts read: FMI-LS-REF 1.0.0-alpha.1, and the experiments format of the Modelica Association in both forms
seen so far, with the times at the element Experiment or at TransientSimulation in it.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import unquote, urlsplit

from orchestrator.base.errors import Problem
from orchestrator.base.files import Location
from orchestrator.base.xml import Element, child, children, local_name, parse, read_xml

PLACE = "extra/org.fmi-standard.fmi-ls-ref"
MANIFEST = f"{PLACE}/fmi-ls-manifest.xml"
NAMESPACE = "http://fmi-standard.org/fmi-ls-manifest"
TYPES = ("text/csv", "application/x-ssp-parameter-set")  # of files that are read
ANALYSES = (  # of experiments that are no simulation over time
    *("SteadyState", "ParameterOptimization", "SetPointOptimization"),
    *("SensitivityAnalysis", "TrajectoryOptimization", "Linearization"),
)


@dataclass(frozen=True)
class Related:
    """A file that the manifest names; `path` is None when it lies elsewhere."""

    source: str
    role: str
    type: str
    path: Path | None


@dataclass(frozen=True)
class ShippedExperiment:
    """One experiment: times [s] that are None are those of the default experiment."""

    name: str
    reference: Path
    parameters: Path | None = None
    stimuli: Path | None = None
    start: float | None = None
    stop: float | None = None
    step: float | None = None
    tolerance: float | None = None


@dataclass(frozen=True)
class ResultTable:
    """Columns over time, as text."""

    time: list[float]
    columns: dict[str, list[str]]


def shown(folder: Path, path: Path) -> str:
    """A path as it stands in the FMU."""
    return (
        path.relative_to(folder.resolve()).as_posix() if path.is_relative_to(folder.resolve()) else path.name
    )


def resolve(folder: Path, base: Path, source: str) -> Path | None:
    """The file that a relative URI in a file of folder `base` names; None when it leads out of the FMU."""
    parts = urlsplit(source)
    if parts.scheme or parts.netloc or not parts.path or parts.path.startswith("/"):
        return None
    path = (base / unquote(parts.path)).resolve()
    return path if path.is_relative_to(folder.resolve()) else None


def manifest(folder: Path) -> list[Related]:
    """What the manifest names; raises Problem when it cannot be read."""
    file = folder / MANIFEST
    root = parse(Location(file), "fmiReferences")
    name = root.get(f"{{{NAMESPACE}}}fmi-ls-name")
    if name != "org.fmi-standard.fmi-ls-ref":
        raise Problem(f"{MANIFEST}: fmi-ls-name is {name!r}, expected 'org.fmi-standard.fmi-ls-ref'")
    return [_related(folder, file.parent, e) for e in children(root, "Related")]


def _related(folder: Path, base: Path, element: Element) -> Related:
    source, role = element.get("source", ""), element.get("role", "")
    kind = element.get("type", "application/octet-stream")
    return Related(source, role, kind, resolve(folder, base, source))


# ---- experiments


def experiments(folder: Path, file: Path) -> Iterator[ShippedExperiment | str]:
    """The experiments of a file; a text where one is left out."""
    root = parse(Location(file), "Experiments")
    for e in children(root, "Experiment"):
        name = e.get("name", file.stem)
        other = [local_name(x) for x in e if local_name(x) in ANALYSES]
        reference = _source(folder, file, e, "References")
        strange = [
            f"{local_name(x)} of type {x.get('type')}" for x in e if x.get("type", TYPES[0]) not in TYPES
        ]
        if strange:
            yield f'experiment "{name}" has {strange[0]}, expected {" or ".join(TYPES)}'
        elif other:
            yield f'experiment "{name}" is a {other[0]}, expected a TransientSimulation'
        elif reference is None:
            yield f'experiment "{name}" has no reference result'
        else:
            yield _case(folder, file, e, name, reference)


def _case(folder: Path, file: Path, e: Element, name: str, reference: Path) -> ShippedExperiment:
    inner = child(e, "TransientSimulation")

    def number(key: str) -> float | None:
        text = e.get(key) if inner is None or e.get(key) is not None else inner.get(key)
        try:
            return None if text is None else float(text)
        except ValueError:
            raise Problem(
                f"{shown(folder, file)}: {name}: expected a number for {key}, got {text!r}"
            ) from None

    return ShippedExperiment(
        name=name,
        reference=reference,
        parameters=_source(folder, file, e, "Parameters"),
        stimuli=_source(folder, file, e, "Stimuli"),
        start=number("startTime"),
        stop=number("stopTime"),
        step=number("stepSize"),
        tolerance=number("tolerance"),
    )


def _source(folder: Path, file: Path, e: Element, tag: str) -> Path | None:
    found = child(e, tag)
    if found is None:
        return None
    path = resolve(folder, file.parent, found.get("source", ""))
    if path is None or not path.is_file():
        raise Problem(f"{shown(folder, file)}: {found.get('source')!r} of {tag} is missing in the FMU")
    return path


# ---- parameter sets and tables


def parameter_set(path: Path) -> dict[str, str]:
    """Name -> value of a parameter set in SSV format."""
    from orchestrator.ssp.parameter_sets import read_parameter_set

    values = read_parameter_set(read_xml(Location(path), "ParameterSet"), {})
    return {value.name: value.text for value in values}


def table(path: Path) -> ResultTable:
    """A CSV file whose first column is the time."""
    try:
        text = path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise Problem(f"{path.name}: is not a CSV file: {error}") from None
    head = text.partition("\n")[0]
    delimiter = ";" if ";" in head and "," not in head else ","
    rows = [r for r in csv.reader(io.StringIO(text, newline=""), delimiter=delimiter) if r]
    if len(rows) < 2:
        raise Problem(f"{path.name}: expected a header and rows of numbers, got {len(rows)} lines")
    names = [n.strip() for n in rows[0]]
    wrong = next((n for n, row in enumerate(rows, 1) if len(row) != len(names)), None)
    if wrong is not None:
        raise Problem(f"{path.name}: line {wrong} has {len(rows[wrong - 1])} columns, expected {len(names)}")
    try:
        time = [float(row[0]) for row in rows[1:]]
    except ValueError as error:
        raise Problem(f"{path.name}: the first column is not the time: {error}") from None
    return ResultTable(time, {name: [row[i] for row in rows[1:]] for i, name in enumerate(names) if i})
