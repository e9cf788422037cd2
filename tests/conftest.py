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
    """Folder with the same files in FMI 3 and SSP 2."""
    from fmus.build import build_machine

    return build_machine(tmp_path_factory.mktemp("fmi3"), versions=(3,))[0].parent
