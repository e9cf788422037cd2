"""Where commands on the built machine run."""

import shutil

import pytest


def machine_in(folder, monkeypatch, fmu_dir):
    """A working directory with build/harvester.ssp."""
    monkeypatch.chdir(folder)
    (folder / "build").mkdir()
    shutil.copy(fmu_dir / "harvester.ssp", "build")
    return folder


@pytest.fixture
def here(tmp_path, monkeypatch, fmu_dir):
    """The working directory of a test."""
    return machine_in(tmp_path, monkeypatch, fmu_dir)
