"""The loader's FMUs and systems."""

from pathlib import Path

import pytest

from fmus.crane.description import read
from fmus.crane.machine import build_crane


@pytest.fixture(scope="session")
def loader_folder(tmp_path_factory):
    """Where examples/cranes/loader.toml is built."""
    folder = tmp_path_factory.mktemp("loader")
    build_crane(read(Path(__file__).parents[2] / "examples" / "cranes" / "loader.toml"), folder)
    return folder
