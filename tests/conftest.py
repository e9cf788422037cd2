"""Fixtures shared by all tests: the machine's FMUs, and a browser per test process."""

import os

# before NumPy is loaded: threads for small matrices only take the processor from the other test process
os.environ.setdefault("OMP_NUM_THREADS", "1")

import contextlib
import signal
import time
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from kit import properties
from kit.shards import SHARDS
from kit.touched import is_touched

LONG = 600.0  # s for a browser to start or the machine to be built; only bounds a failure
INSTALL = "apt install chromium, or any Chrome in the search path"
# pictures are drawn by the processor; without the calls home that a fresh browser makes
FLAGS = (
    "--no-sandbox",
    "--enable-unsafe-swiftshader",
    "--disable-quic",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
)
properties.register()  # before any test is read
signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell ignores it in a background job
# the compiler's own cache, also for tests that move the user's: else it compiles its C library again in each
os.environ.setdefault(
    "ZIG_GLOBAL_CACHE_DIR", str(Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "zig")
)


ROOT = Path(__file__).parents[1]
pytest_plugins = ["kit.shares", "kit.needs"]


def pytest_addoption(parser: pytest.Parser) -> None:
    """`.ci/run` asks for a part of the long tests, or for those that a change touches first."""
    parser.addoption(
        "--part", default="0/1", help="K/N: the tests with the number K when they are counted up to N"
    )
    parser.addoption(
        "--first", type=Path, help="a file with changed files: all tests, first theirs, then those of --part"
    )
    parser.addoption("--until", type=float, default=float("inf"), help="no test begins later [s since 1970]")


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Each long test is in one shard that exists; of a part of the tests each shard is counted for itself."""
    part, parts = map(int, config.getoption("part").split("/"))
    own, rest, counts = list[pytest.Item](), list[pytest.Item](), Counter[str]()
    for item in items:
        shards = [mark.kwargs.get("shard") for mark in item.iter_markers("long")] or [""]
        if len(shards) > 1 or shards[0] not in ("", *SHARDS):
            raise pytest.UsageError(f"{item.nodeid}: expected one shard of {', '.join(SHARDS)}, got {shards}")
        (own if counts[shards[0]] % parts == part else rest).append(item)
        counts[shards[0]] += 1
    if first := config.getoption("first"):
        files = first.read_text(encoding="utf-8").splitlines()
        own = sorted([*own, *rest], key=lambda item: not is_touched(item.nodeid, files))
    items[:] = own


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup(item: pytest.Item) -> None:
    """Nothing begins when the time is up."""
    from kit.needs import lacks  # here, because pytest loads it first, as a plugin

    if time.time() > item.config.getoption("until"):
        lacks("time")
    without_name()


def without_name() -> None:
    """Runs in a process of their own share one, as long as the environment stays the same: 0.3 s each."""
    os.environ.pop("PYTEST_CURRENT_TEST", None)


@pytest.hookimpl(tryfirst=True)
def pytest_pyfunc_call() -> None:
    """As for the setup of a test."""
    without_name()


pytest_fixture_setup = pytest_pyfunc_call


@pytest.fixture(scope="session")
def chromium() -> Iterator[Any]:
    """A headless Chromium; without one the test is skipped. Of its library a process can hold only one."""
    from kit.needs import CHROMIUM, lacks  # here, because pytest loads it first, as a plugin

    if CHROMIUM is None:
        lacks("chromium", INSTALL)
    from playwright.sync_api import sync_playwright

    with sync_playwright() as play:
        browser = play.chromium.launch(executable_path=CHROMIUM, args=list(FLAGS), timeout=1e3 * LONG)
        yield browser
        browser.close()


Once = Callable[[str, Callable[[Path], object]], Path]


@pytest.fixture(scope="session")
def once(tmp_path_factory: pytest.TempPathFactory, request: pytest.FixtureRequest) -> Once:
    """once(name, make): a folder that `make` fills, in the first test process that asks for it."""
    base = tmp_path_factory.getbasetemp()
    shared = base.parent if hasattr(request.config, "workerinput") else base

    def folder_of(name: str, make: Callable[[Path], object]) -> Path:
        folder, ready, failed = shared / name, shared / f"{name}.ready", shared / f"{name}.failed"
        try:
            folder.mkdir()
        except FileExistsError:  # another process fills it, or this one has
            end = time.monotonic() + LONG
            while not ready.exists():
                assert not failed.exists(), f"{name} failed in another test process"
                assert time.monotonic() < end, f"{name} is not ready after {LONG} s"
                time.sleep(0.1)
            return folder
        try:
            make(folder)
        except BaseException:
            failed.touch()
            raise
        ready.touch()
        return folder

    return folder_of


@pytest.fixture(scope="session")
def built(once: Once) -> Path:
    """Folder of the machine in both versions of FMI, built by the command, once for all test processes.

    `HARVESTER_MACHINE` is a folder with this build, for many runs of the tests of the orchestrator.
    """
    if given := os.environ.get("HARVESTER_MACHINE"):
        return Path(given)
    from kit import shares  # here, because pytest loads it first, as a plugin

    from orchestrator.__main__ import main

    def build(folder: Path) -> None:
        with (folder.parent / "machine.printed").open("w") as file, contextlib.redirect_stdout(file):
            assert main(["build", "--out", str(folder)]) == 0

    begin = time.monotonic()
    folder = once("machine", build)
    shares.building += time.monotonic() - begin
    return folder


@pytest.fixture(scope="session")
def fmu_dir(built: Path) -> Path:
    """Folder with swing.fmu, boom_stick.fmu, manipulator.fmu and harvester.ssp."""
    return built


@pytest.fixture(scope="session")
def diagnosis_fmu(once: Once) -> Path:
    """The diagnosis of the harvester alone."""
    from fmus.machine.build import harvester

    folder = once("diagnosis", lambda f: harvester(faults=True).write(f, only=("diagnosis",)))
    return folder / "diagnosis.fmu"


@pytest.fixture(scope="session")
def system(fmu_dir: Path) -> Any:
    """The machine, read once."""
    from orchestrator import load

    return load(fmu_dir / "harvester.ssp")


@pytest.fixture(scope="session")
def fmus(tmp_path_factory: pytest.TempPathFactory) -> Any:
    """The plain FMU of each small model by name, and a way to make others."""
    from kit.any_fmu.models import Workshop

    return Workshop(tmp_path_factory.mktemp("any_fmu"))


@pytest.fixture(scope="session")
def fmi3_dir(built: Path) -> Path:
    """Folder with the same files in FMI 3 and SSP 2."""
    return built / "fmi3"


@pytest.fixture
def workplace(built: Path, tmp_path: Path) -> Path:
    """A folder like the project's root after `harvester build`, which no test writes into."""
    (tmp_path / "build").mkdir()
    for file in built.iterdir():
        (tmp_path / "build" / file.name).symlink_to(file)
    for folder in ("data", "docs", "examples"):
        (tmp_path / folder).symlink_to(ROOT / folder)
    return tmp_path
