"""Fixtures: small FMUs, the study of one of them, and a Dask cluster that all tests share."""

from collections.abc import Iterator
from pathlib import Path

import pytest
from distributed import Client
from kit.any_fmu.models import Workshop
from sweep.studies import GAIN, study

from orchestrator.studies import pool


@pytest.fixture(scope="session")
def gain(fmus: Workshop) -> Path:
    """y = factor u + offset."""
    return fmus["gain"]


@pytest.fixture(scope="session")
def fails(fmus: Workshop) -> Path:
    """y' = u; fails in the way `how` from the time `when` on."""
    return fmus["fails"]


@pytest.fixture(scope="session")
def one() -> Iterator[Client]:
    """A worker."""
    with pool.client(1) as client:
        yield client


@pytest.fixture
def file(gain: Path, tmp_path: Path) -> Path:
    """The file of the study of the gain."""
    return study(tmp_path, GAIN, gain)
