"""Damaged and hostile FMUs and SSPs: one line or findings, in bounded time and memory, and nothing touched.

The damage follows from a seed, so a failure can be repeated: `examine` prints the seeds that fail.
"""

import io
import os
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import pytest
from check.good import BUILD, DESCRIPTION, TERMINALS, XML_2, XML_3
from files.damage import damaged
from kit import shards
from kit.any_fmu.description import packed
from kit.any_fmu.models import Workshop

from fmus.machine.build import VIEW
from orchestrator import load
from orchestrator.base import files
from orchestrator.base.errors import Problem
from orchestrator.check.checking import DEFECT, check
from orchestrator.check.subject import open_subject
from orchestrator.cli.lists import lines
from orchestrator.drive.view_description import view_description
from orchestrator.ssp.dependencies import output_order
from orchestrator.ssp.parameter_sets import parameter_sets, with_sets
from orchestrator.ssp.swap import with_swaps
from orchestrator.ssp.system import System

LONGEST = 10.0  # s of the processor for one file; a good one takes 0.1 s
MOST = 1e9  # bytes
HERE = Path(__file__).parent
OUTER, INNER, START, MAPPING = (
    (HERE / "system" / name).read_text("utf-8")
    for name in ("SystemStructure.ssd", "other.ssd", "start.ssv", "names.ssm")
)
Good = Mapping[str, bytes]


def good_system(gain: Path) -> Good:
    """An SSP with all that the reader reads."""
    fmu = {"resources/gain.fmu": gain.read_bytes()}
    inner = packed(io.BytesIO(), {"SystemStructure.ssd": INNER.encode(), **fmu})
    return {
        "SystemStructure.ssd": OUTER.encode(),
        "other.ssd": INNER.encode(),
        **fmu,
        "resources/start.ssv": START.encode(),
        "resources/names.ssm": MAPPING.encode(),
        "resources/inner.ssp": inner.getvalue(),
    }


@pytest.fixture(scope="module")
def good(fmus: Workshop) -> Mapping[str, Good]:
    """Suffix and content of good files: FMUs of both versions, and an SSP with all that the reader reads."""
    icon, library = b"\x89PNG\r\n\x1a\n", fmus.library
    return {
        "fmi2": {
            DESCRIPTION: XML_2.encode(),
            "documentation/index.html": b"<html></html>",
            "terminalsAndIcons/terminalsAndIcons.xml": TERMINALS.encode(),
            "terminalsAndIcons/icon.png": icon,
            "binaries/linux64/lag.so": library,
            "sources/lag.c": b"int x;",
        },
        "fmi3": {
            DESCRIPTION: XML_3.encode(),
            "sources/buildDescription.xml": BUILD.encode(),
            "terminalsAndIcons/terminalsAndIcons.xml": TERMINALS.encode(),
            "binaries/x86_64-linux/lag.so": library,
            "resources/model.py": b"class Model: pass",
        },
        "ssp": {**good_system(fmus["gain"]), "resources/view.toml": VIEW.read_bytes()},
    }


class Touched:
    """Files that the process writes, removes or loads as libraries, by the audit events of Python."""

    writing = os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC | os.O_APPEND
    changes = ("os.mkdir", "os.remove", "os.rename", "os.rmdir", "os.symlink", "os.link", "os.chmod")

    def __init__(self) -> None:
        self.paths: list[str] | None = None
        sys.addaudithook(self._note)

    def _note(self, event: str, arguments: tuple[Any, ...]) -> None:
        if self.paths is None:
            return
        if event == "open":
            path, _, flags = arguments
            secret = isinstance(path, (str, bytes)) and "passwd" in os.fsdecode(path)
            if secret or (isinstance(flags, int) and flags & self.writing):
                self.paths.append(str(path))
        elif event in self.changes or event == "ctypes.dlopen":
            self.paths.append(f"{arguments[0]}")


touched = Touched()


