"""Where commands on the built machine run."""

import shutil
from functools import partial

import pytest

from orchestrator.results import validate_system


@pytest.fixture
def here(tmp_path, monkeypatch, fmu_dir):
    """A working directory with build/harvester.ssp; no ISO rating, whose library takes seconds to start."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(
        validate_system, "validate_system", partial(validate_system.validate_system, rate=False)
    )
    (tmp_path / "build").mkdir()
    shutil.copy(fmu_dir / "harvester.ssp", "build")
    return tmp_path
