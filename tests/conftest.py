"""Fixtures shared by all tests: the machine's FMUs, and a browser per test process."""

from __future__ import annotations

import os
import shutil
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from kit import properties

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
LONG = 600.0  # s for a browser to start or the machine to be built; only bounds a failure
INSTALL = "no Chromium found; install one: apt install chromium, or any Chrome in the search path"
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
# the compiler's own cache, also for tests that move the user's: else it compiles its C library again in each
os.environ.setdefault(
    "ZIG_GLOBAL_CACHE_DIR", str(Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "zig")
)


@pytest.fixture(scope="session")
def chromium() -> Iterator[Any]:
    """A headless Chromium; without one the test is skipped. Of its library a process can hold only one."""
    found = next(filter(None, map(shutil.which, NAMES)), None)
    if found is None:
        pytest.skip(INSTALL)
    from playwright.sync_api import sync_playwright

    with sync_playwright() as play:
        browser = play.chromium.launch(executable_path=found, args=list(FLAGS), timeout=1e3 * LONG)
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
    """Folder of the machine in both versions of FMI, built once for all test processes."""
    from fmus.machine.build import build_machine

    return once("machine", lambda folder: build_machine(folder, versions=(2, 3)))


@pytest.fixture(scope="session")
def fmu_dir(built: Path) -> Path:
    """Folder with swing.fmu, boom_stick.fmu, manipulator.fmu and harvester.ssp."""
    return built


@pytest.fixture(scope="session")
def fmi3_dir(built: Path) -> Path:
    """Folder with the same files in FMI 3 and SSP 2."""
    return built / "fmi3"
