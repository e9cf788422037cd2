"""The first things: load, refuse a foreign token, log.

Where the FMU lies: folders with spaces and other letters, and the forms of the resource location.

More than one instance: side by side, and in threads.
"""

from __future__ import annotations

import ctypes
import shutil
import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from orchestrator.check.child.binary import STATUS, Missing, Refused
from orchestrator.check.child.instance import Instance
from orchestrator.check.child.main import Bench, Said
from orchestrator.check.child.player import Player, bits

NEEDED = (
    *("GetVersion", "SetDebugLogging", "FreeInstance", "EnterInitializationMode"),
    *("ExitInitializationMode", "Terminate", "Reset"),
)


def load(bench: Bench) -> Iterator[Said]:
    """The library loads, has the functions of its side, tells its version, and leaves again."""
    make = {2: ("Instantiate",) * 2, 3: ("InstantiateCoSimulation", "InstantiateModelExchange")}
    step = ("DoStep", "SetTime")
    i = 0 if bench.side == "cs" else 1
    for name in (*NEEDED, make[bench.declared.major][i], step[i]):
        if not bench.binary.has(name):
            yield "error", f"fmi{bench.declared.major}{name} is missing in the binary"
    version = bench.binary.raw("GetVersion", result=ctypes.c_char_p)
    expected = {2: (b"2.0",), 3: (b"3.0",)}[bench.declared.major]
    if not version or not version.startswith(expected):
        yield "error", f"fmi{bench.declared.major}GetVersion returns {version!r}, expected {expected[0]!r}"
    bench.binary.unload()


def token(bench: Bench) -> Iterator[Said]:
    """A binary of another build is noticed."""
    for wrong in ("{00000000-0000-0000-0000-000000000000}", bench.declared.token[:-1] + "?", ""):
        try:
            Instance(bench.binary, bench.side, bench.folder, token=wrong).free()
        except Refused:
            continue
        name = "GUID" if bench.declared.major == 2 else "instantiation token"
        yield "warning", f'an instance is made with the {name} "{wrong}", expected a refusal'
        return


def log(bench: Bench) -> Iterator[Said]:
    """With logging on: only declared categories and known statuses."""
    player = bench.player(logging=True)
    names = [c.encode() for c in bench.declared.categories]
    array = (ctypes.c_char_p * max(len(names), 1))(*names)
    on = ctypes.c_int(1) if bench.declared.major == 2 else ctypes.c_bool(True)
    try:
        player.instance.call("SetDebugLogging", on, ctypes.c_size_t(len(names)), array)
    except (Refused, Missing) as problem:
        given = "the log categories of modelDescription.xml" if names else "no log category, which means all"
        yield "warning", f"{problem}, with {given}"
    player.begin().run(3)
    player.close()
    said = dict.fromkeys((status, category) for status, category, _ in bench.binary.log.messages)
    for status, category in said:
        if not 0 <= status < len(STATUS):
            yield "warning", f"a message is logged with status {status}, expected 0 to {len(STATUS) - 1}"
        if category is None:
            yield "warning", "a message is logged without a category (NULL)"
        elif bench.declared.categories and category not in bench.declared.categories:
            listed = ", ".join(bench.declared.categories)
            yield (
                "warning",
                f'a message is logged in category "{category}", modelDescription.xml lists {listed}',
            )


ODD = "mit Leerzeichen # äß 林"
LARGE = 100e6  # bytes: a copy would take long


def resources(bench: Bench) -> Iterator[Said]:
    """The first values do not depend on the folder, nor on how its location is written."""
    if sum(p.stat().st_size for p in bench.folder.rglob("*") if p.is_file()) > LARGE:
        return
    plain = bench.player().begin()
    expected = [plain.row()]
    folder = Path.cwd() / ODD  # in the folder of the job, which the parent removes whatever happens here
    shutil.copytree(bench.folder, folder)
    (folder / "resources").mkdir(exist_ok=True)
    bench.folder = folder
    binary = bench.load(folder)
    for location, severity in _forms(bench.declared.major, folder / "resources"):
        case = f'with the resources at "{_shown(location, folder)}" in a folder "{ODD}"'
        bench.beacon.inputs(f"({case})")
        try:
            player = bench.player(binary=binary, resources=location).begin()
            row = [player.row()]
            player.close()
        except Refused as refusal:
            yield severity, f"{case}: {refusal}"
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


def instances(bench: Bench) -> Iterator[Said]:
    """Runs one after the other and side by side give the same bits as a run alone."""
    alone = _alone(bench, 0)
    other = _alone(bench, 5)
    again = _alone(bench, 0)
    if bits(alone) != bits(again):
        yield "error", f"a second run in the same process differs: {bench.difference(alone, again)}"
        return
    try:
        first, second = bench.player().begin(), bench.player(name="second").begin()
    except Refused as refusal:
        yield "error", f"a second instance cannot be made: {refusal}"
        return
    rows: tuple[list[list[float]], list[list[float]]] = ([first.row()], [second.row()])
    for n in range(STEPS):  # the second one is a step behind
        rows[0].append(_one(bench, first, n))
        rows[1].append(_one(bench, second, n + 5))
    for found, expected, which in ((rows[0], alone, "first"), (rows[1], other, "second")):
        if bits(found) != bits(expected):
            text = bench.difference(expected, found)
            yield "error", f"two instances disturb each other: in the {which} {text}"
            return


def _one(bench: Bench, player: Player, shift: int) -> list[float]:
    if bench.pokes:
        player.poke(shift)
    player.advance()
    return player.row()


def _alone(bench: Bench, shift: int, count: int = STEPS) -> list[list[float]]:
    player = bench.player().begin()
    rows = [player.row()]
    for n in range(count):
        if player.instance.ended:
            break
        rows.append(_one(bench, player, n + shift))
    player.close()
    return rows


def threads(bench: Bench) -> Iterator[Said]:
    """Instances in threads of their own give the serial bits."""
    count = 60
    serial = [_alone(bench, n, count) for n in range(THREADS)]
    before = sys.getswitchinterval()
    sys.setswitchinterval(1e-5)  # change threads between almost all calls
    with ThreadPoolExecutor(THREADS) as pool:
        parallel = list(pool.map(lambda n: _alone(bench, n, count), range(THREADS)))
    sys.setswitchinterval(before)
    for n in range(THREADS):
        if bits(serial[n]) != bits(parallel[n]):
            text = bench.difference(serial[n], parallel[n])
            yield "error", f"{THREADS} instances in {THREADS} threads: {text}"
            return
