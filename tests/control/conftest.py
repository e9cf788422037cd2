"""The machine under control."""

import pytest


@pytest.fixture(scope="session")
def machine(fmu_dir):
    """harvester_control.ssp."""
    return fmu_dir / "harvester_control.ssp"
