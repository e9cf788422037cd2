"""The first things: load, refuse the token of another build, log; other folders; more than one instance."""

from __future__ import annotations

import ctypes
import shutil
import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from orchestrator.base.errors import Problem
from orchestrator.check.tasks.runner import Remark, Trial
from orchestrator.check.tasks.trial_run import Rows, Simulation, bits, difference
from orchestrator.fmi.instance import CallFailed
from orchestrator.fmi.messages import STATUS

NEEDED = (
    *("GetVersion", "SetDebugLogging", "FreeInstance", "EnterInitializationMode"),
    *("ExitInitializationMode", "Terminate", "Reset"),
)


def load(trial: Trial) -> Iterator[Remark]:
    """The library loads, has the functions of its interface, returns its version, and leaves again."""
    library, fmi, kind = trial.library, trial.description.major, trial.kind
    make = "Instantiate" if fmi == 2 else f"Instantiate{kind}"
    for name in (*NEEDED, make, "DoStep" if kind == "CoSimulation" else "SetTime"):
        if not library.has(name):
            yield "error", f"fmi{fmi}{name} is missing in the binary"
    trial.beacon.call(f"fmi{fmi}GetVersion")
    version = library.function("GetVersion", ctypes.c_char_p)()
    expected = f"{fmi}.0".encode()
    if not version or not version.startswith(expected):
        yield "error", f"fmi{fmi}GetVersion returns {version!r}, expected {expected!r}"
    trial.beacon.call("unloading the binary")
    library.close()


def token(trial: Trial) -> Iterator[Remark]:
    """A binary of another build is noticed."""
    for wrong in ("{00000000-0000-0000-0000-000000000000}", trial.description.token[:-1] + "?", ""):
        try:
            trial.instance(token=wrong).free()
        except CallFailed:
            continue
        name = "GUID" if trial.description.major == 2 else "instantiation token"
        yield "warning", f'an instance is made with the {name} "{wrong}", expected a refusal'
        return


def log(trial: Trial) -> Iterator[Remark]:
    """With logging on: only declared categories and known statuses."""
    simulation = Simulation(trial, verbose=True)
    instance, listed = simulation.instance, trial.description.categories
    array = (ctypes.c_char_p * max(len(listed), 1))(*(c.encode() for c in listed))
    try:
        instance.call("SetDebugLogging", instance.flag(True), ctypes.c_size_t(len(listed)), array)
    except Problem as problem:
        given = "the log categories of modelDescription.xml" if listed else "no log category, which means all"
        yield "warning", f"{problem}, with {given}"
    simulation.begin().run(3)
    simulation.close()
    for status, category in dict.fromkeys((m.status, m.category) for m in instance.log.messages):
        if status not in STATUS:
            yield "warning", f"a message is logged with status {status}, expected 0 to {len(STATUS) - 1}"
        if category is None:
            yield "warning", "a message is logged without a category (NULL)"
        elif listed and category not in listed:
            text = f'a message is logged in category "{category}"'
            yield "warning", f"{text}, modelDescription.xml lists {', '.join(listed)}"


FOLDER = "mit Leerzeichen # äß 林"
LARGE = 100e6  # bytes: a copy would take long


def resources(trial: Trial) -> Iterator[Remark]:
    """The first values do not depend on the folder, nor on how its location is written."""
    if sum(p.stat().st_size for p in trial.folder.rglob("*") if p.is_file()) > LARGE:
        return
    plain = Simulation(trial).begin()
    expected = [plain.row()]
    folder = Path.cwd() / FOLDER  # in the folder of the job, which the parent removes whatever happens here
    shutil.copytree(trial.folder, folder)
    (folder / "resources").mkdir(exist_ok=True)
    trial.folder = folder
    library = trial.load(folder)
    for location, severity in _forms(trial.description.major, folder / "resources"):
        case = f'with the resources at "{_shown(location, folder)}" in a folder "{FOLDER}"'
        trial.beacon.inputs(f"({case})")
        try:
            simulation = Simulation(trial, library=library, resources=location).begin()
            row = [simulation.row()]
            simulation.close()
        except CallFailed as failure:
            yield severity, f"{case}: {failure}"
            continue
        if bits(row) != bits(expected):
            yield severity, f"{case} the first outputs differ"


def _shown(location: str, folder: Path) -> str:
    """A location without the path of the temporary folder."""
    uri = folder.as_uri()
    location = location.replace(uri, "file:///FOLDER")
    return location.replace(uri.replace("file:///", "file:/"), "file:/FOLDER").replace(str(folder), "FOLDER")


def _forms(major: int, there: Path) -> list[tuple[str, str]]:
    """Ways to write the location, the usual one first, and how bad it is when it does not work."""
    if major == 3:  # the standard wants a separator at the end
        return [(f"{there}/", "error"), (str(there), "note")]
    uri = there.as_uri()
    return [(uri, "error"), (f"{uri}/", "warning"), (uri.replace("file:///", "file:/"), "warning")]


STEPS = 12
THREADS = 4


def instances(trial: Trial) -> Iterator[Remark]:
    """Runs one after the other and side by side give the same bits as a run alone."""
    alone = _alone(trial, 0)
    other = _alone(trial, 5)
    again = _alone(trial, 0)
    if bits(alone) != bits(again):
        yield "error", f"a second run in the same process differs: {difference(trial, alone, again)}"
        return
    try:
        first, second = Simulation(trial).begin(), Simulation(trial, name="second").begin()
    except CallFailed as failure:
        yield "error", f"a second instance cannot be made: {failure}"
        return
    rows: tuple[Rows, Rows] = ([first.row()], [second.row()])
    for n in range(STEPS):  # the second one is a step behind
        rows[0].append(_one(trial, first, n))
        rows[1].append(_one(trial, second, n + 5))
    for found, expected, which in ((rows[0], alone, "first"), (rows[1], other, "second")):
        if bits(found) != bits(expected):
            text = difference(trial, expected, found)
            yield "error", f"two instances disturb each other: in the {which} {text}"
            return


def _one(trial: Trial, simulation: Simulation, shift: int) -> list[float]:
    if trial.pokes:
        simulation.poke(shift)
    simulation.advance()
    return simulation.row()


def _alone(trial: Trial, shift: int, count: int = STEPS) -> Rows:
    simulation = Simulation(trial).begin()
    rows = [simulation.row()]
    for n in range(count):
        if simulation.ended:
            break
        rows.append(_one(trial, simulation, n + shift))
    simulation.close()
    return rows


def threads(trial: Trial) -> Iterator[Remark]:
    """Instances in threads of their own give the serial bits."""
    count = 60
    serial = [_alone(trial, n, count) for n in range(THREADS)]
    before = sys.getswitchinterval()
    sys.setswitchinterval(1e-5)  # change threads between almost all calls
    with ThreadPoolExecutor(THREADS) as pool:
        parallel = list(pool.map(lambda n: _alone(trial, n, count), range(THREADS)))
    sys.setswitchinterval(before)
    for n in range(THREADS):
        if bits(serial[n]) != bits(parallel[n]):
            text = difference(trial, serial[n], parallel[n])
            yield "error", f"{THREADS} instances in {THREADS} threads: {text}"
            return
