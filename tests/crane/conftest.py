"""The loader's FMUs and systems."""

import pytest
from kit.cranes import crane

from fmus.crane.machine import crane_build


@pytest.fixture(scope="session")
def pin():
    """Pinocchio, a rigid-body library with algorithms and a reader of its own."""
    return pytest.importorskip("pinocchio", reason="Pinocchio is installed on Linux only")


@pytest.fixture(scope="session")
def loader_folder(tmp_path_factory):
    """Where examples/cranes/loader.toml is built."""
    folder = tmp_path_factory.mktemp("loader")
    crane_build(crane()).write(folder)
    return folder
