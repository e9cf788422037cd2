"""Small foreign FMUs."""

from __future__ import annotations

import pytest
from kit.any_fmu.models import Workshop


@pytest.fixture(scope="session")
def foreign(tmp_path_factory: pytest.TempPathFactory) -> Workshop:
    """The plain FMU of each model by name."""
    return Workshop(tmp_path_factory.mktemp("lanes"))
