"""The FMU of the example."""

from pathlib import Path

import pytest

from fmus.export.python.build import build_user

ACTUATOR = Path(__file__).parents[2] / "examples" / "my_subsystem" / "my_actuator.py"


@pytest.fixture(scope="session")
def actuator(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The boom and stick of the example, by hand in Python."""
    return build_user(ACTUATOR, tmp_path_factory.mktemp("actuator"))
