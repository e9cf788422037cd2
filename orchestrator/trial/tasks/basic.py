"""The first things: load, refuse a foreign token, log."""

from __future__ import annotations

import ctypes
from collections.abc import Iterator

from orchestrator.trial.bench import Bench, Said
from orchestrator.trial.binary import STATUS, Missing, Refused
from orchestrator.trial.instance import Instance

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