@contextmanager
def watched(folder: Path) -> Iterator[None]:
    """Nothing outside of a temporary folder may be touched, and nothing may be left there."""
    temporary, before = folder / "temporary", tempfile.tempdir
    temporary.mkdir(exist_ok=True)
    tempfile.tempdir, touched.paths = str(temporary), []
    try:
        yield
    finally:
        paths, touched.paths, tempfile.tempdir = touched.paths, None, before
    inside = (str(temporary), "None")
    outside = [p for p in paths if os.path.isabs(p) and not p.startswith(inside) and "__pycache__" not in p]
    assert not outside, outside
    files._remove_unused(-1.0)  # of the unpacked archives
    assert not list(temporary.iterdir())


def read_fmu(path: Path, system: System) -> None:
    """All that reads an FMU before it is loaded: to run it, to linearise it, to swap it, to list it."""
    for work in (lambda: used(load(path)), lambda: load(path), lambda: used(with_swaps(system, {"b": path}))):
        with suppress(Problem):
            work()


def read_ssp(path: Path, _: System) -> None:
    """All that reads an SSP before its FMUs are loaded."""
    with suppress(Problem):
        system = load(path)
        used(system)
        for name in parameter_sets(system):
            with suppress(Problem):
                with_sets(system, [name])


def used(system: System) -> None:
    """What happens to a system that has been read, until the first FMU is loaded."""
    for work in (lambda: output_order(system), lambda: list(lines(system)), lambda: view_description(system)):
        with suppress(Problem):
            work()
    for component in system.components.values():
        with suppress(Problem):
            component.value(next(iter(component.interface.variables), ""))
        if component.source is not None:
            with suppress(Problem), component.source.unpacked():
                pass


def checked(path: Path) -> None:
    """The static rules of `check`: no rule fails, each finding is a line for a terminal."""
    report = check(path, run=False)
    defects = [f.text for f in report.findings if f.rule == DEFECT]
    assert not defects, defects
    assert all(f.text.isprintable() and len(f.text) < 3000 for f in report.findings)
    report.text()
    with open_subject(path) as subject, suppress(Problem):
        subject.model.for_run()


def peak() -> float:
    """The largest resident memory of this process so far [bytes]; 0 where that is unknown."""
    try:
        import resource
    except ImportError:  # Windows
        return 0.0
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1.0 if sys.platform == "darwin" else 1024.0)


def examine(path: Path, content: bytes, read: Callable[[Path, System], None], system: System) -> str:
    """Why a file is not handled as it should be; empty if it is."""
    path.write_bytes(content)
    start, before = time.process_time(), peak()
    try:
        with watched(path.parent):
            read(path, system)
            checked(path)
    except Exception as error:  # any: the test reports it with its seed
        return f"{type(error).__name__}: {str(error)[:300]}"
    duration, growth = time.process_time() - start, peak() - before
    if duration > LONGEST or growth > MOST:
        return f"{duration:.1f} s, {growth / 1e6:.0f} MB"
    return ""


def faults(kind: str, good: Mapping[str, Good], seeds: range, folder: Path, system: System) -> dict[int, str]:
    """Seed -> why the file with this damage is not handled as it should be."""
    path, read = (folder / "x.ssp", read_ssp) if kind == "ssp" else (folder / "x.fmu", read_fmu)
    results = {seed: examine(path, damaged(good[kind], seed), read, system) for seed in seeds}
    return {seed: result for seed, result in results.items() if result}


@pytest.fixture(scope="module")
def system(good: Mapping[str, Good], tmp_path_factory: pytest.TempPathFactory) -> System:
    """A good system, into which FMUs are swapped; reading it imports what tests of writes must not see."""
    folder = tmp_path_factory.mktemp("system")
    packed(folder / "good.ssp", good["ssp"])
    packed(folder / "good.fmu", good["fmi2"])
    system = load(folder / "good.ssp")
    used(system)
    checked(folder / "good.fmu")
    return system


@pytest.mark.parametrize("seeds", [range(30), pytest.param(range(30, 2000), marks=shards.search)], ids=str)
@pytest.mark.parametrize("kind", ["fmi2", "fmi3", "ssp"])
def test_damage_is_told(kind, seeds, good, system, tmp_path):
    """No other exception than Problem, no defect of a rule, nothing touched, and all that in bounds."""
    assert faults(kind, good, seeds, tmp_path, system) == {}
