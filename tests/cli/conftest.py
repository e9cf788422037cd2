"""Where commands on the built machine run."""

import shutil
from functools import partial

import pytest

from orchestrator.results import validate_system


def machine_in(folder, monkeypatch, fmu_dir):
    """A working directory with build/harvester.ssp; no ISO rating, whose library takes seconds to start."""
    monkeypatch.chdir(folder)
    unrated = partial(validate_system.validate_system, rate=False)
    monkeypatch.setattr(validate_system, "validate_system", unrated)
    (folder / "build").mkdir()
    shutil.copy(fmu_dir / "harvester.ssp", "build")
    return folder


@pytest.fixture
def here(tmp_path, monkeypatch, fmu_dir):
    """The working directory of a test."""
    return machine_in(tmp_path, monkeypatch, fmu_dir)
