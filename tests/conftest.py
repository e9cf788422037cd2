"""Fixtures shared by all tests: the machine's FMUs, built once per test process."""

from __future__ import annotations

from pathlib import Path

import pytest


@pytest.fixture(scope="session")
def fmu_dir(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder with swing.fmu, boom_stick.fmu, manipulator.fmu and harvester.ssp."""
    from fmus.build import build_machine

    folder = tmp_path_factory.mktemp("fmus")
    build_machine(folder)
    return folder


@pytest.fixture(scope="session")
def fmi3_dir(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder with the same FMUs in FMI 3."""
    from fmus.export.build import build_all
    from fmus.machine import ALL
    from fmus.scenarios import WORK_CYCLE_STOP

    folder = tmp_path_factory.mktemp("fmi3")
    build_all(list(ALL.values()), {3: folder}, 1e-3, WORK_CYCLE_STOP)
    return folder
