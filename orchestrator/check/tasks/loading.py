"""Tasks on loading and instances: functions, token, log, resource location, several instances, threads."""

import ctypes
import shutil
import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from orchestrator.base.errors import Problem
from orchestrator.check.tasks.runner import Remark, Trial
from orchestrator.check.tasks.trial_run import MAX_INNER_STEPS, Simulation, Vector, difference, severity
from orchestrator.fmi.instance import CallFailed
from orchestrator.fmi.messages import STATUS


def load(trial: Trial) -> Iterator[Remark]:
    """The library loads, returns its version, and can be unloaded."""
    library, fmi = trial.library, trial.description.major
    trial.activity.call(f"fmi{fmi}GetVersion")
    version = library.function("GetVersion", ctypes.c_char_p)()
    expected = f"{fmi}.0".encode()
    if not version or not version.startswith(expected):
        yield "error", f"fmi{fmi}GetVersion returns {version!r}, expected {expected!r}"
    trial.activity.call("unloading the binary")
    library.close()


def token(trial: Trial) -> Iterator[Remark]:
    """Instantiation with the GUID or token of another build fails."""
    for wrong in ("{00000000-0000-0000-0000-000000000000}", trial.description.token[:-1] + "?", ""):
        try:
            trial.instance(token=wrong).free()
        except CallFailed:
            continue
        name = "GUID" if trial.description.major == 2 else "instantiation token"
        yield "warning", f'instantiation succeeds with the {name} "{wrong}", expected it to fail'
        return


def log(trial: Trial) -> Iterator[Remark]:
    """With logging on, messages have declared categories and valid statuses."""
    simulation = Simulation(trial, verbose=True)
    instance, categories = simulation.instance, trial.description.categories
    array = (ctypes.c_char_p * max(len(categories), 1))(*(c.encode() for c in categories))
    try:
        instance.call("SetDebugLogging", instance.flag(True), ctypes.c_size_t(len(categories)), array)
    except Problem as problem:
        declared = "the log categories of modelDescription.xml"
        yield "warning", f"{problem}, with {declared if categories else 'no category, which means all'}"
    simulation.begin().run(3)
    simulation.close()
    for status, category in dict.fromkeys((m.status, m.category) for m in instance.log.messages):
        if status not in STATUS:
            yield "warning", f"a message is logged with status {status}, expected 0 to {len(STATUS) - 1}"
        if category is None:
            yield "warning", "a message is logged without a category (NULL)"
        elif categories and category not in categories:
            text = f'a message is logged in category "{category}"'
            yield "warning", f"{text}, modelDescription.xml declares {', '.join(categories)}"


FOLDER = "mit Leerzeichen # äß 林"
LARGE = 100e6  # bytes; larger FMUs are not copied, because that takes long


def resources(trial: Trial) -> Iterator[Remark]:
    """The initial outputs depend neither on the folder of the FMU nor on how its location is written."""
    if sum(p.stat().st_size for p in trial.folder.rglob("*") if p.is_file()) > LARGE:
        return
    expected = [Simulation(trial).begin().row()]
    folder = Path.cwd() / FOLDER  # below the folder of the worker process, which the parent process removes
    shutil.copytree(trial.folder, folder)
    (folder / "resources").mkdir(exist_ok=True)
    trial.folder = folder
    library = trial.load(folder)
    for location, grave in _locations(trial.description.major, folder / "resources"):
        case = f'with the resources at "{_shown(location, folder)}" in a folder "{FOLDER}"'
        trial.activity.case(case)
        try:
            simulation = Simulation(trial, library=library, resources=location).begin()
            row = [simulation.row()]
            simulation.close()
        except CallFailed as failure:
            yield grave, f"{case}: {failure}"
            continue
        if difference(trial, expected, row):
            yield grave, f"{case} the first outputs differ"


def _shown(location: str, folder: Path) -> str:
    """A location, with FOLDER instead of the path of the temporary folder."""
    uri = folder.as_uri()
    location = location.replace(uri, "file:///FOLDER")
    return location.replace(uri.replace("file:///", "file:/"), "file:/FOLDER").replace(str(folder), "FOLDER")


def _locations(major: int, resources_folder: Path) -> list[tuple[str, str]]:
    """Spellings of the location, the usual one first, each with the severity of a failure."""
    if major == 3:  # the standard requires a separator at the end
        return [(f"{resources_folder}/", "error"), (str(resources_folder), "note")]
    uri = resources_folder.as_uri()
    return [(uri, "error"), (f"{uri}/", "warning"), (uri.replace("file:///", "file:/"), "warning")]


STEPS = 12
THREADS, RUNS = 4, 32


def instances(trial: Trial) -> Iterator[Remark]:
    """Consecutive and interleaved runs are bit-identical to a single run."""
    expected, shifted, repeated = _single_run(trial, 0), _single_run(trial, 5), _single_run(trial, 0)
    if text := difference(trial, expected, repeated):
        yield "warning", f"a second run in the same process differs: {text}"
        return
    try:
        first, second = Simulation(trial).begin(), Simulation(trial, name="second").begin()
    except CallFailed as failure:
        yield "error", f"a second instance cannot be created: {failure}"
        return
    rows = [first.row()], [second.row()]
    for n in range(STEPS):
        rows[0].append(_step(trial, first, n))
        rows[1].append(_step(trial, second, n + 5))
    for interleaved, single, which in ((rows[0], expected, "first"), (rows[1], shifted, "second")):
        if text := difference(trial, single, interleaved):
            grave = severity(trial, single, interleaved)
            yield grave, f"two instances disturb each other: in the {which} {text}"
            return


def _step(trial: Trial, simulation: Simulation, number: int) -> Vector:
    """The outputs after a step with the input perturbation of this number."""
    if trial.perturbable:
        simulation.perturb(number)
    simulation.advance()
    return simulation.row()


def _single_run(trial: Trial, shift: int, count: int = STEPS) -> list[Vector]:
    simulation = Simulation(trial).begin()
    rows = [simulation.row()]
    for n in range(count):
        if simulation.ended:
            break
        rows.append(_step(trial, simulation, n + shift))
    simulation.close()
    return rows


def threads(trial: Trial) -> Iterator[Remark]:
    """Runs in parallel threads are bit-identical to serial runs."""
    count = 30 if trial.kind == "CoSimulation" else 30 // MAX_INNER_STEPS  # each with as many calls
    serial = [_single_run(trial, n, count) for n in range(THREADS)]
    interval = sys.getswitchinterval()
    sys.setswitchinterval(1e-5)  # the interpreter changes threads between almost all calls
    with ThreadPoolExecutor(THREADS) as pool:
        parallel = list(pool.map(lambda n: _single_run(trial, n % THREADS, count), range(RUNS)))
    sys.setswitchinterval(interval)
    for n, rows in enumerate(parallel):
        if text := difference(trial, serial[n % THREADS], rows):
            yield "warning", f"{THREADS} instances in {THREADS} threads: {text}"
            return
