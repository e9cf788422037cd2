"""Fixtures shared by all tests: the machine's FMUs and a browser, one of each per test process."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import properties
import pytest

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
LONG = 120.0  # s for a browser to start; only bounds a failure
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


@pytest.fixture(scope="session")
def fmu_dir(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder with swing.fmu, boom_stick.fmu, manipulator.fmu and harvester.ssp."""
    from fmus.machine.build import build_machine

    folder = tmp_path_factory.mktemp("fmus")
    build_machine(folder)
    return folder


@pytest.fixture(scope="session")
def fmi3_dir(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder with the same files in FMI 3 and SSP 2."""
    from fmus.machine.build import build_machine

    return build_machine(tmp_path_factory.mktemp("fmi3"), versions=(3,))[0].parent
