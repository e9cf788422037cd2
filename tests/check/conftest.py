"""Fixtures of the tests of `harvester check`."""

import pytest

from check.good import Good, make
from check.oscillator import Oscillators


@pytest.fixture(scope="session")
def good() -> Good:
    """The good FMU of FMI 2 and of FMI 3."""
    return {major: make(major) for major in (2, 3)}


@pytest.fixture(scope="session")
def oscillators(tmp_path_factory: pytest.TempPathFactory) -> Oscillators:
    """Oscillators with faults of choice."""
    return Oscillators(tmp_path_factory.mktemp("oscillators"))
