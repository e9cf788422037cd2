"""The usual machine, and small foreign FMUs."""

from __future__ import annotations

from pathlib import Path

import pytest
from kit.any_fmu.models import Workshop

from orchestrator import System, load


@pytest.fixture(scope="session")
def system(fmu_dir: Path) -> System:
    """The usual machine."""
    return load(fmu_dir / "harvester.ssp")


@pytest.fixture(scope="session")
def foreign(tmp_path_factory: pytest.TempPathFactory) -> Workshop:
    """The plain FMU of each model by name."""
    return Workshop(tmp_path_factory.mktemp("lanes"))
