"""Reader of the FMI-LS-REF files in an FMU: manifest, experiments, parameter sets, tables.

Supported drafts: FMI-LS-REF 1.0.0-alpha.1, and both forms of the experiments format of the Modelica
Association, with the times in the element Experiment or in its child TransientSimulation.
"""

import csv
import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import unquote, urlsplit

from orchestrator.base.errors import Problem
from orchestrator.base.files import Location, has_control
from orchestrator.base.xml import Element, child, children, local_name, parse, read_xml

FOLDER = "extra/org.fmi-standard.fmi-ls-ref"
MANIFEST = f"{FOLDER}/fmi-ls-manifest.xml"
NAMESPACE = "http://fmi-standard.org/fmi-ls-manifest"
MAX_TABLE = 50 << 20  # bytes of a table, whose cells take ten times as many in memory
TYPES = ("text/csv", "application/x-ssp-parameter-set")  # media types of files that can be read
ANALYSES = (  # elements of experiments that are not simulations over time
    *("SteadyState", "ParameterOptimization", "SetPointOptimization"),
    *("SensitivityAnalysis", "TrajectoryOptimization", "Linearization"),
)


@dataclass(frozen=True)
class Related:
    """A file in the manifest; `path` is None if it is outside of the FMU."""

    source: str
    role: str
    path: Path | None


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


@dataclass(frozen=True)
class ResultTable:
    """Columns over time; cells are text, because they may contain arrays, booleans or strings."""

    time: list[float]
    columns: dict[str, list[str]]


def relative(folder: Path, path: Path) -> str:
    """A path relative to the FMU."""
    root = folder.resolve()
    return path.relative_to(root).as_posix() if path.is_relative_to(root) else path.name


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


def manifest(folder: Path) -> list[Related]:
    """The files in the manifest; raises Problem if the manifest cannot be read."""
    file = folder / MANIFEST
    root = parse(Location(file), "fmiReferences")
    name = root.get(f"{{{NAMESPACE}}}fmi-ls-name")
    if name != "org.fmi-standard.fmi-ls-ref":
        raise Problem(f"{MANIFEST}: fmi-ls-name: expected 'org.fmi-standard.fmi-ls-ref', got {name!r}")
    files = [(e.get("source", ""), e.get("role", "")) for e in children(root, "Related")]
    return [Related(source, role, resolve(folder, file.parent, source)) for source, role in files]


# ---- experiments


def experiments(folder: Path, file: Path) -> Iterator[ShippedExperiment | str]:
    """The experiments of a file; instead of one that cannot be run, a message."""
    root = parse(Location(file), "Experiments")
    for e in children(root, "Experiment"):
        name = e.get("name", file.stem)
        analyses = [local_name(x) for x in e if local_name(x) in ANALYSES]
        reference = _source(folder, file, e, "References")
        unknown = [
            f"{local_name(x)} of type {x.get('type')}" for x in e if x.get("type", TYPES[0]) not in TYPES
        ]
        if unknown:
            yield f'experiment "{name}": expected files of type {" or ".join(TYPES)}, got {unknown[0]}'
        elif analyses:
            yield f'experiment "{name}": expected a TransientSimulation, got a {analyses[0]}'
        elif reference is None:
            yield f'experiment "{name}" has no reference result'
        else:
            yield _case(folder, file, e, name, reference)


def _case(folder: Path, file: Path, e: Element, name: str, reference: Path) -> ShippedExperiment:
    inner = child(e, "TransientSimulation")
    parameters, stimuli = (_source(folder, file, e, tag) for tag in ("Parameters", "Stimuli"))
    numbers = []
    for key in ("startTime", "stopTime", "stepSize", "tolerance"):
        text = e.get(key) if inner is None or e.get(key) is not None else inner.get(key)
        try:
            numbers.append(None if text is None else float(text))
        except ValueError:
            where = f"{relative(folder, file)}: {name}: {key}"
            raise Problem(f"{where}: expected a number, got {text!r}") from None
    return ShippedExperiment(name, reference, parameters, stimuli, *numbers)


def _source(folder: Path, file: Path, e: Element, tag: str) -> Path | None:
    element = child(e, tag)
    if element is None:
        return None
    path = resolve(folder, file.parent, element.get("source", ""))
    if path is None or not os.path.isfile(path):
        source = element.get("source")
        raise Problem(f"{relative(folder, file)}: {tag}: {source!r} is missing in the FMU")
    return path


# ---- parameter sets and tables


def parameter_set(path: Path) -> dict[str, str]:
    """Name -> value of a parameter set in SSV format."""
    from orchestrator.ssp.parameter_sets import read_parameter_set

    values = read_parameter_set(read_xml(Location(path), "ParameterSet"), {})
    return {value.name: value.text for value in values}


def table(path: Path) -> ResultTable:
    """A CSV file with the time in the first column."""
    if (size := path.stat().st_size) > MAX_TABLE:
        raise Problem(f"{path.name}: expected at most {MAX_TABLE / 1e6:.0f} MB, got {size / 1e6:.0f} MB")
    try:
        text = path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise Problem(f"{path.name}: expected a CSV file in UTF-8, got {error}") from None
    head = text.partition("\n")[0]
    delimiter = ";" if ";" in head and "," not in head else ","
    try:
        # line by line: a quote without an end must not join rows
        rows = [r for line in text.splitlines() for r in csv.reader([line], delimiter=delimiter) if r]
    except csv.Error as error:  # such as a cell that is too long
        raise Problem(f"{path.name}: expected a CSV file, got {error}") from None
    if len(rows) < 2:
        raise Problem(f"{path.name}: expected a header and rows of numbers, got {len(rows)} lines")
    names = [n.strip() for n in rows[0]]
    for n, row in enumerate(rows, 1):
        if len(row) != len(names):
            raise Problem(f"{path.name}: line {n}: expected {len(names)} columns, got {len(row)}")
    try:
        time = [float(row[0]) for row in rows[1:]]
    except ValueError as error:
        raise Problem(f"{path.name}: expected times in the first column: {error}") from None
    return ResultTable(time, {name: [row[i] for row in rows[1:]] for i, name in enumerate(names) if i})
