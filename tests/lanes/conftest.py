"""Small foreign FMUs."""

from __future__ import annotations

from pathlib import Path

import pytest
from kit.any_fmu.models import Workshop


@pytest.fixture(scope="session")
def workshop(tmp_path_factory: pytest.TempPathFactory) -> Workshop:
    """The plain FMU of each model by name."""
    return Workshop(tmp_path_factory.mktemp("lanes"))


@pytest.fixture(scope="session")
def gain(workshop: Workshop) -> Path:
    """y = factor u + offset."""
    return workshop["gain"]


@pytest.fixture(scope="session")
def fails(workshop: Workshop) -> Path:
    """y' = u; fails in the way `how` from the time `when` on."""
    return workshop["fails"]
