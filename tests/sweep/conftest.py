"""Fixtures: small FMUs, and the study of one of them."""

from pathlib import Path

import pytest
from kit.any_fmu.models import Workshop
from sweep.studies import GAIN, study


@pytest.fixture(scope="session")
def gain(fmus: Workshop) -> Path:
    """y = factor u + offset."""
    return fmus["gain"]


@pytest.fixture
def file(gain: Path, tmp_path: Path) -> Path:
    """The file of the study of the gain."""
    return study(tmp_path, GAIN, gain)
