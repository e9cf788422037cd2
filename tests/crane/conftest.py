"""The loader's FMUs and systems."""

import sys
from importlib import import_module

import pytest
from kit.cranes import crane
from kit.needs import lacks

from fmus.crane.machine import crane_build


@pytest.fixture(scope="session")
def pin():
    """Pinocchio, a rigid-body library with algorithms and a reader of its own."""
    if sys.platform != "linux":
        lacks("Linux", "Pinocchio is installed there only")
    return import_module("pinocchio")


@pytest.fixture(scope="session")
def loader_folder(tmp_path_factory):
    """Where examples/cranes/loader.toml is built."""
    folder = tmp_path_factory.mktemp("loader")
    crane_build(crane()).write(folder)
    return folder
