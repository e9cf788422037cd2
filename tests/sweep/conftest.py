"""Fixtures: small FMUs, and the study of one of them."""

from pathlib import Path

import pytest
from kit.any_fmu.models import Workshop
from sweep.studies import GAIN, study


@pytest.fixture(scope="session")
def gain(fmus: Workshop) -> Path:
    """y = factor u + offset."""
    return fmus["gain"]


@pytest.fixture(scope="session")
def fails(fmus: Workshop) -> Path:
    """y' = u; fails in the way `how` from the time `when` on."""
    return fmus["fails"]


@pytest.fixture
def file(gain: Path, tmp_path: Path) -> Path:
    """The file of the study of the gain."""
    return study(tmp_path, GAIN, gain)
